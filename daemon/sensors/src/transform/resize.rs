//! Transform `resize`, which scales pictures.

use peernet_imaging::{Filter, Picture, Resizer, read_part};
use peernet_logger::Recorder;
use peernet_sample::Sample;
use serde::{Deserialize, Serialize};

use super::{TransformKind, check_size, transform_pictures, working_format};
use crate::{SensorError, Transform};

/// Configuration of the transform: `{ kind = "resize", … }`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResizeConfig {
    /// New width, pixels.
    pub width: u32,
    /// New height, pixels.
    pub height: u32,
    /// Filter that combines pixels. Default: `bilinear`.
    #[serde(default)]
    pub filter: Filter,
}

impl TransformKind for ResizeConfig {
    fn build(&self) -> Result<Box<dyn Transform>, SensorError> {
        check_size(self.width, self.height, "resize")?;
        Ok(Box::new(ResizeTransform { config: *self, resizer: Resizer::new(), picture: Picture::default() }))
    }
}

struct ResizeTransform {
    config: ResizeConfig,
    resizer: Resizer,
    /// Buffer for the decoded picture.
    picture: Picture,
}

impl Transform for ResizeTransform {
    fn apply(&mut self, sample: Sample, _recorder: &mut Recorder) -> Result<Sample, SensorError> {
        let Self { config: ResizeConfig { width, height, filter }, resizer, picture } = self;
        transform_pictures(sample, "resize", |part| {
            read_part(part, working_format(part), picture)?;
            // The scaled pixels become the payload of the part, so that each sample needs a new buffer. The buffer of
            // the decoded picture is reused.
            let mut scaled = Picture::default();
            resizer.resize(picture, *width, *height, *filter, &mut scaled)?;
            Ok(scaled.into_part())
        })
    }

    fn describe(&self) -> String {
        format!("resize to {} × {}", self.config.width, self.config.height)
    }
}
