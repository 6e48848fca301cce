//! `encode`: compresses pictures.

use peernet_imaging::{Encoding, Picture, encode, read_part};
use peernet_logger::Recorder;
use peernet_sample::Sample;

use super::{change, channels};
use crate::{SensorError, Transform};

pub(super) struct Encode {
    encoding: Encoding,
    picture: Picture,
}

impl Encode {
    pub(super) fn new(encoding: Encoding) -> Self {
        Self { encoding, picture: Picture::default() }
    }
}

impl Transform for Encode {
    fn apply(&mut self, sample: Sample, _log: &mut Recorder) -> Result<Sample, SensorError> {
        let Self { encoding, picture } = self;
        change(sample, "encode", |part| {
            read_part(part, channels(part), picture)?;
            encode(picture, *encoding)
        })
    }

    fn describe(&self) -> String {
        match self.encoding {
            Encoding::Jpeg { quality } => format!("encode as JPEG, quality {quality}"),
            Encoding::Png => "encode as PNG".to_owned(),
        }
    }
}
