//! Decoded pixels.

use bytes::Bytes;
use peernet_sample::{Description, Part, PixelFormat};

use crate::ImageError;
use crate::size::{check_length, pixel_bytes};

/// Decoded pixels, rows from top to bottom, without padding, one byte per channel.
///
/// Decoding, resizing, cropping and padding use a picture as the buffer for their result. The default is an empty
/// picture, 0 × 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    format: PixelFormat,
    width: u32,
    height: u32,
    pixels: Vec<u8>,
}

impl Default for Picture {
    fn default() -> Self {
        Self { format: PixelFormat::Rgb8, width: 0, height: 0, pixels: Vec::new() }
    }
}

impl Picture {
    /// Creates a picture from its pixels.
    ///
    /// # Errors
    /// If the size is not permitted, or contradicts the number of bytes.
    pub fn new(format: PixelFormat, width: u32, height: u32, pixels: Vec<u8>) -> Result<Self, ImageError> {
        check_length(format, width, height, pixels.len())?;
        Ok(Self { format, width, height, pixels })
    }

    /// Returns the order of the channels.
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    /// Returns the number of pixels per row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Returns the number of rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Returns the pixels: height × width × channels bytes.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Converts the picture to a payload part; the pixels are moved, not copied.
    pub fn into_part(self) -> Part {
        let description = Description::pixels(self.format, self.width, self.height);
        Part { description, bytes: Bytes::from(self.pixels) }
    }

    /// Changes format and size, and returns the bytes of the pixels. Their values are undefined until the caller
    /// overwrites them.
    pub(crate) fn reshape(&mut self, format: PixelFormat, width: u32, height: u32) -> &mut [u8] {
        (self.format, self.width, self.height) = (format, width, height);
        // The allocation is reused, so that a stream of pictures of one size allocates memory once.
        self.pixels.resize(pixel_bytes(format, width, height) as usize, 0);
        &mut self.pixels
    }

    /// Copies `pixels` of the format `from` into this picture, converted to the format `to`.
    pub(crate) fn assign(
        &mut self,
        from: PixelFormat,
        to: PixelFormat,
        width: u32,
        height: u32,
        pixels: &[u8],
    ) {
        let target = self.reshape(to, width, height);
        match (from, to) {
            (PixelFormat::Rgb8, PixelFormat::Rgb8) | (PixelFormat::Grey8, PixelFormat::Grey8) => {
                target.copy_from_slice(pixels);
            }
            (PixelFormat::Grey8, PixelFormat::Rgb8) => {
                for (rgb, grey) in target.chunks_exact_mut(3).zip(pixels) {
                    rgb.fill(*grey);
                }
            }
            (PixelFormat::Rgb8, PixelFormat::Grey8) => {
                for (grey, rgb) in target.iter_mut().zip(pixels.chunks_exact(3)) {
                    *grey = luma([rgb[0], rgb[1], rgb[2]]);
                }
            }
        }
    }
}

/// Returns the brightness of a colour, with the weights of ITU-R BT.601, which JPEG uses, in 16-bit fixed point.
fn luma([r, g, b]: [u8; 3]) -> u8 {
    let sum = 19_595 * u32::from(r) + 38_470 * u32::from(g) + 7_471 * u32::from(b);
    ((sum + 0x8000) >> 16) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn size_that_contradicts_bytes_is_refused() {
        assert!(Picture::new(PixelFormat::Grey8, 2, 3, vec![0; 6]).is_ok());
        assert!(matches!(
            Picture::new(PixelFormat::Rgb8, 2, 3, vec![0; 6]),
            Err(ImageError::Length { expected: 18, actual: 6, .. })
        ));
        assert!(matches!(Picture::new(PixelFormat::Rgb8, 0, 3, vec![]), Err(ImageError::Size { .. })));
        let too_large = Picture::new(PixelFormat::Rgb8, u32::MAX, u32::MAX, vec![0; 6]);
        assert!(matches!(too_large, Err(ImageError::Size { .. })));
    }

    #[test]
    fn grey_and_colour_convert_to_each_other() {
        assert_eq!([luma([0, 0, 0]), luma([255, 255, 255]), luma([255, 0, 0])], [0, 255, 76]);
        let mut colour = Picture::default();
        colour.assign(PixelFormat::Grey8, PixelFormat::Rgb8, 2, 1, &[7, 9]);
        assert_eq!(colour.pixels(), [7, 7, 7, 9, 9, 9]);
        let mut grey = Picture::default();
        grey.assign(PixelFormat::Rgb8, PixelFormat::Grey8, 2, 1, colour.pixels());
        assert_eq!(grey.pixels(), [7, 9]);
    }
}
