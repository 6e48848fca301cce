//! Actuators, which act on a model's answers.
//!
//! `none` does nothing, `log` writes answers to the log, `exec` and `python` pass them to custom code, `socket` sends
//! them to a robot's controller, `ros` publishes them. A new kind is one file or folder here, registered in
//! [`ActuatorConfig`].

mod action;
mod error;
pub mod exec;
mod feedback;
pub mod log;
pub mod none;
pub mod python;
pub mod ros;
pub mod socket;
mod socket_error;

pub use action::Action;
pub use error::ActuatorError;
pub use feedback::Feedback;
pub use socket_error::SocketError;

use std::collections::BTreeMap;

use enum_dispatch::enum_dispatch;
use peernet_clock::SharedClock;
use peernet_external::exec::FingerprintKey;
use peernet_external::hide_values;
use peernet_logger::Recorder;
use serde::{Deserialize, Serialize};

/// Acts on the answers of a model.
pub trait Actuator: Send {
    /// Acts on an answer, and returns what the controlled system reports about the action. Records stages and values of
    /// the action in `recorder`; the caller records the duration.
    ///
    /// # Errors
    /// If the action fails; the iteration is recorded as failed.
    fn act(&mut self, action: Action<'_>, recorder: &mut Recorder) -> Result<Feedback, ActuatorError>;

    /// Returns whether the actuator has to be reset before each episode.
    fn resets(&self) -> bool {
        false
    }

    /// Prepares the controlled system for an episode. May block if [`blocks`](Self::blocks) returns `true`.
    ///
    /// # Errors
    /// If the reset fails; a later reset may succeed.
    fn reset(&mut self) -> Result<(), ActuatorError> {
        Ok(())
    }

    /// Returns facts for the run's page that are known only once the actuator is built. May read files.
    fn facts(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    /// Returns whether `act` may block. If so, it must not run on an I/O thread.
    fn blocks(&self) -> bool {
        false
    }
}

/// Kind of actuator, implemented by its configuration.
#[enum_dispatch]
pub trait ActuatorKind {
    /// Builds the actuator; `clock` is the clock of its deadlines.
    ///
    /// # Errors
    /// If the custom code cannot be started, or if the configuration is not valid.
    fn build(&self, clock: &SharedClock) -> Result<Box<dyn Actuator>, ActuatorError>;

    /// Finds conditions that would make an action fail now, without acting: creates the custom object, connects to the
    /// controller or asks the ROS master, and then closes what it opened. May block for some seconds.
    ///
    /// # Errors
    /// Those of [`check`](Self::check), and everything that would make each action fail now.
    fn try_build(&self, clock: &SharedClock) -> Result<(), ActuatorError> {
        self.check(clock)
    }

    /// Returns whether answers are acted on at all.
    fn acts(&self) -> bool {
        true
    }

    /// Returns whether the actuator may end episodes before their last step.
    fn ends_episodes(&self) -> bool {
        false
    }

    /// Returns facts for the run's page that are known without building the actuator; none if answers are not acted
    /// on. Reads the files that the configuration names.
    fn facts(&self) -> Vec<(String, String)>;

    /// Returns whether this kind runs a custom program, whose arguments are published as a fingerprint only.
    fn is_program(&self) -> bool {
        false
    }

    /// Returns a fact with a fingerprint of the program's arguments: different arguments have different fingerprints.
    /// The arguments themselves may be secret.
    fn arguments_fact(&self, _key: &FingerprintKey) -> Option<(String, String)> {
        None
    }

    /// Returns the environment variables that the configuration sets for the processes of custom code; `None` if the
    /// kind has none.
    fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        None
    }

    /// Removes what must not be published: the values of `env`.
    fn hide_secrets(&mut self) {
        self.env_mut().into_iter().for_each(hide_values);
    }

    /// Checks everything that can be checked without running a custom program.
    ///
    /// # Errors
    /// If the configuration contradicts itself, or if something that it names does not exist.
    fn check(&self, _clock: &SharedClock) -> Result<(), ActuatorError> {
        Ok(())
    }

    /// Returns texts about conditions that prevent actions now although [`check`](Self::check) finds no error. May wait
    /// some seconds for other hosts. Runs no custom code.
    fn remarks(&self, clock: &SharedClock) -> Vec<String> {
        self.try_build(clock).err().map(|error| error.to_string()).into_iter().collect()
    }
}

/// The key `actuator` in the configuration of a pipeline. New kinds are registered here.
#[enum_dispatch(ActuatorKind)]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum ActuatorConfig {
    /// Does nothing.
    None(none::NoneConfig),
    /// Writes each answer to the log.
    Log(log::LogActuatorConfig),
    /// Passes each answer to a custom program; see docs/external-programs.md.
    Exec(exec::ExecConfig),
    /// Passes each answer to a custom Python object with `act(answer)`; see docs/actuators.md.
    Python(python::PythonConfig),
    /// Sends each answer as a line of JSON over UDP or TCP; see docs/actuators.md.
    Socket(socket::SocketConfig),
    /// Publishes each answer on a topic of ROS 1 or ROS 2; see docs/ros.md.
    Ros(ros::RosActuatorConfig),
}
