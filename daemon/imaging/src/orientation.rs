//! Orientation of pictures, which cameras write into their files.

use image::ImageDecoder;
use image::metadata::Orientation as Tag;
use peernet_sample::{MediaType, Part, PixelFormat};
use serde::{Deserialize, Serialize};

use crate::decode::{detect_format, open_jpeg, open_png};
use crate::{ImageError, Picture};

/// Orientation of a decoded picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Orientation {
    /// As the pixels are stored, as in most training code.
    #[default]
    Stored,
    /// Upright: turned and mirrored as the EXIF tag of the file states.
    Exif,
}

impl Orientation {
    /// Returns whether the pixels stay as they are stored, which is the default.
    pub fn is_stored(&self) -> bool {
        *self == Self::Stored
    }
}

/// Turns `picture`, which was read from `part`, upright as the EXIF tag in the file states. Without a valid tag the
/// picture stays unchanged.
///
/// # Errors
/// If the header of the file cannot be read.
pub fn turn_upright(part: &Part, picture: &mut Picture) -> Result<(), ImageError> {
    if !matches!(part.description.media, MediaType::Jpeg | MediaType::Png) {
        return Ok(());
    }
    // The first bytes determine the format here, as in `read_part`, because the description may name a wrong format.
    let exif = if detect_format(&part.bytes)? == MediaType::Jpeg {
        // The pixel format has no effect, because only the header is read.
        open_jpeg(&part.bytes, PixelFormat::Rgb8)?.decoder.exif().cloned()
    } else {
        open_png(&part.bytes)?.decoder.exif_metadata().ok().flatten()
    };
    match exif.as_deref().and_then(Tag::from_exif_chunk) {
        None | Some(Tag::NoTransforms) => {}
        Some(tag) => *picture = turn_picture(picture, tag),
    }
    Ok(())
}

fn turn_picture(picture: &Picture, tag: Tag) -> Picture {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let is_sideways =
        matches!(tag, Tag::Rotate90 | Tag::Rotate270 | Tag::Rotate90FlipH | Tag::Rotate270FlipH);
    let (columns, rows) = if is_sideways { (height, width) } else { (width, height) };
    let channels = picture.format().channels() as usize;
    let mut target = Picture::default();
    let pixels = target.reshape(picture.format(), columns as u32, rows as u32);
    for (row, line) in pixels.chunks_exact_mut(columns * channels).enumerate() {
        for (column, pixel) in line.chunks_exact_mut(channels).enumerate() {
            // Position in `picture` of the pixel that belongs at this row and column of `target`.
            let (x, y) = match tag {
                Tag::NoTransforms => (column, row),
                Tag::FlipHorizontal => (width - 1 - column, row),
                Tag::Rotate180 => (width - 1 - column, height - 1 - row),
                Tag::FlipVertical => (column, height - 1 - row),
                Tag::Rotate90FlipH => (row, column),
                Tag::Rotate90 => (row, height - 1 - column),
                Tag::Rotate270FlipH => (width - 1 - row, height - 1 - column),
                Tag::Rotate270 => (width - 1 - row, column),
            };
            let from = (y * width + x) * channels;
            pixel.copy_from_slice(&picture.pixels()[from..from + channels]);
        }
    }
    target
}

#[cfg(test)]
mod tests {
    use image::DynamicImage;
    use peernet_sample::Description;

    use super::*;
    use crate::{decode, read_part};

    /// Returns EXIF data whose only entry is the orientation.
    fn exif(orientation: u8) -> Vec<u8> {
        let mut exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
        exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
        exif
    }

    fn jpeg(exif: &[u8]) -> Part {
        let pixels: Vec<u8> = (0..24 * 16 * 3).map(|byte| (byte / 5) as u8).collect();
        let mut file = Vec::new();
        let mut encoder = jpeg_encoder::Encoder::new(&mut file, 90);
        encoder.add_exif_metadata(exif).expect("fits");
        encoder.encode(&pixels, 24, 16, jpeg_encoder::ColorType::Rgb).expect("encoded");
        Part { description: Description::unshaped(MediaType::Jpeg), bytes: file.into() }
    }

    #[test]
    fn orientations_agree_with_image_crate() {
        for number in 1..=8 {
            let part = jpeg(&exif(number));
            let mut picture = Picture::default();
            read_part(&part, PixelFormat::Rgb8, &mut picture).expect("is whole");
            let stored = image::RgbImage::from_raw(24, 16, picture.pixels().to_vec()).expect("fits");
            let mut expected = DynamicImage::from(stored);
            expected.apply_orientation(Tag::from_exif(number).expect("is defined"));
            turn_upright(&part, &mut picture).expect("has a header");
            assert_eq!(
                (picture.width(), picture.height()),
                (expected.width(), expected.height()),
                "{number}"
            );
            assert_eq!(picture.pixels(), expected.as_bytes(), "{number}");
        }
    }

    #[test]
    fn file_with_wrong_description_is_turned_upright() {
        // With orientation 6, the upright picture has the width and the height exchanged.
        let part = Part { description: Description::unshaped(MediaType::Png), ..jpeg(&exif(6)) };
        let mut picture = Picture::default();
        read_part(&part, PixelFormat::Rgb8, &mut picture).expect("is whole");
        turn_upright(&part, &mut picture).expect("has a header");
        assert_eq!((picture.width(), picture.height()), (16, 24));
    }

    #[test]
    fn invalid_orientation_leaves_picture_as_stored() {
        for exif in [exif(9), exif(0), b"II*\0\xff\xff\xff\xff".to_vec(), b"no EXIF".to_vec()] {
            let part = jpeg(&exif);
            let (mut stored, mut upright) = (Picture::default(), Picture::default());
            decode(&part.bytes, PixelFormat::Rgb8, &mut stored).expect("is whole");
            read_part(&part, PixelFormat::Rgb8, &mut upright).expect("is whole");
            turn_upright(&part, &mut upright).expect("has a header");
            assert_eq!(stored, upright);
        }
    }
}
