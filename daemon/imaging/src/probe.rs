//! Format and size of a picture from its header alone.

use peernet_sample::{MediaType, Part, PixelFormat};

use crate::ImageError;
use crate::decode::{open_jpeg, open_png};
use crate::picture::check_length;

/// The most pixels a picture may have: 8192 × 8192, 192 MiB in colour. A file of a few bytes can claim more.
pub const MAX_PIXELS: u64 = 1 << 26;

/// The longest side a picture may have.
pub const MAX_SIDE: u64 = 1 << 15;

/// What a picture's header says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// [`MediaType::Jpeg`], [`MediaType::Png`] or decoded pixels.
    pub media: MediaType,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
}

const JPEG: &[u8] = &[0xff, 0xd8, 0xff];
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

/// The format of a file by its first bytes, whatever its name or description says.
pub(crate) fn recognise(file: &[u8]) -> Result<MediaType, ImageError> {
    match file {
        file if file.starts_with(JPEG) => Ok(MediaType::Jpeg),
        file if file.starts_with(PNG) => Ok(MediaType::Png),
        _ => Err(ImageError::UnknownFormat),
    }
}

/// Format and size of a JPEG or PNG file, without decoding it.
///
/// # Errors
/// When it is neither, when its header is damaged, or when its size is beyond [`MAX_PIXELS`] or [`MAX_SIDE`].
pub fn probe(file: &[u8]) -> Result<Header, ImageError> {
    let media = recognise(file)?;
    let (width, height) = if media == MediaType::Jpeg {
        let opened = open_jpeg(file, PixelFormat::Rgb8)?;
        (opened.width, opened.height)
    } else {
        let opened = open_png(file)?;
        (opened.width, opened.height)
    };
    Ok(Header { media, width, height })
}

/// Format and size of a payload part, a file or decoded pixels, without decoding it.
///
/// # Errors
/// When it is no picture, or a damaged one.
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

/// Width and height of decoded pixels, checked against their bytes.
pub(crate) fn pixels_size(part: &Part, format: PixelFormat) -> Result<(u32, u32), ImageError> {
    let shape = &part.description.shape;
    let &[height, width, channels] = shape.as_slice() else {
        return Err(ImageError::Shape(shape.clone()));
    };
    if channels != format.channels() {
        return Err(ImageError::Shape(shape.clone()));
    }
    check_length(format, width, height, part.bytes.len())?;
    Ok((width, height))
}

/// Refuses sizes that no picture has or that would take too much memory.
pub(crate) fn check_size(width: u64, height: u64) -> Result<(), ImageError> {
    let sides = 1..=MAX_SIDE;
    if sides.contains(&width) && sides.contains(&height) && width * height <= MAX_PIXELS {
        Ok(())
    } else {
        Err(ImageError::Size { width, height })
    }
}
