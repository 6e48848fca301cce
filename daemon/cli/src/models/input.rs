//! Input for trying a model.

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use peernet_clock::SharedClock;
use peernet_inference::bank::ModelOnDisk;
use peernet_logger::{HostId, Recorder};
use peernet_sample::{MediaType, Part, Sample};
use peernet_sensors::{SensorConfig, SensorKind};

use super::failure;

/// Name of the folder of test pictures in a model's folder.
const PICTURES: &str = "pictures";

/// Samples with their description.
pub(super) struct Input {
    pub(super) samples: Vec<Sample>,
    pub(super) description: String,
}

impl Input {
    /// Reads the pictures at a path, or without a path the model's test pictures, with their labels. `None` if there
    /// is no path and the model has no test pictures.
    pub(super) fn pictures(
        model: &ModelOnDisk,
        path: Option<&Path>,
        clock: &SharedClock,
    ) -> Result<Option<Self>, Failure> {
        let model_pictures = model.folder.join(PICTURES);
        match path {
            Some(path) => read(path.to_owned(), clock).map(Some),
            None if model_pictures.is_dir() => read(model_pictures, clock).map(Some),
            None => Ok(None),
        }
    }

    /// Creates a sample that the model accepts. Pictures are pixels, so that nothing has to be decoded. Other parts of
    /// the payload are arrays of zeros.
    pub(super) fn generated(model: &ModelOnDisk) -> Result<Self, Failure> {
        let sample = model.example_sample().map_err(failure)?;
        let describe_part = |part: &Part| match (&part.description.media, &part.description.shape[..]) {
            (MediaType::Pixels(_), [height, width, _]) => format!("generated pixels, {width} × {height}"),
            (_, shape) => {
                format!("zeros, {}", shape.iter().map(u32::to_string).collect::<Vec<_>>().join(" × "))
            }
        };
        let parts = sample.parts.iter().map(describe_part).collect::<Vec<_>>().join("; ");
        let description = format!("{parts}: preprocessing has nothing to decode");
        Ok(Self { samples: vec![sample], description })
    }
}

fn read(path: PathBuf, clock: &SharedClock) -> Result<Input, Failure> {
    let unusable = |error| Failure::new(Exit::NoInput, error);
    let path_text = path.display().to_string();
    let mut sensor = SensorConfig::pictures_once(path).open(clock).map_err(unusable)?;
    let mut log = Recorder::new(std::sync::Arc::clone(clock), HostId::random());
    let mut samples = Vec::new();
    while let Some(sample) = sensor.sample(&mut log).map_err(unusable)? {
        samples.push(sample);
    }
    Ok(Input {
        description: match samples.len() {
            1 => path_text,
            count => format!("{count} pictures of {path_text}"),
        },
        samples,
    })
}
