//! Checks of the sizes of pictures before memory is allocated for them.

use peernet_sample::{Part, PixelFormat};

use crate::ImageError;
use crate::limits::{MAX_PIXELS, MAX_SIDE};

/// Returns the number of bytes of decoded pixels. The size must have passed [`check_size`]: otherwise the product may
/// overflow.
pub(crate) fn pixel_bytes(format: PixelFormat, width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height) * u64::from(format.channels())
}

/// Checks that a size of decoded pixels is permitted, and that `actual` is the number of bytes of such pixels.
pub(crate) fn check_length(
    format: PixelFormat,
    width: u32,
    height: u32,
    actual: usize,
) -> Result<(), ImageError> {
    check_size(u64::from(width), u64::from(height))?;
    let (expected, actual) = (pixel_bytes(format, width, height), actual as u64);
    if expected != actual {
        return Err(ImageError::Length { width, height, channels: format.channels(), expected, actual });
    }
    Ok(())
}

/// Returns width and height of the decoded pixels in a part. Checks that the part has as many bytes as pixels of this
/// size need.
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

/// Returns an error if a side is zero or too long, or if there would be too many pixels.
pub(crate) fn check_size(width: u64, height: u64) -> Result<(), ImageError> {
    // The sides are checked first, so that their product cannot overflow.
    let sides = 1..=MAX_SIDE;
    if sides.contains(&width) && sides.contains(&height) && width * height <= MAX_PIXELS {
        Ok(())
    } else {
        Err(ImageError::Size { width, height })
    }
}

/// Returns an error if a rectangle at the position (`x`, `y`) reaches beyond a picture of the outer size.
pub(crate) fn check_inside(
    (x, y): (u32, u32),
    (width, height): (u32, u32),
    (outer_width, outer_height): (u32, u32),
) -> Result<(), ImageError> {
    let is_inside =
        |start: u32, length: u32, limit: u32| start.checked_add(length).is_some_and(|end| end <= limit);
    if is_inside(x, width, outer_width) && is_inside(y, height, outer_height) {
        Ok(())
    } else {
        Err(ImageError::Outside { width, height, x, y, outer_width, outer_height })
    }
}
