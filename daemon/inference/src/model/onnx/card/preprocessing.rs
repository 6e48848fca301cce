//! The table `[preprocessing]` of a card: the conversion of a picture to numbers.

use std::fmt;

use peernet_imaging::{Filter, Orientation};
use serde::Deserialize;

use super::ModelCardError;

/// Order of a picture's dimensions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::model::onnx) enum Layout {
    /// Batch, channels, height, width.
    Nchw,
    /// Batch, height, width, channels.
    Nhwc,
}

impl Layout {
    /// Returns the other layout.
    pub(super) const fn other(self) -> Self {
        match self {
            Self::Nchw => Self::Nhwc,
            Self::Nhwc => Self::Nchw,
        }
    }

    /// Returns channels, height and width of a shape; `None` if the shape has fewer than three lengths.
    pub(in crate::model::onnx) fn dimensions(self, shape: &[usize]) -> Option<(usize, usize, usize)> {
        // Dimensions before these three belong to the batch.
        let [.., a, b, c] = *shape else { return None };
        Some(match self {
            Self::Nchw => (a, b, c),
            Self::Nhwc => (c, a, b),
        })
    }
}

impl fmt::Display for Layout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Nchw => "nchw",
            Self::Nhwc => "nhwc",
        })
    }
}

/// Order of the input's channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::model::onnx) enum Colour {
    Rgb,
    Bgr,
    Grey,
}

impl Colour {
    pub(super) fn channels(self) -> usize {
        match self {
            Self::Rgb | Self::Bgr => 3,
            Self::Grey => 1,
        }
    }
}

impl fmt::Display for Colour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Rgb => "rgb",
            Self::Bgr => "bgr",
            Self::Grey => "grey",
        })
    }
}

/// Preprocessing steps, applied in the order of the fields: orientation, resize, crop, then `(byte × scale − mean) /
/// std` for each channel.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::model::onnx) struct Preprocessing {
    /// Orientation of the picture before the other steps.
    #[serde(default)]
    pub(in crate::model::onnx) orientation: Orientation,
    /// Resizing. Without this key, and without a crop, pictures must have the size of the input.
    #[serde(default)]
    pub(in crate::model::onnx) resize: Option<Resize>,
    /// Rectangle that is cut out of the centre.
    #[serde(default)]
    pub(in crate::model::onnx) crop: Option<CentreCrop>,
    /// Factor for bytes. Default for an input of integers: 1. Required for an input of floats.
    #[serde(default)]
    scale: Option<f64>,
    /// One number per channel, in the order of `colour`. Default for an input of integers: zeros. Required for an input
    /// of floats.
    #[serde(default)]
    mean: Option<Vec<f64>>,
    /// One number per channel, in the order of `colour`. Default for an input of integers: ones. Required for an input
    /// of floats.
    #[serde(default)]
    std: Option<Vec<f64>>,
}

/// The numbers of the last preprocessing step, `(byte × scale − mean) / std`.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::model::onnx) struct Normalisation {
    pub(in crate::model::onnx) scale: f64,
    pub(in crate::model::onnx) mean: Vec<f64>,
    pub(in crate::model::onnx) std: Vec<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(tag = "mode", rename_all = "lowercase", deny_unknown_fields)]
pub(in crate::model::onnx) enum Resize {
    /// Resizes to this size, pixels; the picture's proportions may change.
    Exact {
        width: u32,
        height: u32,
        #[serde(default)]
        filter: Filter,
        /// `true` to average over all source pixels when the picture becomes smaller.
        #[serde(default = "default_true")]
        antialias: bool,
    },
    /// Resizes the shorter side to `size` pixels, and the longer side in proportion, rounded down.
    Shortest {
        size: u32,
        #[serde(default)]
        filter: Filter,
        /// `true` to average over all source pixels when the picture becomes smaller.
        #[serde(default = "default_true")]
        antialias: bool,
    },
    /// Resizes to the largest size that keeps the picture's proportions and fits into `width` × `height`, rounded to
    /// the nearest pixel, and fills the rest.
    Letterbox {
        width: u32,
        height: u32,
        #[serde(default)]
        filter: Filter,
        /// `true` to average over all source pixels when the picture becomes smaller.
        #[serde(default = "default_true")]
        antialias: bool,
        /// Value of the bytes beside the picture.
        #[serde(default = "default_fill")]
        fill: u8,
        #[serde(default)]
        position: Position,
    },
}

/// Position of the resized picture in the input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(in crate::model::onnx) enum Position {
    /// In the centre. If two margins cannot be equal, the left or upper margin is the smaller one.
    #[default]
    Centre,
    /// In the upper left corner.
    TopLeft,
}

impl Position {
    /// Returns the left or upper margin, pixels, if both margins together have `total` pixels.
    pub(in crate::model::onnx) const fn first_margin(self, total: u32) -> u32 {
        match self {
            Self::Centre => total / 2,
            Self::TopLeft => 0,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::model::onnx) struct CentreCrop {
    pub(in crate::model::onnx) width: u32,
    pub(in crate::model::onnx) height: u32,
    /// Rounding of the left and upper margins if two margins cannot be equal.
    #[serde(default)]
    pub(in crate::model::onnx) rounding: Rounding,
}

/// Rounding of the left and upper margins if half a pixel is left over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(in crate::model::onnx) enum Rounding {
    /// Rounds down.
    #[default]
    Down,
    /// Rounds half to even, as torchvision does (Python's `round`).
    HalfEven,
}

impl Rounding {
    /// Returns the left or upper margin, pixels, if both margins together have `total` pixels.
    pub(in crate::model::onnx) const fn first_margin(self, total: u32) -> u32 {
        match self {
            // Half of an odd total lies between the integers k and k + 1. If `total % 4` is 3, k is odd and k + 1 is
            // even.
            Self::HalfEven if total % 4 == 3 => total / 2 + 1,
            _ => total / 2,
        }
    }
}

const fn default_true() -> bool {
    true
}

/// Returns the grey of the margins with which models of the YOLO family are trained.
const fn default_fill() -> u8 {
    114
}

impl Preprocessing {
    /// Checks that the steps make a picture of the `expected` width and height, pixels.
    pub(super) fn check_size(&self, expected: (usize, usize)) -> Result<(), ModelCardError> {
        if let (Some(resize), Some(CentreCrop { width, height, .. })) = (self.resize, self.crop) {
            let (fits, resized) = match resize {
                // The longer side depends on the picture, so only the crop's shorter side can be compared here.
                Resize::Shortest { size, .. } => {
                    (width.min(height) <= size, format!("a shorter side of {size}"))
                }
                Resize::Exact { width: w, height: h, .. } | Resize::Letterbox { width: w, height: h, .. } => {
                    (width <= w && height <= h, format!("{w} × {h}"))
                }
            };
            if !fits {
                return Err(ModelCardError::Crop { crop: (width, height), resized });
            }
        }
        let actual = match (self.resize, self.crop) {
            // The crop is the last step that changes the size, so the size is that of the crop.
            (_, Some(CentreCrop { width, height, .. }))
            | (Some(Resize::Exact { width, height, .. } | Resize::Letterbox { width, height, .. }), None) => {
                (width, height)
            }
            // The longer side depends on the picture, so the size is not fixed without a crop.
            (Some(Resize::Shortest { .. }), None) => return Err(ModelCardError::NoCrop),
            // The size of each picture is compared with that of the input when the picture arrives.
            (None, None) => return Ok(()),
        };
        if (actual.0 as usize, actual.1 as usize) == expected {
            Ok(())
        } else {
            Err(ModelCardError::Size { actual, expected })
        }
    }

    /// Returns the numbers of the last step for `channels` channels. `has_defaults` is `true` if the input has
    /// integers: missing numbers then have defaults, with which the bytes stay as they are.
    pub(super) fn normalisation(
        &self,
        channels: usize,
        has_defaults: bool,
    ) -> Result<Normalisation, ModelCardError> {
        let require_default =
            |key| if has_defaults { Ok(()) } else { Err(ModelCardError::NoNormalisation(key)) };
        let list = |key, values: &Option<Vec<f64>>, default: f64| match values {
            Some(values) if values.len() != channels => {
                Err(ModelCardError::Numbers { key, count: values.len(), channels })
            }
            Some(values) => Ok(values.clone()),
            None => require_default(key).map(|()| vec![default; channels]),
        };
        let mean = list("mean", &self.mean, 0.0)?;
        let std = list("std", &self.std, 1.0)?;
        let scale = match self.scale {
            Some(scale) => scale,
            None => require_default("scale").map(|()| 1.0)?,
        };
        if !mean.iter().chain(&std).chain([&scale]).all(|number| number.is_finite()) {
            return Err(ModelCardError::NotFinite);
        }
        // With a factor of 0, all pixels would become the same number.
        if scale == 0.0 {
            return Err(ModelCardError::NoScale);
        }
        if let Some(deviation) = std.iter().find(|deviation| **deviation <= 0.0) {
            return Err(ModelCardError::Deviation(*deviation));
        }
        Ok(Normalisation { scale, mean, std })
    }
}
