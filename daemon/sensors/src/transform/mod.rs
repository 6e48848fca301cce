//! Transforms: one file for each kind, and their registration in [`TransformConfig`].

pub mod crop;
pub mod decode;
pub mod encode;
pub mod resize;

use enum_dispatch::enum_dispatch;
use peernet_imaging::ImageError;
use peernet_sample::{MediaType, Part, PixelFormat, Sample};
use serde::{Deserialize, Serialize};

use crate::{SensorError, Transform};

/// Kind of transform, implemented by its configuration.
#[enum_dispatch]
pub trait TransformKind {
    /// Builds the transform.
    ///
    /// # Errors
    /// If the configuration contradicts itself.
    fn build(&self) -> Result<Box<dyn Transform>, SensorError>;
}

/// An element of the list `transforms` in the configuration of a pipeline, which applies them in their order. New kinds
/// are registered here.
///
/// `resize`, `crop` and `decode` yield decoded pixels (in colour, if the picture was a file). A later `encode`
/// compresses the pixels again. Each transform changes every picture of the sample and leaves the other parts of the
/// sample unchanged.
#[enum_dispatch(TransformKind)]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum TransformConfig {
    /// Scales a picture to exactly this size; decodes it first if necessary.
    Resize(resize::ResizeConfig),
    /// Cuts a rectangle out of a picture; decodes it first if necessary.
    Crop(crop::CropConfig),
    /// Compresses a picture; decodes it first if it is a file.
    Encode(encode::EncodeConfig),
    /// Decodes a picture to pixels.
    Decode(decode::DecodeConfig),
}

/// Checks that neither side of the configured size is zero.
fn check_size(width: u32, height: u32, transform: &str) -> Result<(), SensorError> {
    if width == 0 || height == 0 {
        let reason = format!("{transform} needs a width and a height of at least 1, not {width} × {height}");
        return Err(SensorError::Config(reason));
    }
    Ok(())
}

/// Changes every picture of a sample and leaves the other parts unchanged.
///
/// # Errors
/// If a picture cannot be changed, or if the sample has no picture.
fn transform_pictures(
    mut sample: Sample,
    action: &'static str,
    mut transform_part: impl FnMut(&Part) -> Result<Part, ImageError>,
) -> Result<Sample, SensorError> {
    let mut has_picture = false;
    for part in &mut sample.parts {
        if matches!(part.description.media, MediaType::Jpeg | MediaType::Png | MediaType::Pixels(_)) {
            match transform_part(part) {
                Ok(new) => *part = new,
                Err(error) => return Err(SensorError::Picture { action, sample: sample.source, error }),
            }
            has_picture = true;
        }
    }
    // A transform of samples without pictures is a mistake in the configuration.
    if !has_picture {
        let media = sample.parts.first().map_or(MediaType::Bytes, |part| part.description.media.clone());
        let error = ImageError::NotAPicture(media);
        return Err(SensorError::Picture { action, sample: sample.source, error });
    }
    Ok(sample)
}

/// Returns the pixel format in which a part is processed: decoded pixels keep their format, files are decoded to
/// colour.
fn working_format(part: &Part) -> PixelFormat {
    match part.description.media {
        MediaType::Pixels(format) => format,
        _ => PixelFormat::Rgb8,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_names_unknown_key() {
        for text in [
            "kind = 'resize'\nwidth = 1\nheight = 1\nzz = 1",
            "kind = 'crop'\nwidth = 1\nheight = 1\nzz = 1",
            "kind = 'encode'\nformat = 'png'\nzz = 1",
            "kind = 'decode'\nzz = 1",
        ] {
            let error = toml::from_str::<TransformConfig>(text).expect_err("has an unknown key").to_string();
            assert!(error.contains("unknown field `zz`"), "{error}");
        }
    }
}
