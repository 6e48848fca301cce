use peernet_imaging::{Encoding, Filter, Picture, Resizer, decode, encode};
use peernet_sample::PixelFormat;

use super::{answer, bank, jpeg, loaded, pictures, quality_control, run};

/// Computes the answers for all pictures and checks that at least 97 % are right. The message of a failure lists the
/// wrong answers.
fn assert_97_percent(pictures: &[(Vec<u8>, String)], prepare: impl Fn(&[u8]) -> Vec<u8>) {
    let bank = bank(&[&quality_control()]);
    let pool = loaded(&bank, "qc");
    let mut wrong = Vec::new();
    for (index, (file, label)) in pictures.iter().enumerate() {
        let answer = answer(run(&pool, jpeg(prepare(file))).result);
        if answer.label != *label {
            wrong.push(format!(
                "picture {}: {label} taken for {} ({:.3})",
                index + 1,
                answer.label,
                answer.score
            ));
        }
    }
    let (all, right) = (pictures.len(), pictures.len() - wrong.len());
    assert!(right * 100 >= all * 97, "{right} of {all} answers are right\n{}", wrong.join("\n"));
}

#[test]
fn demo_model_is_right_on_demo_pictures() {
    let demo = pictures("pictures");
    assert_eq!(demo.len(), 30);
    assert_97_percent(&demo, <[u8]>::to_vec);
}

#[test]
fn demo_model_is_right_on_test_pictures() {
    let held_out = pictures("held-out");
    assert!(held_out.len() >= 100);
    assert_97_percent(&held_out, <[u8]>::to_vec);
}

/// The pictures are prepared as in the demo's third pipeline: resized to 320 × 240 pixels and encoded again.
#[test]
fn demo_model_is_right_on_pictures_resized_first() {
    let mut all = pictures("pictures");
    all.extend(pictures("held-out"));
    let small = |file: &[u8]| {
        let (mut whole, mut small) = (Picture::default(), Picture::default());
        decode(file, PixelFormat::Rgb8, &mut whole).expect("is whole");
        Resizer::new().resize(&whole, 320, 240, Filter::Bilinear, &mut small).expect("is possible");
        encode(&small, Encoding::Jpeg { quality: 85 }).expect("encodes").bytes.to_vec()
    };
    assert_97_percent(&all, small);
}
