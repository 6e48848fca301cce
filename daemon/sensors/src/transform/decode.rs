//! Transform `decode`, which decodes pictures to pixels.

use peernet_imaging::{Orientation, Picture, read_part, turn_upright};
use peernet_logger::Recorder;
use peernet_sample::{MediaType, Sample};
use serde::{Deserialize, Serialize};

use super::{TransformConfig, TransformKind, transform_pictures, working_format};
use crate::{SensorError, Transform};

/// Configuration of the transform: `{ kind = "decode" }`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecodeConfig {
    /// Orientation of the result: `stored` (default) as the pixels are stored, or `exif` to turn the picture upright by
    /// the EXIF tag of the file.
    #[serde(default, skip_serializing_if = "Orientation::is_stored")]
    pub orientation: Orientation,
}

impl TransformKind for DecodeConfig {
    fn build(&self) -> Result<Box<dyn Transform>, SensorError> {
        Ok(Box::new(DecodeTransform { orientation: self.orientation }))
    }
}

impl TransformConfig {
    /// Returns the configuration that decodes pictures to pixels.
    pub fn to_pixels() -> Self {
        DecodeConfig::default().into()
    }
}

struct DecodeTransform {
    orientation: Orientation,
}

impl Transform for DecodeTransform {
    fn apply(&mut self, sample: Sample, _recorder: &mut Recorder) -> Result<Sample, SensorError> {
        transform_pictures(sample, "decode", |part| {
            // Decoded pixels have no EXIF tag, so that they are never turned.
            if let MediaType::Pixels(_) = part.description.media {
                return Ok(part.clone());
            }
            let mut picture = Picture::default();
            read_part(part, working_format(part), &mut picture)?;
            if self.orientation == Orientation::Exif {
                turn_upright(part, &mut picture)?;
            }
            Ok(picture.into_part())
        })
    }

    fn describe(&self) -> String {
        match self.orientation {
            Orientation::Stored => "decode".to_owned(),
            Orientation::Exif => "decode, upright by EXIF".to_owned(),
        }
    }
}
