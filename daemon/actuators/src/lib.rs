//! What a pipeline does with an answer.
//!
//! A new kind is one file here plus one variant of [`ActuatorConfig`].

mod log;
mod none;

use peernet_logger::Recorder;
use peernet_sample::Sample;
use serde::{Deserialize, Serialize};

/// Acts on the answer of a model.
pub trait Actuator: Send {
    /// Acts on `answer`, given for the sample that came from `source`.
    ///
    /// # Errors
    /// When the action failed; the iteration is recorded as failed.
    fn act(&mut self, source: &str, answer: &Sample, log: &mut Recorder) -> Result<(), ActuatorError>;
}

/// Why an action failed.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ActuatorError(pub String);

/// `actuator` in the configuration of a pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ActuatorConfig {
    /// Does nothing.
    None {},
    /// Writes each answer to the log.
    Log {},
}

impl Default for ActuatorConfig {
    fn default() -> Self {
        Self::None {}
    }
}

impl ActuatorConfig {
    /// The actuator.
    pub fn build(&self) -> Box<dyn Actuator> {
        match self {
            Self::None {} => Box::new(none::Idle),
            Self::Log {} => Box::new(log::Log),
        }
    }
}
