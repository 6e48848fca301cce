use peernet_imaging::{Encoding, ImageError, Picture, decode, encode, probe, read_part};
use peernet_sample::{Description, ElementType, MediaType, Part, PixelFormat};
use proptest::prelude::*;

use super::scene;

fn file(encoding: Encoding) -> Vec<u8> {
    encode(&scene(PixelFormat::Rgb8, 48, 32), encoding).expect("encodes").bytes.to_vec()
}

fn try_decode(bytes: &[u8]) -> Result<(), ImageError> {
    decode(bytes, PixelFormat::Rgb8, &mut Picture::default())
}

/// Returns the checksum of a PNG chunk (CRC-32), so that a forged header is not refused because of its checksum.
fn checksum(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(
            crc ^ u32::from(*byte),
            |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 },
        )
    })
}

#[test]
fn truncated_file_is_an_error() {
    for encoding in [Encoding::Png, Encoding::Jpeg { quality: 85 }] {
        let file = file(encoding);
        // The last bytes are excluded: without its end marker, a file still has the complete picture.
        for length in 0..file.len() - 24 {
            assert!(
                try_decode(&file[..length]).is_err(),
                "{encoding:?} truncated to {length} of {}",
                file.len()
            );
        }
    }
}

#[test]
fn unknown_format_is_refused() {
    assert_eq!(try_decode(b""), Err(ImageError::UnknownFormat));
    assert_eq!(try_decode(b"GIF89a"), Err(ImageError::UnknownFormat));
    let text = Part { description: Description::unshaped(MediaType::Text), bytes: "hello".into() };
    let error = read_part(&text, PixelFormat::Rgb8, &mut Picture::default()).expect_err("is text");
    assert_eq!(error.to_string(), "it is text, not a picture");
}

#[test]
fn jpeg_that_claims_to_be_huge_is_refused() {
    let mut jpeg = file(Encoding::Jpeg { quality: 85 });
    let frame = jpeg.windows(2).position(|pair| pair == [0xff, 0xc0]).expect("has a frame header");
    jpeg[frame + 5..frame + 9].fill(0xff);
    assert!(probe(&jpeg).is_err());
    assert!(try_decode(&jpeg).is_err());
    jpeg[frame + 5..frame + 9].copy_from_slice(&[0x7f, 0xff, 0x7f, 0xff]);
    assert!(matches!(try_decode(&jpeg), Err(ImageError::Size { width: 32_767, height: 32_767 })));
}

#[test]
fn png_that_claims_to_be_huge_is_refused() {
    let mut png = file(Encoding::Png);
    for side in [100_000u32, 1 << 31, 20_000] {
        png[16..20].copy_from_slice(&side.to_be_bytes());
        png[20..24].copy_from_slice(&side.to_be_bytes());
        let sum = checksum(&png[12..29]);
        png[29..33].copy_from_slice(&sum.to_be_bytes());
        assert!(probe(&png).is_err(), "{side}");
        assert!(try_decode(&png).is_err(), "{side}");
    }
    assert!(matches!(probe(&png), Err(ImageError::Size { width: 20_000, height: 20_000 })));
}

#[test]
fn pixels_whose_description_lies_are_refused() {
    let read = |shape: &[u32], length: usize| {
        let media = MediaType::Pixels(PixelFormat::Rgb8);
        let description = Description { media, shape: shape.to_vec(), element: Some(ElementType::U8) };
        let part = Part { description, bytes: vec![0; length].into() };
        read_part(&part, PixelFormat::Rgb8, &mut Picture::default())
    };
    assert_eq!(read(&[2, 3, 3], 18), Ok(()));
    assert!(matches!(read(&[2, 3, 3], 17), Err(ImageError::Length { .. })));
    assert!(matches!(read(&[u32::MAX, u32::MAX, 3], 18), Err(ImageError::Size { .. })));
    assert!(matches!(read(&[2, 9], 18), Err(ImageError::Shape(_))));
    assert!(matches!(read(&[2, 9, 1], 18), Err(ImageError::Shape(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// Any bytes lead to a picture or an error, never to a panic.
    #[test]
    fn damaged_files_never_panic(
        png: bool,
        quality in 1u8..=100,
        damage in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..12),
        length in any::<proptest::sample::Index>(),
    ) {
        let mut bytes = file(if png { Encoding::Png } else { Encoding::Jpeg { quality } });
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        let _ = (probe(&bytes), try_decode(&bytes));
        bytes.truncate(length.index(bytes.len()));
        let _ = (probe(&bytes), try_decode(&bytes));
    }

    #[test]
    fn bytes_after_valid_start_never_panic(png: bool, tail in proptest::collection::vec(any::<u8>(), 0..300)) {
        let mut bytes = if png { b"\x89PNG\r\n\x1a\n".to_vec() } else { vec![0xff, 0xd8, 0xff] };
        bytes.extend(tail);
        let _ = (probe(&bytes), try_decode(&bytes));
    }
}
