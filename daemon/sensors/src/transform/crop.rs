//! `crop`: cuts a rectangle out of pictures.

use peernet_imaging::{Crop, Picture, crop, read_part};
use peernet_logger::Recorder;
use peernet_sample::Sample;

use super::{change, channels};
use crate::{SensorError, Transform};

pub(super) struct Cut {
    crop: Crop,
    picture: Picture,
}

impl Cut {
    pub(super) fn new(crop: Crop) -> Self {
        Self { crop, picture: Picture::default() }
    }
}

impl Transform for Cut {
    fn apply(&mut self, sample: Sample, _log: &mut Recorder) -> Result<Sample, SensorError> {
        let Self { crop: rectangle, picture } = self;
        change(sample, "crop", |part| {
            read_part(part, channels(part), picture)?;
            let mut cut = Picture::default();
            crop(picture, *rectangle, &mut cut)?;
            Ok(cut.into_part())
        })
    }

    fn describe(&self) -> String {
        let Crop { width, height, x, y } = self.crop;
        let at = match (x, y) {
            (None, None) => "the centre".to_owned(),
            (x, y) => {
                let place = |edge: Option<u32>| edge.map_or("centre".to_owned(), |edge| edge.to_string());
                format!("{}, {}", place(x), place(y))
            }
        };
        format!("crop {width} × {height} at {at}")
    }
}
