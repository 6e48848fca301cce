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
        Ok(Box::new(Resize { to: *self, resizer: Resizer::new(), picture: Picture::default() }))
    }
}

struct Resize {
    to: ResizeConfig,
    resizer: Resizer,
    picture: Picture,
}

impl Transform for Resize {
    fn apply(&mut self, sample: Sample, _log: &mut Recorder) -> Result<Sample, SensorError> {
        let Self { to: ResizeConfig { width, height, filter }, resizer, picture } = self;
        transform_pictures(sample, "resize", |part| {
            read_part(part, working_format(part), picture)?;
            // Each sample gets a new buffer, because it becomes the part. The buffer of the decoded picture is used
            // again.
            let mut small = Picture::default();
            resizer.resize(picture, *width, *height, *filter, &mut small)?;
            Ok(small.into_part())
        })
    }

    fn describe(&self) -> String {
        format!("resize to {} × {}", self.to.width, self.to.height)
    }
}
