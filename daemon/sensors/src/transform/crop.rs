//! Transform `crop`, which cuts a rectangle out of pictures.

use peernet_imaging::{Crop, Picture, crop, read_part};
use peernet_logger::Recorder;
use peernet_sample::Sample;
use serde::{Deserialize, Serialize};

use super::{TransformKind, check_size, transform_pictures, working_format};
use crate::{SensorError, Transform};

/// Configuration of the transform: `{ kind = "crop", … }`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CropConfig {
    /// Width of the rectangle, pixels.
    pub width: u32,
    /// Height of the rectangle, pixels.
    pub height: u32,
    /// Left edge, pixels. Default: centred.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x: Option<u32>,
    /// Upper edge, pixels. Default: centred.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y: Option<u32>,
}

impl TransformKind for CropConfig {
    fn build(&self) -> Result<Box<dyn Transform>, SensorError> {
        let &Self { width, height, x, y } = self;
        check_size(width, height, "crop")?;
        Ok(Box::new(CropTransform { crop: Crop { width, height, x, y }, picture: Picture::default() }))
    }
}

struct CropTransform {
    crop: Crop,
    /// Buffer for the decoded picture.
    picture: Picture,
}

impl Transform for CropTransform {
    fn apply(&mut self, sample: Sample, _recorder: &mut Recorder) -> Result<Sample, SensorError> {
        let Self { crop: rectangle, picture } = self;
        transform_pictures(sample, "crop", |part| {
            read_part(part, working_format(part), picture)?;
            // The cropped pixels become the payload of the part, so that each sample needs a new buffer. The buffer of
            // the decoded picture is reused.
            let mut cropped = Picture::default();
            crop(picture, *rectangle, &mut cropped)?;
            Ok(cropped.into_part())
        })
    }

    fn describe(&self) -> String {
        let Crop { width, height, x, y } = self.crop;
        let position = match (x, y) {
            (None, None) => "the centre".to_owned(),
            (x, y) => {
                let edge_text = |edge: Option<u32>| edge.map_or("centre".to_owned(), |edge| edge.to_string());
                format!("{}, {}", edge_text(x), edge_text(y))
            }
        };
        format!("crop {width} × {height} at {position}")
    }
}
