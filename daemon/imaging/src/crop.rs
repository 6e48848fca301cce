//! Cropping of pictures.

use crate::size::{check_inside, check_size};
use crate::{ImageError, Picture};

/// Rectangle of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Left edge, pixels; `None` centres the rectangle, rounded to the left.
    pub x: Option<u32>,
    /// Upper edge, pixels; `None` centres the rectangle, rounded upwards.
    pub y: Option<u32>,
}

/// Copies the rectangle `crop` of `picture` to `target`.
///
/// # Errors
/// If the rectangle is empty or reaches beyond the picture.
pub fn crop(picture: &Picture, crop: Crop, target: &mut Picture) -> Result<(), ImageError> {
    let Crop { width, height, x, y } = crop;
    // An empty rectangle would make `chunks_exact_mut` panic.
    check_size(u64::from(width), u64::from(height))?;
    let (picture_width, picture_height) = (picture.width(), picture.height());
    let x = x.unwrap_or_else(|| picture_width.saturating_sub(width) / 2);
    let y = y.unwrap_or_else(|| picture_height.saturating_sub(height) / 2);
    check_inside((x, y), (width, height), (picture_width, picture_height))?;
    let channels = picture.format().channels() as usize;
    let (row_bytes, crop_bytes) = (picture_width as usize * channels, width as usize * channels);
    let rows = picture.pixels().chunks_exact(row_bytes).skip(y as usize);
    let pixels = target.reshape(picture.format(), width, height);
    // The pixels of a row are contiguous, so each row is one copy.
    for (to, from) in pixels.chunks_exact_mut(crop_bytes).zip(rows) {
        let start = x as usize * channels;
        to.copy_from_slice(&from[start..start + crop_bytes]);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use peernet_sample::PixelFormat;
    use proptest::prelude::*;

    use super::*;

    fn numbered_picture(width: u32, height: u32) -> Picture {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (16 * y + x) as u8)).collect();
        Picture::new(PixelFormat::Grey8, width, height, pixels).expect("fits")
    }

    #[test]
    fn rectangle_is_at_position_or_centre() {
        let mut target = Picture::default();
        crop(&numbered_picture(5, 4), Crop { width: 2, height: 2, x: Some(3), y: Some(0) }, &mut target)
            .expect("fits");
        assert_eq!(target.pixels(), [3, 4, 19, 20]);
        crop(&numbered_picture(5, 4), Crop { width: 2, height: 2, x: None, y: None }, &mut target)
            .expect("fits");
        assert_eq!(target.pixels(), [17, 18, 33, 34]);
    }

    proptest! {
        #[test]
        fn rectangle_is_cropped_or_refused(w in 0u32..9, h in 0u32..9, x: Option<u32>, y in proptest::option::of(0u32..9)) {
            let mut target = Picture::default();
            match crop(&numbered_picture(7, 6), Crop { width: w, height: h, x, y }, &mut target) {
                Ok(()) => prop_assert_eq!((target.width(), target.height(), target.pixels().len()), (w, h, (w * h) as usize)),
                Err(ImageError::Size { .. }) => prop_assert!(w == 0 || h == 0),
                Err(error) => prop_assert!(matches!(error, ImageError::Outside { .. }), "{}", error),
            }
        }
    }
}
