//! Transform `encode`, which compresses pictures.

use peernet_imaging::{Encoding, Picture, encode, read_part};
use peernet_logger::Recorder;
use peernet_sample::Sample;
use serde::{Deserialize, Serialize};

use super::{TransformConfig, TransformKind, transform_pictures, working_format};
use crate::{SensorError, Transform};

/// Configuration of the transform: `{ kind = "encode", … }`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncodeConfig {
    /// Format of the file.
    pub format: Format,
    /// Quality of a JPEG file, 1 to 100. Default: 85.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<u8>,
}

/// File format of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// Lossy and small.
    Jpeg,
    /// Lossless.
    Png,
}

impl TransformKind for EncodeConfig {
    fn build(&self) -> Result<Box<dyn Transform>, SensorError> {
        let config_error = |reason: &str| Err(SensorError::Config(reason.to_owned()));
        let encoding = match (self.format, self.quality) {
            (Format::Jpeg, None) => Encoding::Jpeg { quality: 85 },
            (Format::Jpeg, Some(quality @ 1..=100)) => Encoding::Jpeg { quality },
            (Format::Jpeg, Some(_)) => return config_error("the quality of a jpeg goes from 1 to 100"),
            (Format::Png, None) => Encoding::Png,
            (Format::Png, Some(_)) => return config_error("a png is lossless and takes no quality"),
        };
        Ok(Box::new(EncodeTransform { encoding, picture: Picture::default() }))
    }
}

impl TransformConfig {
    /// Returns the configuration that compresses pictures as JPEG files of this quality, 1 to 100.
    pub fn to_jpeg(quality: u8) -> Self {
        EncodeConfig { format: Format::Jpeg, quality: Some(quality) }.into()
    }
}

struct EncodeTransform {
    encoding: Encoding,
    /// Buffer for the decoded picture.
    picture: Picture,
}

impl Transform for EncodeTransform {
    fn apply(&mut self, sample: Sample, _recorder: &mut Recorder) -> Result<Sample, SensorError> {
        let Self { encoding, picture } = self;
        transform_pictures(sample, "encode", |part| {
            read_part(part, working_format(part), picture)?;
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
