//! Encoding of pixels to files.

use bytes::Bytes;
use image::ImageEncoder;
use image::codecs::png::PngEncoder;
use peernet_sample::{Description, MediaType, Part, PixelFormat};

use crate::{ImageError, Picture};

/// File format of an encoded picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Baseline JPEG.
    Jpeg {
        /// Quality on libjpeg's scale, 1 (small) to 100 (good); values outside are clamped. From 90 on, colour has full
        /// resolution; below 90 it has half the resolution in both directions, as in most encoders.
        quality: u8,
    },
    /// PNG, lossless, with fast compression.
    Png,
}

/// Compresses a picture into a payload part.
///
/// # Errors
/// If the picture is empty, or larger than the format allows.
pub fn encode(picture: &Picture, encoding: Encoding) -> Result<Part, ImageError> {
    // The capacity is an estimate of the file's size, so that the buffer rarely grows.
    let mut file = Vec::with_capacity(picture.pixels().len() / 8 + 1024);
    let media = match encoding {
        Encoding::Jpeg { quality } => {
            write_jpeg(picture, quality.clamp(1, 100), &mut file)?;
            MediaType::Jpeg
        }
        Encoding::Png => {
            write_png(picture, &mut file)?;
            MediaType::Png
        }
    };
    Ok(Part { description: Description::unshaped(media), bytes: Bytes::from(file) })
}

fn write_jpeg(picture: &Picture, quality: u8, file: &mut Vec<u8>) -> Result<(), ImageError> {
    let failed = |reason: String| encoding_error("jpeg", picture, reason);
    // JPEG stores the length of a side in 16 bits (ITU-T T.81, B.2.2).
    let side = |pixels: u32| u16::try_from(pixels).map_err(|_| failed("a side is too long".to_owned()));
    let colours = match picture.format() {
        PixelFormat::Rgb8 => jpeg_encoder::ColorType::Rgb,
        PixelFormat::Grey8 => jpeg_encoder::ColorType::Luma,
    };
    let mut encoder = jpeg_encoder::Encoder::new(file, quality);
    // libjpeg also averages the colours of neighbouring pixels, and most models were trained on pictures that libjpeg
    // compressed.
    encoder.set_chroma_subsampling_method(jpeg_encoder::ChromaSubsamplingMethod::Average);
    encoder
        .encode(picture.pixels(), side(picture.width())?, side(picture.height())?, colours)
        .map_err(|error| failed(error.to_string()))
}

fn write_png(picture: &Picture, file: &mut Vec<u8>) -> Result<(), ImageError> {
    let colours = match picture.format() {
        PixelFormat::Rgb8 => image::ExtendedColorType::Rgb8,
        PixelFormat::Grey8 => image::ExtendedColorType::L8,
    };
    PngEncoder::new(file)
        .write_image(picture.pixels(), picture.width(), picture.height(), colours)
        .map_err(|error| encoding_error("png", picture, error.to_string()))
}

fn encoding_error(format: &'static str, picture: &Picture, reason: String) -> ImageError {
    ImageError::Unwritable { format, width: picture.width(), height: picture.height(), reason }
}
