//! The transforms, one file per kind.

mod crop;
mod decode;
mod encode;
mod resize;

use peernet_imaging::{Encoding, ImageError};
use peernet_sample::{MediaType, Part, PixelFormat, Sample};

use crate::{Format, SensorError, Transform, TransformConfig};

/// The transform that a configuration describes.
///
/// # Errors
/// When the configuration contradicts itself.
pub fn build_transform(config: &TransformConfig) -> Result<Box<dyn Transform>, SensorError> {
    Ok(match config {
        &TransformConfig::Resize { width, height, filter } => {
            check(width, height, "resize")?;
            Box::new(resize::Resize::new(width, height, filter))
        }
        &TransformConfig::Crop { width, height, x, y } => {
            check(width, height, "crop")?;
            Box::new(crop::Cut::new(peernet_imaging::Crop { width, height, x, y }))
        }
        TransformConfig::Encode { format, quality } => {
            Box::new(encode::Encode::new(encoding(*format, *quality)?))
        }
        TransformConfig::Decode {} => Box::new(decode::Decode),
    })
}

fn check(width: u32, height: u32, what: &str) -> Result<(), SensorError> {
    if width == 0 || height == 0 {
        let reason = format!("{what} needs a width and a height of at least 1, not {width} × {height}");
        return Err(SensorError::Config(reason));
    }
    Ok(())
}

fn encoding(format: Format, quality: Option<u8>) -> Result<Encoding, SensorError> {
    let wrong = |reason: &str| Err(SensorError::Config(reason.to_owned()));
    match (format, quality) {
        (Format::Jpeg, None) => Ok(Encoding::Jpeg { quality: 85 }),
        (Format::Jpeg, Some(quality @ 1..=100)) => Ok(Encoding::Jpeg { quality }),
        (Format::Jpeg, Some(_)) => wrong("the quality of a jpeg goes from 1 to 100"),
        (Format::Png, None) => Ok(Encoding::Png),
        (Format::Png, Some(_)) => wrong("a png is lossless and takes no quality"),
    }
}

/// Changes every picture of a sample and leaves its other parts; a sample without a picture is an error.
fn change(
    mut sample: Sample,
    action: &'static str,
    mut change: impl FnMut(&Part) -> Result<Part, ImageError>,
) -> Result<Sample, SensorError> {
    let mut changed = false;
    for part in &mut sample.parts {
        if matches!(part.description.media, MediaType::Jpeg | MediaType::Png | MediaType::Pixels(_)) {
            match change(part) {
                Ok(new) => *part = new,
                Err(error) => return Err(SensorError::Picture { action, sample: sample.source, error }),
            }
            changed = true;
        }
    }
    if !changed {
        let media = sample.parts.first().map_or(MediaType::Bytes, |part| part.description.media.clone());
        let error = ImageError::NotAPicture(media);
        return Err(SensorError::Picture { action, sample: sample.source, error });
    }
    Ok(sample)
}

/// The order of channels in which a part is worked on: its own, and colour for files.
fn channels(part: &Part) -> PixelFormat {
    match part.description.media {
        MediaType::Pixels(format) => format,
        _ => PixelFormat::Rgb8,
    }
}
