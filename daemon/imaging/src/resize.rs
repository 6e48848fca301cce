//! Scaling of pictures, by a SIMD library.

use std::fmt;

use fast_image_resize as fir;
use peernet_sample::PixelFormat;
use serde::{Deserialize, Serialize};

use crate::size::check_size;
use crate::{ImageError, Picture};

/// Filter that combines pixels when a picture is scaled. When the picture becomes smaller, all filters but `nearest`
/// average over every source pixel, as Pillow does. Other libraries call this "antialias".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Filter {
    /// The nearest pixel: fast and coarse.
    Nearest,
    /// The mean of the pixels in a box.
    Box,
    /// Linear interpolation in both directions.
    #[default]
    Bilinear,
    /// Cubic interpolation (Catmull-Rom, a = −0.5): sharper.
    Bicubic,
    /// Lanczos with three lobes: sharpest and slowest.
    Lanczos,
}

/// Filter, and whether it averages over all source pixels when a picture becomes smaller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scaling {
    /// Filter that combines pixels.
    pub filter: Filter,
    /// `true` to average over all source pixels when the picture becomes smaller. `false` to combine only the nearest
    /// pixels, as many as when the picture becomes larger; some models were trained with such pictures.
    pub antialias: bool,
}

impl From<Filter> for Scaling {
    fn from(filter: Filter) -> Self {
        Self { filter, antialias: true }
    }
}

impl Scaling {
    fn algorithm(self) -> fir::ResizeAlg {
        let filter = match self.filter {
            Filter::Nearest => return fir::ResizeAlg::Nearest,
            Filter::Box => fir::FilterType::Box,
            Filter::Bilinear => fir::FilterType::Bilinear,
            Filter::Bicubic => fir::FilterType::CatmullRom,
            Filter::Lanczos => fir::FilterType::Lanczos3,
        };
        if self.antialias {
            fir::ResizeAlg::Convolution(filter)
        } else {
            fir::ResizeAlg::Interpolation(filter)
        }
    }
}

/// Scales pictures, and keeps its working memory for the next picture.
#[derive(Default)]
pub struct Resizer(fir::Resizer);

impl Resizer {
    /// Creates a resizer without working memory.
    pub fn new() -> Self {
        Self::default()
    }

    /// Scales `picture` to exactly `width` × `height`, without regard to its proportions, into `target`.
    ///
    /// # Errors
    /// If the picture is empty or the requested size is not permitted.
    pub fn resize(
        &mut self,
        picture: &Picture,
        width: u32,
        height: u32,
        scaling: impl Into<Scaling>,
        target: &mut Picture,
    ) -> Result<(), ImageError> {
        check_size(u64::from(picture.width()), u64::from(picture.height()))?;
        check_size(u64::from(width), u64::from(height))?;
        let format = picture.format();
        let pixels = target.reshape(format, width, height);
        // The library's untyped function would add 6 MB of code to the program, for sixteen pixel types.
        let resized = match format {
            PixelFormat::Rgb8 => {
                self.resize_pixels::<fir::pixels::U8x3>(picture, width, height, scaling.into(), pixels)
            }
            PixelFormat::Grey8 => {
                self.resize_pixels::<fir::pixels::U8>(picture, width, height, scaling.into(), pixels)
            }
        };
        // Both sizes were checked and both buffers have the resulting length, so no step can fail.
        resized.ok_or(ImageError::Size { width: u64::from(width), height: u64::from(height) })
    }

    fn resize_pixels<P: fir::PixelTrait>(
        &mut self,
        picture: &Picture,
        width: u32,
        height: u32,
        scaling: Scaling,
        pixels: &mut [u8],
    ) -> Option<()> {
        let from =
            fir::images::TypedImageRef::<P>::from_buffer(picture.width(), picture.height(), picture.pixels());
        let to = fir::images::TypedImage::<P>::from_buffer(width, height, pixels);
        // No pixel format has an alpha channel.
        let options = fir::ResizeOptions::new().resize_alg(scaling.algorithm()).use_alpha(false);
        self.0.resize_typed(&from.ok()?, &mut to.ok()?, &options).ok()
    }
}

impl fmt::Debug for Resizer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Resizer").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkerboard(side: u32) -> Picture {
        let pixels = (0..side * side).map(|i| if (i / side + i % side).is_multiple_of(2) { 0 } else { 255 });
        Picture::new(PixelFormat::Grey8, side, side, pixels.collect()).expect("fits")
    }

    #[test]
    fn shrinking_averages_over_all_pixels() {
        let mut target = Picture::default();
        for filter in [Filter::Box, Filter::Bilinear, Filter::Bicubic, Filter::Lanczos] {
            Resizer::new().resize(&checkerboard(64), 8, 8, filter, &mut target).expect("fits");
            let deviating = target.pixels().iter().filter(|grey| grey.abs_diff(128) > 12).count();
            assert_eq!(deviating, 0, "{filter:?}: {:?}", target.pixels());
        }
    }

    #[test]
    fn without_antialias_only_nearest_pixels_count() {
        // A row of 64 pixels shrinks to 8. The centre of the new first pixel is halfway between pixel 3 (200) and
        // pixel 4 (0).
        let mut pixels = vec![0; 64];
        pixels[3] = 200;
        let row = Picture::new(PixelFormat::Grey8, 64, 1, pixels).expect("fits");
        let mut target = Picture::default();
        let mut first_pixel = |antialias| {
            let scaling = Scaling { filter: Filter::Bilinear, antialias };
            Resizer::new().resize(&row, 8, 1, scaling, &mut target).expect("fits");
            target.pixels()[0]
        };
        assert_eq!(first_pixel(false), 100);
        assert!(first_pixel(true) < 30, "the filter covers about sixteen pixels");
    }

    #[test]
    fn uniform_picture_stays_uniform_when_resized() {
        let uniform = Picture::new(PixelFormat::Rgb8, 7, 5, [10, 200, 30].repeat(35)).expect("fits");
        let (mut resizer, mut target) = (Resizer::new(), Picture::default());
        for (width, height) in [(1, 1), (3, 9), (20, 2), (7, 5)] {
            resizer.resize(&uniform, width, height, Filter::Bilinear, &mut target).expect("fits");
            assert_eq!(target.pixels(), [10, 200, 30].repeat((width * height) as usize));
        }
    }

    #[test]
    fn impossible_sizes_are_refused() {
        let mut target = Picture::default();
        for (width, height) in [(0, 1), (1, 0), (u32::MAX, 1), (20_000, 20_000)] {
            let refused = Resizer::new().resize(&checkerboard(4), width, height, Filter::Box, &mut target);
            assert!(matches!(refused, Err(ImageError::Size { .. })));
        }
        let empty = Resizer::new().resize(&Picture::default(), 2, 2, Filter::Box, &mut target);
        assert!(matches!(empty, Err(ImageError::Size { .. })));
    }
}
