//! Format and size of a picture, read from its header.

use peernet_sample::{MediaType, Part, PixelFormat};

use crate::ImageError;
use crate::decode::{detect_format, open_jpeg, open_png};
use crate::size::pixels_size;

/// Format and size of a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Format: [`MediaType::Jpeg`], [`MediaType::Png`] or decoded pixels.
    pub media: MediaType,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

/// Returns format and size of a JPEG or PNG file, without decoding it.
///
/// # Errors
/// If the file has another format, if its header is damaged, or if its size is beyond
/// [`MAX_PIXELS`](crate::MAX_PIXELS) or [`MAX_SIDE`](crate::MAX_SIDE).
pub fn probe(file: &[u8]) -> Result<Header, ImageError> {
    let media = detect_format(file)?;
    let (width, height) = if media == MediaType::Jpeg {
        // The pixel format has no effect, because only the header is read.
        let opened = open_jpeg(file, PixelFormat::Rgb8)?;
        (opened.width, opened.height)
    } else {
        let opened = open_png(file)?;
        (opened.width, opened.height)
    };
    Ok(Header { media, width, height })
}

/// Returns format and size of a payload part, a file or decoded pixels, without decoding it.
///
/// # Errors
/// If the part is not a picture, or is damaged.
pub fn probe_part(part: &Part) -> Result<Header, ImageError> {
    match &part.description.media {
        MediaType::Jpeg | MediaType::Png => probe(&part.bytes),
        MediaType::Pixels(format) => {
            let (width, height) = pixels_size(part, *format)?;
            Ok(Header { media: MediaType::Pixels(*format), width, height })
        }
        media => Err(ImageError::NotAPicture(media.clone())),
    }
}
