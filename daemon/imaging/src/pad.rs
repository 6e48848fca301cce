//! Padding of pictures to a larger size.

use crate::size::{check_inside, check_size};
use crate::{ImageError, Picture};

/// Position of a picture in a larger one, and the value of the bytes around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Padding {
    /// Width of the larger picture, pixels.
    pub width: u32,
    /// Height of the larger picture, pixels.
    pub height: u32,
    /// Left edge of the picture in the larger one, pixels.
    pub x: u32,
    /// Upper edge of the picture in the larger one, pixels.
    pub y: u32,
    /// Value of each byte of the larger picture outside the smaller one.
    pub fill: u8,
}

/// Copies `picture` into a larger picture, `target`.
///
/// # Errors
/// If one of the sizes is not permitted, or if the picture at its position reaches beyond the larger size.
pub fn pad(picture: &Picture, padding: Padding, target: &mut Picture) -> Result<(), ImageError> {
    let Padding { width, height, x, y, fill } = padding;
    check_size(u64::from(width), u64::from(height))?;
    // An empty picture would make `chunks_exact` panic.
    check_size(u64::from(picture.width()), u64::from(picture.height()))?;
    check_inside((x, y), (picture.width(), picture.height()), (width, height))?;
    let channels = picture.format().channels() as usize;
    let (row_bytes, picture_row_bytes) = (width as usize * channels, picture.width() as usize * channels);
    let pixels = target.reshape(picture.format(), width, height);
    let (above, rest) = pixels.split_at_mut(y as usize * row_bytes);
    let (picture_rows, below) = rest.split_at_mut(picture.height() as usize * row_bytes);
    above.fill(fill);
    below.fill(fill);
    let start = x as usize * channels;
    for (to, from) in
        picture_rows.chunks_exact_mut(row_bytes).zip(picture.pixels().chunks_exact(picture_row_bytes))
    {
        to[..start].fill(fill);
        to[start..start + picture_row_bytes].copy_from_slice(from);
        to[start + picture_row_bytes..].fill(fill);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use peernet_sample::PixelFormat;
    use proptest::prelude::*;

    use super::*;
    use crate::{Crop, crop};

    #[test]
    fn picture_is_surrounded_by_fill() {
        let picture = Picture::new(PixelFormat::Rgb8, 1, 1, vec![1, 2, 3]).expect("fits");
        let mut target = Picture::default();
        pad(&picture, Padding { width: 2, height: 3, x: 1, y: 1, fill: 9 }, &mut target).expect("fits");
        let filled = [9; 6];
        assert_eq!(target.pixels(), [&filled[..], &[9, 9, 9, 1, 2, 3], &filled].concat());
    }

    proptest! {
        #[test]
        fn cropping_undoes_padding(w in 1u32..6, h in 1u32..6, x in 0u32..4, y in 0u32..4, size in 1u32..9) {
            let pixels: Vec<u8> = (1..=w * h).map(|number| number as u8).collect();
            let picture = Picture::new(PixelFormat::Grey8, w, h, pixels).expect("fits");
            let (mut target, mut back) = (Picture::default(), Picture::default());
            match pad(&picture, Padding { width: size, height: size, x, y, fill: 0 }, &mut target) {
                Ok(()) => {
                    crop(&target, Crop { width: w, height: h, x: Some(x), y: Some(y) }, &mut back).expect("is inside");
                    prop_assert_eq!(&back, &picture);
                    let filled = target.pixels().iter().filter(|byte| **byte == 0).count();
                    prop_assert_eq!(filled, (size * size - w * h) as usize);
                }
                Err(error) => prop_assert!(x + w > size || y + h > size, "{}", error),
            }
        }
    }
}
