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
/// Size of the synthetic picture in pixels, a usual size of camera pictures.
const SIZE: (u32, u32) = (1280, 720);

/// Samples with their description.
pub(super) struct Input {
    pub(super) samples: Vec<Sample>,
    pub(super) what: String,
}

impl Input {
    /// Reads the pictures of a file or folder, or otherwise the test pictures of the model, with their labels. `None` if the model has no
    /// test pictures.
    pub(super) fn pictures(
        found: &ModelOnDisk,
        given: Option<&Path>,
        clock: &SharedClock,
    ) -> Result<Option<Self>, Failure> {
        let own = found.folder.join(PICTURES);
        match given {
            Some(path) => read(path.to_owned(), clock).map(Some),
            None if own.is_dir() => read(own, clock).map(Some),
            None => Ok(None),
        }
    }

    /// Creates a synthetic picture from pixels, so that nothing has to be decoded.
    pub(super) fn generated() -> Self {
        let (width, height) = SIZE;
        let pixels: Vec<u8> =
            (0..width * height * 3).map(|at| (at.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let description = Description::pixels(PixelFormat::Rgb8, width, height);
        Self {
            samples: vec![Sample::from_part(description, pixels.into())],
            what: format!("generated pixels, {width} × {height}: preprocessing has nothing to decode"),
        }
    }
}

fn read(path: PathBuf, clock: &SharedClock) -> Result<Input, Failure> {
    let unusable = |error| Failure::new(Exit::NoInput, error);
    let what = path.display().to_string();
    let mut sensor = SensorConfig::pictures_once(path).open(clock).map_err(unusable)?;
    let mut log = Recorder::new(std::sync::Arc::clone(clock), HostId::random());
    let mut samples = Vec::new();
    while let Some(sample) = sensor.sample(&mut log).map_err(unusable)? {
        samples.push(sample);
    }
    Ok(Input {
        what: if samples.len() == 1 { what } else { format!("{} pictures of {what}", samples.len()) },
        samples,
    })
}
