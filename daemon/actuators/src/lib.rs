//! What a pipeline does with an answer.
//!
//! `none` does nothing, `log` writes answers to the log, `exec` hands them to a program of the user's own. A new kind
//! is one file here plus one variant of [`ActuatorConfig`].

mod exec;
mod log;
mod none;

use peernet_clock::SharedClock;
use peernet_external::exec::{ExecConfig, FingerprintKey, Role};
use peernet_external::hide_values;
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

    /// Whether `act` may block, and so must not run on an I/O thread.
    fn blocks(&self) -> bool {
        false
    }
}

/// Why an action failed.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ActuatorError(pub String);

/// `actuator` in the configuration of a pipeline.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ActuatorConfig {
    /// Does nothing.
    None {},
    /// Writes each answer to the log.
    Log {},
    /// Hands each answer to a program of your own: docs/external-programs.md.
    Exec(ExecConfig),
}

impl Default for ActuatorConfig {
    fn default() -> Self {
        Self::None {}
    }
}

impl ActuatorConfig {
    /// The actuator; `clock` is what its deadlines are taken from.
    ///
    /// # Errors
    /// When its program cannot be started.
    pub fn build(&self, clock: &SharedClock) -> Result<Box<dyn Actuator>, ActuatorError> {
        Ok(match self {
            Self::None {} => Box::new(none::Idle),
            Self::Log {} => Box::new(log::Log),
            Self::Exec(config) => Box::new(exec::Exec::start(config, clock)?),
        })
    }

    /// What it is, in words, for the run's page, as of a sensor; nothing where answers are not acted upon. Reads its files.
    pub fn facts(&self) -> Vec<(String, String)> {
        match self {
            Self::None {} => Vec::new(),
            Self::Log {} => vec![("Actuator".to_owned(), "log".to_owned())],
            Self::Exec(config) => config.facts(Role::Actuator),
        }
    }

    /// What tells programs with different arguments apart, as a fact; the arguments themselves may be secret.
    pub fn arguments(&self, key: &FingerprintKey) -> Option<(String, String)> {
        match self {
            Self::Exec(config) => config.arguments(Role::Actuator, key),
            Self::None {} | Self::Log {} => None,
        }
    }

    /// Takes out what may not be published: the values of `env`.
    pub fn hide_secrets(&mut self) {
        match self {
            Self::Exec(config) => hide_values(&mut config.env),
            Self::None {} | Self::Log {} => {}
        }
    }

    /// Checks what can be checked without running a user's program.
    ///
    /// # Errors
    /// When the configuration contradicts itself, or what it names is not there.
    pub fn check(&self) -> Result<(), ActuatorError> {
        match self {
            Self::None {} | Self::Log {} => Ok(()),
            Self::Exec(config) => config
                .check()
                .map_err(|reason| ActuatorError(format!("the program of an exec actuator: {reason}"))),
        }
    }
}
