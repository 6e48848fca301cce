//! Sensors, which yield samples, and transforms, which change them before they are sent or computed on.
//!
//! A new kind is one file in [`sensor`] or [`transform`], registered in the `mod.rs` beside it.

mod error;
pub mod sensor;
pub mod transform;

pub use error::SensorError;
pub use sensor::{SensorConfig, SensorKind};
pub use transform::{TransformConfig, TransformKind};

use peernet_logger::Recorder;
use peernet_sample::Sample;

/// Yields samples.
pub trait Sensor: Send {
    /// The next sample; `None` when there will be no more. May take its time when [`blocks`](Self::blocks);
    /// whatever it wants to report beyond its duration goes into `log`.
    ///
    /// # Errors
    /// When this one sample cannot be had; the next may well be.
    fn sample(&mut self, log: &mut Recorder) -> Result<Option<Sample>, SensorError>;

    /// Whether `sample` may block or compute for long, and so must not run on an I/O thread.
    fn blocks(&self) -> bool {
        true
    }

    /// What it is, in words, for the run's page: pairs such as (`Sensor`, `30 images of models/…`). May read its files, so
    /// that it is asked before a run and not on an I/O thread.
    fn facts(&self) -> Vec<(String, String)>;
}

/// Changes a sample on the edge.
pub trait Transform: Send {
    /// The changed sample.
    ///
    /// # Errors
    /// When this sample cannot be changed, such as a picture that is not one.
    fn apply(&mut self, sample: Sample, log: &mut Recorder) -> Result<Sample, SensorError>;

    /// What it does, in words: `resize to 320 × 240`.
    fn describe(&self) -> String;
}
