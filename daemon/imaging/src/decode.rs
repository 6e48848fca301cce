//! Decoding of files to pixels.
//!
//! JPEG is decoded at full size, by a SIMD decoder. The format also allows decoding at a half, a quarter or an eighth
//! of the size, which does not pay off: it changes the pixels, and it does not shorten the entropy decoding, which
//! takes most of the time. The only Rust decoder that has this feature takes 4.0, 5.5, 7.8 and 15.3 ms at half the size
//! for four pictures of 1 to 2 megapixels; the decoder used here takes 3.3, 4.4, 7.1 and 15.5 ms at full size. The
//! caller decodes the pictures of a batch in parallel instead.

use std::io::Cursor;

use image::ImageDecoder;
use image::codecs::png::PngDecoder;
use peernet_sample::{MediaType, Part, PixelFormat, printable_line};
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::limits::MAX_SIDE;
use crate::size::{check_size, pixels_size};
use crate::{ImageError, Picture};

/// First bytes of a JPEG file.
const JPEG_SIGNATURE: &[u8] = &[0xff, 0xd8, 0xff];
/// First bytes of a PNG file.
const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Returns the format of a file by its first bytes, regardless of its name and description.
pub(crate) fn detect_format(file: &[u8]) -> Result<MediaType, ImageError> {
    match file {
        file if file.starts_with(JPEG_SIGNATURE) => Ok(MediaType::Jpeg),
        file if file.starts_with(PNG_SIGNATURE) => Ok(MediaType::Png),
        _ => Err(ImageError::UnknownFormat),
    }
}

/// Decodes a JPEG or PNG file into `picture`, in the given pixel format.
///
/// Transparency is dropped. Colour profiles are ignored, and so is the orientation tag, as in most training code; see
/// [`turn_upright`](crate::turn_upright).
///
/// # Errors
/// If the file has another format, is damaged or truncated, or is too large. After an error the contents of `picture`
/// are undefined.
pub fn decode(file: &[u8], format: PixelFormat, picture: &mut Picture) -> Result<(), ImageError> {
    if detect_format(file)? == MediaType::Jpeg {
        decode_jpeg(file, format, picture)
    } else {
        decode_png(file, format, picture)
    }
}

/// Reads the picture in a payload part into `picture`: a file is decoded, pixels are copied.
///
/// # Errors
/// Those of [`decode`], and if the part is not a picture.
pub fn read_part(part: &Part, format: PixelFormat, picture: &mut Picture) -> Result<(), ImageError> {
    match &part.description.media {
        MediaType::Jpeg | MediaType::Png => decode(&part.bytes, format, picture),
        MediaType::Pixels(from) => {
            let (width, height) = pixels_size(part, *from)?;
            picture.assign(*from, format, width, height, &part.bytes);
            Ok(())
        }
        media => Err(ImageError::NotAPicture(media.clone())),
    }
}

fn decode_jpeg(file: &[u8], format: PixelFormat, picture: &mut Picture) -> Result<(), ImageError> {
    let OpenedImage { mut decoder, width, height } = open_jpeg(file, format)?;
    let target = picture.reshape(format, width, height);
    if decoder.output_buffer_size() != Some(target.len()) {
        return Err(damaged_jpeg("its colours are of a kind that cannot be converted"));
    }
    decoder.decode_into(target).map_err(|error| jpeg_error(&error))
}

/// Decoder that has read the header, and the size in the header, which is within the limits.
pub(crate) struct OpenedImage<D> {
    pub(crate) decoder: D,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

pub(crate) fn open_jpeg(
    file: &[u8],
    format: PixelFormat,
) -> Result<OpenedImage<JpegDecoder<ZCursor<&[u8]>>>, ImageError> {
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(file), jpeg_options(format));
    decoder.decode_headers().map_err(|error| jpeg_error(&error))?;
    let info = decoder.info().ok_or_else(|| damaged_jpeg("its header gives no size"))?;
    let (width, height) = (u32::from(info.width), u32::from(info.height));
    check_size(u64::from(width), u64::from(height))?;
    Ok(OpenedImage { decoder, width, height })
}

/// Returns the options with which the JPEG decoder yields pixels of the given format and refuses damaged files.
fn jpeg_options(format: PixelFormat) -> DecoderOptions {
    let colours = match format {
        PixelFormat::Rgb8 => ColorSpace::RGB,
        PixelFormat::Grey8 => ColorSpace::Luma,
    };
    // Without the strict mode a truncated file gives a picture with a grey lower part instead of an error.
    DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize)
        .jpeg_set_out_colorspace(colours)
}

fn jpeg_error(error: &DecodeErrors) -> ImageError {
    damaged_jpeg(&single_line(&error.to_string()))
}

fn damaged_jpeg(reason: &str) -> ImageError {
    ImageError::Damaged { format: "jpeg", reason: reason.to_owned() }
}

/// Decodes a PNG file. Bit depths, palettes and transparency are converted to eight bits per channel.
fn decode_png(file: &[u8], format: PixelFormat, picture: &mut Picture) -> Result<(), ImageError> {
    let OpenedImage { decoder, width, height } = open_png(file)?;
    let is_target_format = matches!(
        (decoder.color_type(), format),
        (image::ColorType::Rgb8, PixelFormat::Rgb8) | (image::ColorType::L8, PixelFormat::Grey8)
    );
    if is_target_format {
        // Decoded straight into the target, without a copy.
        let target = picture.reshape(format, width, height);
        return decoder.read_image(target).map_err(|error| png_error(&error));
    }
    let pixels = image::DynamicImage::from_decoder(decoder).map_err(|error| png_error(&error))?.into_rgb8();
    picture.assign(PixelFormat::Rgb8, format, width, height, pixels.as_raw());
    Ok(())
}

pub(crate) fn open_png(file: &[u8]) -> Result<OpenedImage<PngDecoder<Cursor<&[u8]>>>, ImageError> {
    let decoder = PngDecoder::new(Cursor::new(file)).map_err(|error| png_error(&error))?;
    let (width, height) = decoder.dimensions();
    check_size(u64::from(width), u64::from(height))?;
    Ok(OpenedImage { decoder, width, height })
}

fn png_error(error: &image::ImageError) -> ImageError {
    ImageError::Damaged { format: "png", reason: single_line(&error.to_string()) }
}

/// Returns the error text of another library in one line, without full stop.
fn single_line(text: &str) -> String {
    printable_line(text).split_whitespace().collect::<Vec<_>>().join(" ").trim_end_matches('.').to_owned()
}
