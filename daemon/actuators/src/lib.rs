//! What a pipeline does with an answer.
//!
//! `none` does nothing, `log` writes answers to the log, `exec` hands them to a program of the user's own, `ros` publishes them.
//! A new kind is one file here, registered in [`ActuatorConfig`].

mod error;
pub mod exec;
pub mod log;
pub mod none;
pub mod ros;

pub use error::ActuatorError;

use enum_dispatch::enum_dispatch;
use peernet_clock::SharedClock;
use peernet_external::exec::FingerprintKey;
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

/// A kind of actuator, implemented by its configuration.
#[enum_dispatch]
pub trait ActuatorKind {
    /// Builds the actuator; `clock` is what its deadlines are taken from.
    ///
    /// # Errors
    /// When its program cannot be started.
    fn build(&self, clock: &SharedClock) -> Result<Box<dyn Actuator>, ActuatorError>;

    /// Whether answers are acted upon at all.
    fn acts(&self) -> bool {
        true
    }

    /// What it is, in words, for the run's page, as of a sensor; nothing where answers are not acted upon. Reads its files.
    fn facts(&self) -> Vec<(String, String)>;

    /// Whether it runs a program of the user's own, whose arguments are told by their fingerprint alone.
    fn is_program(&self) -> bool {
        false
    }

    /// What tells programs with different arguments apart, as a fact; the arguments themselves may be secret.
    fn arguments(&self, _key: &FingerprintKey) -> Option<(String, String)> {
        None
    }

    /// Takes out what may not be published: the values of `env`.
    fn hide_secrets(&mut self) {}

    /// Checks what can be checked without running a user's program.
    ///
    /// # Errors
    /// When the configuration contradicts itself, or what it names is not there.
    fn check(&self) -> Result<(), ActuatorError> {
        Ok(())
    }

    /// What is not wrong, but keeps answers from being acted upon now, for people. May ask other hosts for some seconds.
    fn remarks(&self) -> Vec<String> {
        Vec::new()
    }
}

/// `actuator` in the configuration of a pipeline. A new kind is registered here.
#[enum_dispatch(ActuatorKind)]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum ActuatorConfig {
    /// Does nothing.
    None(none::NoneConfig),
    /// Writes each answer to the log.
    Log(log::LogActuatorConfig),
    /// Hands each answer to a program of your own: docs/external-programs.md.
    Exec(exec::ExecConfig),
    /// Publishes each answer on a topic of ROS 1 or ROS 2: docs/ros.md.
    Ros(ros::RosActuatorConfig),
}
