//! Why something is not a picture, or cannot become one.

use peernet_sample::MediaType;

use crate::limits::{MAX_PIXELS, MAX_SIDE};

/// Why a picture could not be read, changed or written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// The bytes do not begin as a JPEG or PNG file does.
    #[error("it is neither a jpeg nor a png file")]
    UnknownFormat,
    /// A payload that holds no picture.
    #[error("it is {}, not a picture", described(.0))]
    NotAPicture(MediaType),
    /// The file is damaged, cut off or of a kind that is not supported.
    #[error("the {format} file cannot be read: {reason}")]
    Damaged {
        /// `jpeg` or `png`.
        format: &'static str,
        /// What the decoder said.
        reason: String,
    },
    /// The picture has no pixels or more than this program takes.
    #[error(
        "{width} × {height} pixels are not possible: sides go from 1 to {MAX_SIDE}, \
         and no picture has more than {MAX_PIXELS} pixels"
    )]
    Size {
        /// Pixels.
        width: u64,
        /// Pixels.
        height: u64,
    },
    /// Decoded pixels whose description does not fit their bytes.
    #[error("{width} × {height} pixels of {channels} bytes need {expected} bytes, there are {actual}")]
    Length {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// Bytes per pixel.
        channels: u32,
        /// Bytes that follow from the description.
        expected: u64,
        /// Bytes that are there.
        actual: u64,
    },
    /// The description of decoded pixels lacks their shape.
    #[error("its description gives the shape {0:?} instead of height, width and channels")]
    Shape(Vec<u32>),
    /// A rectangle that reaches beyond the picture.
    #[error(
        "a rectangle of {width} × {height} at {x}, {y} does not lie within {of_width} × {of_height} pixels"
    )]
    Outside {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// Left edge, pixels.
        x: u32,
        /// Upper edge, pixels.
        y: u32,
        /// Width of the picture.
        of_width: u32,
        /// Height of the picture.
        of_height: u32,
    },
    /// The picture could not be written.
    #[error("cannot write a {format} file of {width} × {height} pixels: {reason}")]
    Unwritable {
        /// `jpeg` or `png`.
        format: &'static str,
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// What the encoder said.
        reason: String,
    },
}

fn described(media: &MediaType) -> String {
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
