//! Transform `decode`, which decodes pictures to pixels.

use peernet_imaging::{Picture, read_part};
use peernet_logger::Recorder;
use peernet_sample::{MediaType, Sample};
use serde::{Deserialize, Serialize};

use super::{TransformConfig, TransformKind, transform_pictures, working_format};
use crate::{SensorError, Transform};

/// Configuration of the transform: `{ kind = "decode" }`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecodeConfig {}

impl TransformKind for DecodeConfig {
    fn build(&self) -> Result<Box<dyn Transform>, SensorError> {
        Ok(Box::new(Decode))
    }
}

impl TransformConfig {
    /// Returns the configuration that decodes pictures to pixels.
    pub fn to_pixels() -> Self {
        DecodeConfig {}.into()
    }
}

struct Decode;

impl Transform for Decode {
    fn apply(&mut self, sample: Sample, _log: &mut Recorder) -> Result<Sample, SensorError> {
        transform_pictures(sample, "decode", |part| {
            if let MediaType::Pixels(_) = part.description.media {
                return Ok(part.clone());
            }
            let mut picture = Picture::default();
            read_part(part, working_format(part), &mut picture)?;
            Ok(picture.into_part())
        })
    }

    fn describe(&self) -> String {
        "decode".to_owned()
    }
}
