//! Uncompressed pictures: `sensor_msgs/Image`.

use bytes::Bytes;
use peernet_ros::messages::Image;
use peernet_sample::{Description, ElementType, MediaType, Part, PixelFormat};

/// Defect of a message with a picture or a point cloud.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum PictureError {
    /// The encoding is not known.
    #[error(
        "the encoding {0:?} is not supported; publish rgb8, bgr8, mono8, mono16 or an OpenCV type such as 32FC1"
    )]
    Encoding(String),
    /// The rows overlap, or are longer than the data.
    #[error("{height} rows of {row_bytes} bytes, one every {step} bytes, do not fit into {available} bytes")]
    Rows { height: u32, row_bytes: u64, step: u32, available: usize },
}

/// Number of channels of a pixel, and their type.
struct PixelLayout {
    channels: u32,
    element: ElementType,
}

/// Rows of bytes that may have padding between them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rows {
    pub(super) height: u32,
    /// Number of bytes of a row without padding.
    pub(super) row_bytes: u64,
    /// Number of bytes from the start of a row to the start of the next row.
    pub(super) step: u32,
}

impl Rows {
    /// Returns the rows without padding. Copies them only if there is padding.
    pub(super) fn without_padding(self, data: &Bytes) -> Result<Bytes, PictureError> {
        let Self { height, row_bytes, step } = self;
        let error = PictureError::Rows { height, row_bytes, step, available: data.len() };
        let (Ok(row), Ok(stride), Ok(count)) =
            (usize::try_from(row_bytes), usize::try_from(step), usize::try_from(height))
        else {
            return Err(error);
        };
        if count == 0 || row == 0 {
            return Ok(Bytes::new());
        }
        // The sizes come from the publisher, so their products may overflow. The last row needs no padding.
        let required = (count - 1).checked_mul(stride).and_then(|before| before.checked_add(row));
        if (count > 1 && stride < row) || required.is_none_or(|required| required > data.len()) {
            return Err(error);
        }
        // Rows without padding share the bytes of the message.
        if stride == row || count == 1 {
            return Ok(data.slice(..row * count));
        }
        let mut without_padding = Vec::with_capacity(row * count);
        for index in 0..count {
            without_padding.extend_from_slice(&data[index * stride..index * stride + row]);
        }
        Ok(without_padding.into())
    }
}

/// Converts a picture to a part: the encodings `rgb8`, `bgr8` and `mono8` to decoded pixels, every other encoding to a
/// tensor of height, width and channels with little-endian elements.
///
/// # Errors
/// If the encoding is not known, or if there are fewer bytes than the description requires.
pub(super) fn picture_part(image: Image) -> Result<Part, PictureError> {
    let Image { height, width, encoding, is_bigendian, step, data, .. } = image;
    let (layout, description) = match encoding.as_str() {
        "rgb8" | "bgr8" => (
            PixelLayout { channels: 3, element: ElementType::U8 },
            Description::pixels(PixelFormat::Rgb8, width, height),
        ),
        "mono8" => (
            PixelLayout { channels: 1, element: ElementType::U8 },
            Description::pixels(PixelFormat::Grey8, width, height),
        ),
        _ => {
            let layout =
                PixelLayout::from_encoding(&encoding).ok_or(PictureError::Encoding(encoding.clone()))?;
            let (shape, element) = (vec![height, width, layout.channels], Some(layout.element));
            (layout, Description { media: MediaType::Tensor, shape, element })
        }
    };
    let element_bytes = layout.element.bytes();
    let row_bytes = u64::from(width).saturating_mul(u64::from(layout.channels)).saturating_mul(element_bytes);
    let mut bytes = Rows { height, row_bytes, step }.without_padding(&data)?;
    // Decoded pixels are always in the order red, green, blue.
    if encoding == "bgr8" {
        bytes = reverse_groups(&bytes, 3);
    } else if is_bigendian != 0 && element_bytes > 1 {
        bytes = reverse_groups(&bytes, element_bytes as usize);
    }
    Ok(Part { description, bytes })
}

/// Reverses the order of the bytes within each group of `size` bytes.
fn reverse_groups(bytes: &Bytes, size: usize) -> Bytes {
    let mut copy = bytes.to_vec();
    copy.chunks_exact_mut(size).for_each(<[u8]>::reverse);
    copy.into()
}

impl PixelLayout {
    /// Parses the name of an encoding, as `sensor_msgs/image_encodings.h` defines it.
    fn from_encoding(encoding: &str) -> Option<Self> {
        let layout = |channels, element| Some(Self { channels, element });
        match encoding {
            "rgba8" | "bgra8" => return layout(4, ElementType::U8),
            "rgb16" | "bgr16" => return layout(3, ElementType::U16),
            "rgba16" | "bgra16" => return layout(4, ElementType::U16),
            "mono16" => return layout(1, ElementType::U16),
            "yuv422" | "yuv422_yuy2" | "uyvy" | "yuyv" => return layout(2, ElementType::U8),
            bayer if bayer.starts_with("bayer_") && bayer.ends_with("16") => {
                return layout(1, ElementType::U16);
            }
            bayer if bayer.starts_with("bayer_") && bayer.ends_with('8') => {
                return layout(1, ElementType::U8);
            }
            _ => {}
        }
        // OpenCV's types, such as 32FC1; the number of channels may be missing.
        let (depth, channels) = encoding.split_once('C')?;
        let element = match depth {
            "8U" => ElementType::U8,
            "8S" => ElementType::I8,
            "16U" => ElementType::U16,
            "16S" => ElementType::I16,
            "32S" => ElementType::I32,
            "32F" => ElementType::F32,
            "64F" => ElementType::F64,
            _ => return None,
        };
        let channels = if channels.is_empty() { 1 } else { channels.parse().ok()? };
        // 512 is the maximum number of channels in OpenCV (CV_CN_MAX).
        (1..=512).contains(&channels).then_some(Self { channels, element })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(encoding: &str, width: u32, step: u32, data: &'static [u8]) -> Image {
        let (encoding, data) = (encoding.to_owned(), Bytes::from_static(data));
        Image { height: 2, width, encoding, step, data, ..Image::default() }
    }

    #[test]
    fn colour_channels_are_in_rgb_order() {
        let rgb = picture_part(image("rgb8", 1, 3, b"RGBrgb")).expect("fits");
        let bgr = picture_part(image("bgr8", 1, 3, b"BGRbgr")).expect("fits");
        assert_eq!((&rgb.bytes, &rgb.description), (&bgr.bytes, &bgr.description));
        assert_eq!(rgb.description, Description::pixels(PixelFormat::Rgb8, 1, 2));
        assert_eq!(rgb.bytes, "RGBrgb");
    }

    #[test]
    fn padding_between_rows_is_removed() {
        let grey = picture_part(image("mono8", 2, 4, b"ab..cd")).expect("the last row may lack its padding");
        assert_eq!(grey.bytes, "abcd");
        let unpadded = image("mono8", 2, 2, b"abcd");
        let data = unpadded.data.clone();
        assert_eq!(picture_part(unpadded).expect("fits").bytes.as_ptr(), data.as_ptr(), "nothing is copied");
    }

    #[test]
    fn big_endian_depth_becomes_little_endian_tensor() {
        let mut depth = image("16UC1", 1, 2, &[1, 2, 3, 4]);
        depth.is_bigendian = 1;
        let part = picture_part(depth).expect("fits");
        assert_eq!(part.bytes.as_ref(), [2, 1, 4, 3]);
        assert_eq!(
            (part.description.shape.as_slice(), part.description.element),
            (&[2, 1, 1][..], Some(ElementType::U16))
        );
    }

    #[test]
    fn picture_with_wrong_size_or_encoding_is_refused() {
        for (width, step) in [(2, 1), (3, 3), (u32::MAX, u32::MAX)] {
            let error = picture_part(image("mono8", width, step, b"abcd")).expect_err("does not fit");
            assert!(matches!(error, PictureError::Rows { .. }), "{error}");
        }
        let error = picture_part(image("jpeg", 1, 1, b"ab")).expect_err("is no encoding").to_string();
        assert!(error.contains("\"jpeg\""), "{error}");
        assert!(picture_part(image("64FC99999999999", 1, 1, b"ab")).is_err());
        assert_eq!(picture_part(image("mono8", 0, 0, b"")).expect("is empty").bytes, "");
    }
}
