//! Input for trying a model.

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use peernet_clock::SharedClock;
use peernet_inference::bank::ModelOnDisk;
use peernet_logger::{HostId, Recorder};
use peernet_sample::{Description, PixelFormat, Sample};
use peernet_sensors::{SensorConfig, SensorKind};

/// Name of the folder of test pictures in a model's folder.
const PICTURES: &str = "pictures";
/// Width and height of the synthetic picture, pixels: a usual size of camera pictures.
const SIZE: (u32, u32) = (1280, 720);

/// Samples with their description.
pub(super) struct Input {
    pub(super) samples: Vec<Sample>,
    pub(super) description: String,
}

impl Input {
    /// Reads the pictures at a path, or without a path the model's test pictures, with their labels. `None` if there is no path and
    /// the model has no test pictures.
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

    /// Creates a synthetic picture from pixels, so that nothing has to be decoded.
    pub(super) fn generated() -> Self {
        let (width, height) = SIZE;
        let pixels: Vec<u8> =
            (0..width * height * 3).map(|index| (index.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let description = Description::pixels(PixelFormat::Rgb8, width, height);
        Self {
            samples: vec![Sample::from_part(description, pixels.into())],
            description: format!("generated pixels, {width} × {height}: preprocessing has nothing to decode"),
        }
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
