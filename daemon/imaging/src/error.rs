//! Errors of reading, changing and writing pictures.

use peernet_sample::MediaType;

use crate::limits::{MAX_PIXELS, MAX_SIDE};

/// Reason why a picture cannot be read, changed or written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// The bytes do not start like a JPEG or PNG file.
    #[error("it is neither a jpeg nor a png file")]
    UnknownFormat,
    /// The payload is not a picture.
    #[error("it is {}, not a picture", media_text(.0))]
    NotAPicture(MediaType),
    /// The file is damaged, truncated or of an unsupported kind.
    #[error("the {format} file cannot be read: {reason}")]
    Damaged {
        /// Format: `jpeg` or `png`.
        format: &'static str,
        /// Message of the decoder.
        reason: String,
    },
    /// The picture has no pixels, too many pixels or too long a side.
    #[error(
        "a size of {width} × {height} pixels is not supported: each side has 1 to {MAX_SIDE} pixels, \
         and a picture has at most {MAX_PIXELS} pixels"
    )]
    Size {
        /// Width, pixels.
        width: u64,
        /// Height, pixels.
        height: u64,
    },
    /// The description of decoded pixels does not fit their bytes.
    #[error("{width} × {height} pixels of {channels} bytes need {expected} bytes, there are {actual}")]
    Length {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Bytes per pixel.
        channels: u32,
        /// Number of bytes according to the description.
        expected: u64,
        /// Number of bytes in the payload.
        actual: u64,
    },
    /// The shape in the description of decoded pixels is not height, width and the number of channels.
    #[error("its description gives the shape {0:?} instead of height, width and channels")]
    Shape(Vec<u32>),
    /// The rectangle reaches beyond the picture.
    #[error(
        "a rectangle of {width} × {height} at {x}, {y} is not within {outer_width} × {outer_height} pixels"
    )]
    Outside {
        /// Width of the rectangle, pixels.
        width: u32,
        /// Height of the rectangle, pixels.
        height: u32,
        /// Left edge, pixels.
        x: u32,
        /// Upper edge, pixels.
        y: u32,
        /// Width of the picture, pixels.
        outer_width: u32,
        /// Height of the picture, pixels.
        outer_height: u32,
    },
    /// The picture cannot be encoded.
    #[error("cannot write a {format} file of {width} × {height} pixels: {reason}")]
    Unwritable {
        /// Format: `jpeg` or `png`.
        format: &'static str,
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Message of the encoder.
        reason: String,
    },
}

fn media_text(media: &MediaType) -> String {
    match media {
        MediaType::Bytes => "plain bytes".to_owned(),
        MediaType::Jpeg => "a jpeg file".to_owned(),
        MediaType::Png => "a png file".to_owned(),
        MediaType::Pixels(_) => "decoded pixels".to_owned(),
        MediaType::Tensor => "an array".to_owned(),
        MediaType::Text => "text".to_owned(),
        MediaType::Json => "json".to_owned(),
        MediaType::Other(name) => format!("of type {name:?}"),
    }
}
