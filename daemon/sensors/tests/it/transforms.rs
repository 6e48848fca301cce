use peernet_imaging::{Encoding, Filter, Header, Picture, encode, probe_part};
use peernet_sample::{Description, MediaType, Part, PixelFormat, Sample};
use peernet_sensors::transform::crop::CropConfig;
use peernet_sensors::transform::encode::{EncodeConfig, Format};
use peernet_sensors::transform::resize::ResizeConfig;
use peernet_sensors::{SensorError, TransformConfig, TransformKind};

use super::recorder;

fn photograph(width: u32, height: u32) -> Sample {
    let pixels = (0..width * height).flat_map(|i| [(i % 251) as u8, (i / width) as u8, 90]).collect();
    let picture = Picture::new(PixelFormat::Rgb8, width, height, pixels).expect("fits");
    let part = encode(&picture, Encoding::Jpeg { quality: 90 }).expect("encodes");
    Sample { parts: vec![part], source: "photograph.jpg".to_owned(), label: Some("good".to_owned()) }
}

fn apply(sample: Sample, transforms: &[TransformConfig]) -> Result<Sample, SensorError> {
    let mut recorder = recorder();
    transforms.iter().try_fold(sample, |sample, transform| transform.build()?.apply(sample, &mut recorder))
}

fn header(sample: &Sample) -> Header {
    probe_part(&sample.parts[0]).expect("is a picture")
}

const RESIZE: TransformConfig =
    TransformConfig::Resize(ResizeConfig { width: 32, height: 24, filter: Filter::Bilinear });
const ENCODE: TransformConfig =
    TransformConfig::Encode(EncodeConfig { format: Format::Jpeg, quality: Some(80) });

#[test]
fn resized_pictures_stay_pixels_until_they_are_encoded() {
    let resized = apply(photograph(320, 240), &[RESIZE]).expect("resizes");
    let pixels = MediaType::Pixels(PixelFormat::Rgb8);
    assert_eq!(header(&resized), Header { media: pixels, width: 32, height: 24 });
    assert_eq!((resized.source.as_str(), resized.label.as_deref()), ("photograph.jpg", Some("good")));

    let original = photograph(320, 240);
    let before = original.payload_bytes();
    let file = apply(original, &[RESIZE, ENCODE]).expect("resizes and encodes");
    assert_eq!(header(&file), Header { media: MediaType::Jpeg, width: 32, height: 24 });
    assert!(file.payload_bytes() < before / 4, "{} of {before}", file.payload_bytes());
}

#[test]
fn crop_uses_configured_rectangle() {
    let crop = |x, y| TransformConfig::from(CropConfig { width: 2, height: 1, x, y });
    let pixels = apply(photograph(16, 8), &[TransformConfig::to_pixels()]).expect("decodes");
    let corner = apply(pixels.clone(), &[crop(Some(0), Some(0))]).expect("fits");
    assert_eq!(corner.parts[0].bytes[..], pixels.parts[0].bytes[..6]);
    let centre = apply(pixels.clone(), &[crop(None, None)]).expect("fits");
    // The rectangle begins in row 3, column 7 of 16. A pixel has three bytes.
    let start = (3 * 16 + 7) * 3;
    assert_eq!(centre.parts[0].bytes[..], pixels.parts[0].bytes[start..start + 6]);
    let error = apply(pixels, &[crop(Some(15), None)]).expect_err("reaches beyond").to_string();
    assert!(error.contains("cannot crop sample \"photograph.jpg\"") && error.contains("15"), "{error}");
}

#[test]
fn every_picture_is_changed_and_other_parts_stay() {
    let mut pair = photograph(64, 48);
    let text_part = Part { description: Description::unshaped(MediaType::Text), bytes: "a note".into() };
    pair.parts.push(text_part.clone());
    pair.parts.push(photograph(20, 20).parts.remove(0));
    let changed = apply(pair, &[RESIZE]).expect("resizes");
    assert_eq!(changed.parts[1], text_part);
    let second = probe_part(&changed.parts[2]).expect("is a picture");
    assert_eq!((header(&changed).width, second.width), (32, 32));
}

#[test]
fn sample_without_readable_picture_is_refused() {
    let error =
        apply(Sample::from_part(Description::bytes(), "abc".into()), &[RESIZE]).expect_err("is no picture");
    assert!(error.to_string().contains("plain bytes, not a picture"), "{error}");
    let mut broken = photograph(64, 48);
    broken.parts[0].bytes.truncate(700);
    let error = apply(broken, &[TransformConfig::to_pixels()]).expect_err("is truncated").to_string();
    assert!(error.contains("cannot decode sample \"photograph.jpg\""), "{error}");
}

#[test]
fn invalid_configuration_is_refused_when_built() {
    let encode = |format, quality| TransformConfig::from(EncodeConfig { format, quality });
    for wrong in [
        ResizeConfig { width: 0, height: 5, filter: Filter::Bilinear }.into(),
        CropConfig { width: 5, height: 0, x: None, y: None }.into(),
        encode(Format::Jpeg, Some(0)),
        encode(Format::Jpeg, Some(101)),
        encode(Format::Png, Some(80)),
    ] {
        assert!(matches!(wrong.build(), Err(SensorError::Config(_))), "{wrong:?}");
    }
    assert!(encode(Format::Png, None).build().is_ok());
    assert_eq!(RESIZE.build().expect("is right").describe(), "resize to 32 × 24");
}
