//! Masks of segmentations: PNG files whose pixel values are class numbers.

use std::io::Cursor;

use peernet_sample::{PixelFormat, printable_line};
use png::{BitDepth, ColorType, DecodingError};

use crate::size::check_size;
use crate::{ImageError, Picture};

/// Decodes a mask: an indexed or grey PNG file of 1 to 8 bits per pixel. Each byte of the result is the class number of
/// a pixel. In an indexed file the palette indices are the class numbers; the colours of the palette have no meaning.
///
/// # Errors
/// If the file is not such a PNG file, is damaged or truncated, or is too large.
pub fn decode_class_mask(file: &[u8]) -> Result<Picture, ImageError> {
    let decoding_error =
        |error: DecodingError| damaged_png(printable_line(&error.to_string()).trim_end_matches('.'));
    // The crate `image` cannot decode masks, because it replaces palette indices by colours.
    let mut reader = png::Decoder::new(Cursor::new(file)).read_info().map_err(decoding_error)?;
    let (width, height) = (reader.info().width, reader.info().height);
    check_size(u64::from(width), u64::from(height))?;
    let bits = match reader.output_color_type() {
        (ColorType::Indexed | ColorType::Grayscale, BitDepth::One) => 1,
        (ColorType::Indexed | ColorType::Grayscale, BitDepth::Two) => 2,
        (ColorType::Indexed | ColorType::Grayscale, BitDepth::Four) => 4,
        (ColorType::Indexed | ColorType::Grayscale, BitDepth::Eight) => 8,
        _ => return Err(damaged_png("a mask has a palette or is grey, with at most 8 bits per pixel")),
    };
    let row_bytes = reader.output_line_size(width).ok_or_else(|| damaged_png("its rows are too long"))?;
    let size = reader.output_buffer_size().ok_or_else(|| damaged_png("it is too large"))?;
    let mut packed_rows = vec![0; size];
    reader.next_frame(&mut packed_rows).map_err(decoding_error)?;
    let pixels = if bits == 8 {
        packed_rows
    } else {
        packed_rows.chunks_exact(row_bytes).flat_map(|row| unpack(row, bits).take(width as usize)).collect()
    };
    Picture::new(PixelFormat::Grey8, width, height, pixels)
}

/// Returns the pixel values of a row in which each byte has several values of `bits` bits; the first value is in the
/// highest bits.
fn unpack(row: &[u8], bits: u32) -> impl Iterator<Item = u8> {
    let positions = (0..8 / bits).rev();
    row.iter().flat_map(move |byte| {
        positions.clone().map(move |position| (byte >> (position * bits)) & ((1 << bits) - 1))
    })
}

fn damaged_png(reason: &str) -> ImageError {
    ImageError::Damaged { format: "png", reason: reason.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a PNG file with the given packed rows.
    fn png(color: ColorType, depth: BitDepth, (width, height): (u32, u32), rows: &[u8]) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, width, height);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == ColorType::Indexed {
            // All colours are equal, so only the numbers distinguish the classes.
            encoder.set_palette(vec![7; 3 * 256]);
        }
        let mut writer = encoder.write_header().expect("has a size");
        writer.write_image_data(rows).expect("fits");
        writer.finish().expect("is written");
        file
    }

    #[test]
    fn pixel_values_are_class_numbers() {
        for (color, depth, rows, expected) in [
            (ColorType::Indexed, BitDepth::Eight, &[0, 3, 255, 1, 2, 0][..], [0, 3, 255, 1, 2, 0]),
            (ColorType::Grayscale, BitDepth::Eight, &[0, 3, 255, 1, 2, 0], [0, 3, 255, 1, 2, 0]),
            (ColorType::Indexed, BitDepth::Four, &[0x1f, 0x20, 0x34, 0x50], [1, 15, 2, 3, 4, 5]),
            (ColorType::Indexed, BitDepth::Two, &[0b0001_1000, 0b1110_0000], [0, 1, 2, 3, 2, 0]),
            (ColorType::Grayscale, BitDepth::One, &[0b1010_0000, 0b0110_0000], [1, 0, 1, 0, 1, 1]),
        ] {
            let mask = decode_class_mask(&png(color, depth, (3, 2), rows)).expect("is a mask");
            assert_eq!((mask.width(), mask.height(), mask.pixels()), (3, 2, &expected[..]), "{depth:?}");
        }
    }

    #[test]
    fn file_that_is_no_mask_is_refused_with_reason() {
        let colours = png(ColorType::Rgb, BitDepth::Eight, (1, 1), &[1, 2, 3]);
        let sixteen_bits = png(ColorType::Grayscale, BitDepth::Sixteen, (1, 1), &[1, 2]);
        for file in [&colours, &sixteen_bits] {
            let error = decode_class_mask(file).expect_err("is no mask").to_string();
            assert!(error.contains("a mask has a palette or is grey"), "{error}");
        }
        let mask = png(ColorType::Indexed, BitDepth::Eight, (3, 2), &[0; 6]);
        for file in [&b"\xff\xd8\xff"[..], &mask[..mask.len() / 2], &[]] {
            assert!(matches!(decode_class_mask(file), Err(ImageError::Damaged { format: "png", .. })));
        }
    }
}
