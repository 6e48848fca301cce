use peernet_inference::InferenceError;
use peernet_sample::{Description, MediaType, PixelFormat, Sample};

use super::{answer, bank, jpeg, loaded, pictures, quality_control, run};

#[test]
fn answer_ranks_all_labels_and_stages_are_recorded() {
    let bank = bank(&[&quality_control()]);
    let pool = loaded(&bank, "qc");
    let (file, _) = pictures("pictures").swap_remove(0);
    let done = run(&pool, jpeg(file));
    let answer = answer(done.result);
    assert_eq!(answer.top.len(), 4);
    assert_eq!((&answer.label, answer.score), (&answer.top[0].label, answer.top[0].score));
    assert!(answer.top.windows(2).all(|pair| pair[0].score >= pair[1].score));
    let sum: f64 = answer.top.iter().map(|ranked| ranked.score).sum();
    assert!((sum - 1.0).abs() < 1e-5, "{sum}");
    let tree = done.recorder.finish();
    for stage in ["queue", "preprocessing", "inference", "postprocessing"] {
        let (_, node) = tree.find(&[stage]).expect(stage);
        assert!(node.measure.value().is_some(), "{stage}");
    }
}

#[test]
fn label_outside_model_classes_is_marked() {
    let bank = bank(&[&quality_control()]);
    let pool = loaded(&bank, "qc");
    let (file, _) = pictures("pictures").swap_remove(0);
    for (label, expected) in
        [(None, None), (Some("Hole_Missing"), None), (Some("tench"), Some(1.0)), (Some("3"), Some(1.0))]
    {
        let sample = Sample { label: label.map(str::to_owned), ..jpeg(file.clone()) };
        let tree = run(&pool, sample).recorder.finish();
        let found = tree.find(&["unknown-label"]).and_then(|(_, node)| node.measure.value());
        assert_eq!(found, expected, "{label:?}");
    }
    let classes = ("Classes".to_owned(), "4: good, scratched, dented, hole missing".to_owned());
    assert!(pool.facts().contains(&classes), "{:?}", pool.facts());
}

#[test]
fn decoded_pixels_give_same_answer_as_file() {
    let bank = bank(&[&quality_control()]);
    let pool = loaded(&bank, "qc");
    let (file, _) = pictures("pictures").swap_remove(0);
    let mut picture = peernet_imaging::Picture::default();
    peernet_imaging::decode(&file, PixelFormat::Rgb8, &mut picture).expect("is whole");
    let pixels = Sample { parts: vec![picture.into_part()], source: String::new(), label: None };
    assert_eq!(answer(run(&pool, pixels).result), answer(run(&pool, jpeg(file)).result));
}

#[test]
fn unusable_sample_fails_without_affecting_next_one() {
    let bank = bank(&[&quality_control()]);
    let pool = loaded(&bank, "qc");
    let (file, _) = pictures("pictures").swap_remove(0);
    let mut huge = file.clone();
    let frame = huge.windows(2).position(|pair| pair == [0xff, 0xc0]).expect("has a frame header");
    // Height and width of the picture: 65,535 pixels each.
    huge[frame + 5..frame + 9].fill(0xff);
    let plain = |media| Sample::from_part(Description::unshaped(media), file.clone().into());
    let wrong_size =
        Sample::from_part(Description::pixels(PixelFormat::Rgb8, 40_000, 40_000), vec![0; 12].into());
    let bad = [
        (jpeg(file[..file.len() / 2].to_vec()), "the jpeg file cannot be read"),
        (jpeg(b"\xff\xd8\xff\xe0 broken".to_vec()), "the jpeg file cannot be read"),
        (jpeg(Vec::new()), "neither a jpeg nor a png"),
        // The reason comes from the decoder; any text is right.
        (jpeg(huge), ""),
        (wrong_size, "40000 × 40000 pixels is not supported"),
        (plain(MediaType::Bytes), "plain bytes, not a picture"),
        (plain(MediaType::Json), "json, not a picture"),
        (Sample { parts: Vec::new(), source: String::new(), label: None }, "no payload"),
    ];
    for (mut sample, expected) in bad {
        sample.source = "line-3/part.jpg".to_owned();
        let done = run(&pool, sample);
        let error = done.result.expect_err("the sample cannot be used");
        assert!(matches!(error, InferenceError::Input { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains(expected) && text.contains("qc") && text.contains("line-3/part.jpg"), "{text}");
        assert!(done.recorder.finish().find(&["inference"]).is_none());
    }
    assert!(run(&pool, jpeg(file)).result.is_ok());
}
