//! Sensors, which produce samples, and transforms, which change samples before they are sent or computed.
//!
//! A new kind is one file in [`sensor`] or [`transform`], registered in the `mod.rs` there.

mod error;
mod file;
mod mask;
pub mod sensor;
pub mod transform;

pub use error::SensorError;
pub use mask::read_mask;
pub use sensor::{SensorConfig, SensorKind};
pub use transform::{TransformConfig, TransformKind};

use peernet_clock::Span;
use peernet_logger::Recorder;
use peernet_sample::Sample;

/// Produces samples.
pub trait Sensor: Send {
    /// Returns the next sample; `None` if there are no more. May block if [`blocks`](Self::blocks) returns `true`.
    /// Records stages and values of the capture in `recorder`; the caller records the duration.
    ///
    /// # Errors
    /// If this sample cannot be captured. The next sample may succeed.
    fn sample(&mut self, recorder: &mut Recorder) -> Result<Option<Sample>, SensorError>;

    /// Returns whether the sensor has to be reset before each episode.
    fn resets(&self) -> bool {
        false
    }

    /// Prepares the sensor, or the system that it observes, for an episode. Called only if [`resets`](Self::resets)
    /// returns `true`; then [`blocks`](Self::blocks) must also return `true`.
    ///
    /// # Errors
    /// If the reset fails; a later reset may succeed.
    fn reset(&mut self) -> Result<(), SensorError> {
        Ok(())
    }

    /// Returns whether the sensor observes a simulation, which has to be advanced by the duration of each iteration.
    fn advances(&self) -> bool {
        false
    }

    /// Advances the simulation that the sensor observes by `time`, before its next sample. Called only if
    /// [`advances`](Self::advances) and [`blocks`](Self::blocks) return `true`.
    ///
    /// # Errors
    /// If the simulation cannot be advanced; its state is then unknown until the next reset.
    fn advance(&mut self, time: Span) -> Result<(), SensorError> {
        let _ = time;
        Ok(())
    }

    /// Returns whether `sample` may block or compute for long. If so, it must not run on an I/O thread.
    fn blocks(&self) -> bool {
        true
    }

    /// Returns facts for the run's page: pairs such as (`Sensor`, `30 images of models/…`). May read files, so it must
    /// be called before a run and not on an I/O thread.
    fn facts(&self) -> Vec<(String, String)>;
}

/// Changes samples on the edge.
pub trait Transform: Send {
    /// Returns the changed sample.
    ///
    /// # Errors
    /// If this sample cannot be changed, for example because it is not a picture.
    fn apply(&mut self, sample: Sample, recorder: &mut Recorder) -> Result<Sample, SensorError>;

    /// Describes the transform: `resize to 320 × 240`.
    fn describe(&self) -> String;
}
