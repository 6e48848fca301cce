//! `resize`: scales pictures.

use peernet_imaging::{Filter, Picture, Resizer, read_part};
use peernet_logger::Recorder;
use peernet_sample::Sample;

use super::{change, channels};
use crate::{SensorError, Transform};

pub(super) struct Resize {
    width: u32,
    height: u32,
    filter: Filter,
    resizer: Resizer,
    picture: Picture,
}

impl Resize {
    pub(super) fn new(width: u32, height: u32, filter: Filter) -> Self {
        Self { width, height, filter, resizer: Resizer::new(), picture: Picture::default() }
    }
}

impl Transform for Resize {
    fn apply(&mut self, sample: Sample, _log: &mut Recorder) -> Result<Sample, SensorError> {
        let Self { width, height, filter, resizer, picture } = self;
        change(sample, "resize", |part| {
            read_part(part, channels(part), picture)?;
            let mut small = Picture::default();
            resizer.resize(picture, *width, *height, *filter, &mut small)?;
            Ok(small.into_part())
        })
    }

    fn describe(&self) -> String {
        format!("resize to {} × {}", self.width, self.height)
    }
}
