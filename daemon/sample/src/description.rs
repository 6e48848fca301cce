//! Description of the bytes of a payload part.

use serde::{Deserialize, Serialize};

/// Media type, shape and element type of one payload part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Description {
    /// Kind of content.
    pub media: MediaType,
    /// Lengths of the dimensions, outermost first; empty for an array of one element without dimensions, and for
    /// content without shape. For pictures: height, width, channels.
    #[serde(default)]
    pub shape: Vec<u32>,
    /// Type of one element of `shape`; `None` if there is no shape.
    #[serde(default)]
    pub element: Option<ElementType>,
}

/// Kind of content.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MediaType {
    /// Bytes without further meaning.
    Bytes,
    /// A JPEG file.
    Jpeg,
    /// A PNG file.
    Png,
    /// Decoded pixels, rows from top to bottom, without padding; the shape is height, width, channels.
    Pixels(PixelFormat),
    /// A dense array in row-major order, little-endian.
    Tensor,
    /// UTF-8 text.
    Text,
    /// A JSON document, such as the answer of a model; `peernet-inference` defines the keys of answers.
    Json,
    /// Any other media type, with its IANA name.
    Other(String),
}

/// Order of the channels of decoded pixels, one byte each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PixelFormat {
    /// Red, green, blue.
    Rgb8,
    /// One channel.
    Grey8,
}

impl PixelFormat {
    /// Returns the number of bytes per pixel.
    pub const fn channels(self) -> u32 {
        match self {
            Self::Rgb8 => 3,
            Self::Grey8 => 1,
        }
    }
}

/// Type of one array element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ElementType {
    /// Unsigned byte.
    U8,
    /// 32-bit float.
    F32,
    /// 64-bit float.
    F64,
    /// 64-bit signed integer.
    I64,
    /// Boolean, one byte: 0 or 1.
    Bool,
    /// Signed byte.
    I8,
    /// 16-bit unsigned integer.
    U16,
    /// 16-bit signed integer.
    I16,
    /// 32-bit unsigned integer.
    U32,
    /// 32-bit signed integer.
    I32,
    /// 64-bit unsigned integer.
    U64,
    /// 16-bit float.
    F16,
    /// Complex number of two 32-bit floats, the real part first.
    C64,
    /// Complex number of two 64-bit floats, the real part first.
    C128,
}

impl ElementType {
    /// Returns the number of bytes of one element.
    pub const fn bytes(self) -> u64 {
        match self {
            Self::Bool | Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 | Self::C64 => 8,
            Self::C128 => 16,
        }
    }
}

impl Description {
    /// Creates a description without shape.
    pub const fn unshaped(media: MediaType) -> Self {
        Self { media, shape: Vec::new(), element: None }
    }

    /// Creates the description of bytes without further meaning.
    pub const fn bytes() -> Self {
        Self::unshaped(MediaType::Bytes)
    }

    /// Returns the number of bytes of a part with this description; `None` if the description has no element type, or
    /// if the number overflows.
    pub fn shaped_bytes(&self) -> Option<u64> {
        let mut dimensions = self.shape.iter().map(|length| u64::from(*length));
        self.element.and_then(|element| dimensions.try_fold(element.bytes(), u64::checked_mul))
    }

    /// Creates the description of decoded pixels of the given size.
    pub fn pixels(format: PixelFormat, width: u32, height: u32) -> Self {
        Self {
            media: MediaType::Pixels(format),
            shape: vec![height, width, format.channels()],
            element: Some(ElementType::U8),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shape_determines_number_of_bytes() {
        assert_eq!(Description::pixels(PixelFormat::Rgb8, 4, 3).shaped_bytes(), Some(36));
        let tensor_bytes = |shape: &[u32]| {
            let (shape, element) = (shape.to_vec(), Some(ElementType::F64));
            Description { media: MediaType::Tensor, shape, element }.shaped_bytes()
        };
        let lengths = (tensor_bytes(&[]), tensor_bytes(&[2, 0]), tensor_bytes(&[u32::MAX; 3]));
        assert_eq!(lengths, (Some(8), Some(0), None));
        assert_eq!(Description::bytes().shaped_bytes(), None);
    }

    #[test]
    fn descriptions_round_trip() {
        let tensor =
            Description { media: MediaType::Tensor, shape: vec![1, 3, 4], element: Some(ElementType::F32) };
        let all = [
            Description::bytes(),
            Description::pixels(PixelFormat::Rgb8, 1280, 960),
            Description::unshaped(MediaType::Other("application/x-own".into())),
            tensor,
        ];
        for description in all {
            let wire = rmp_serde::to_vec(&description).expect("serialises");
            assert_eq!(rmp_serde::from_slice::<Description>(&wire).expect("reads back"), description);
        }
    }
}
