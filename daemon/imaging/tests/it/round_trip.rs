use peernet_imaging::{Encoding, Picture, decode, encode, probe, probe_part, read_part};
use peernet_sample::{MediaType, PixelFormat};
use proptest::prelude::*;

use super::scene;

fn picture() -> impl Strategy<Value = Picture> {
    let format = prop_oneof![Just(PixelFormat::Rgb8), Just(PixelFormat::Grey8)];
    (format, 1u32..40, 1u32..40).prop_flat_map(|(format, width, height)| {
        let length = (width * height * format.channels()) as usize;
        proptest::collection::vec(any::<u8>(), length)
            .prop_map(move |pixels| Picture::new(format, width, height, pixels).expect("fits"))
    })
}

proptest! {
    #[test]
    fn png_keeps_every_pixel(picture in picture()) {
        let part = encode(&picture, Encoding::Png).expect("encodes");
        prop_assert_eq!(&part.description.media, &MediaType::Png);
        let mut back = Picture::default();
        read_part(&part, picture.format(), &mut back).expect("decodes");
        prop_assert_eq!(&back, &picture);
    }

    #[test]
    fn pixels_round_trip_as_part(picture in picture()) {
        let part = picture.clone().into_part();
        let mut back = Picture::default();
        read_part(&part, picture.format(), &mut back).expect("fits");
        prop_assert_eq!(&back, &picture);
    }

    #[test]
    fn format_and_size_are_read_from_header(picture in picture(), quality in 1u8..=100) {
        let size = (picture.width(), picture.height());
        for encoding in [Encoding::Png, Encoding::Jpeg { quality }] {
            let part = encode(&picture, encoding).expect("encodes");
            let header = probe(&part.bytes).expect("is whole");
            prop_assert_eq!((header.width, header.height), size);
            prop_assert_eq!(header.media, part.description.media);
        }
        let header = probe_part(&picture.into_part()).expect("is whole");
        prop_assert_eq!((header.width, header.height), size);
    }
}

#[test]
fn jpeg_error_falls_with_quality() {
    for format in [PixelFormat::Rgb8, PixelFormat::Grey8] {
        let original = scene(format, 161, 83);
        let mut last = (f64::MAX, 0);
        for quality in [30, 85, 97] {
            let part = encode(&original, Encoding::Jpeg { quality }).expect("encodes");
            let mut back = Picture::default();
            decode(&part.bytes, format, &mut back).expect("decodes");
            assert_eq!((back.width(), back.height()), (161, 83));
            let difference =
                original.pixels().iter().zip(back.pixels()).map(|(a, b)| f64::from(a.abs_diff(*b)));
            let error = difference.sum::<f64>() / original.pixels().len() as f64;
            assert!(error < last.0 && part.bytes.len() > last.1, "{format:?} {quality}: {error}");
            last = (error, part.bytes.len());
        }
        assert!(last.0 < 2.0, "{format:?}: mean error of {} at quality 97", last.0);
    }
}

#[test]
fn file_is_decoded_to_requested_channels() {
    for encoding in [Encoding::Png, Encoding::Jpeg { quality: 100 }] {
        let grey = encode(&scene(PixelFormat::Grey8, 20, 10), encoding).expect("encodes");
        let mut colour = Picture::default();
        decode(&grey.bytes, PixelFormat::Rgb8, &mut colour).expect("decodes");
        assert!(colour.pixels().chunks_exact(3).all(|rgb| rgb[0] == rgb[1] && rgb[1] == rgb[2]));

        let colour = encode(&scene(PixelFormat::Rgb8, 20, 10), encoding).expect("encodes");
        let mut grey = Picture::default();
        decode(&colour.bytes, PixelFormat::Grey8, &mut grey).expect("decodes");
        assert_eq!((grey.format(), grey.pixels().len()), (PixelFormat::Grey8, 200));
    }
}

#[test]
fn buffer_is_reused_for_pictures_of_other_sizes() {
    let mut buffer = Picture::default();
    for (width, height) in [(64, 48), (8, 8), (100, 3)] {
        let original = scene(PixelFormat::Rgb8, width, height);
        let part = encode(&original, Encoding::Png).expect("encodes");
        decode(&part.bytes, PixelFormat::Rgb8, &mut buffer).expect("decodes");
        assert_eq!(buffer, original);
    }
}
