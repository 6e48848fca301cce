//! Actuator kind `none`, which does nothing.

use peernet_clock::SharedClock;
use peernet_logger::Recorder;
use serde::{Deserialize, Serialize};

use crate::{Action, Actuator, ActuatorConfig, ActuatorError, ActuatorKind, Feedback};

/// Configuration of the actuator: `{ kind = "none" }`, the default.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoneConfig {}

impl Default for ActuatorConfig {
    fn default() -> Self {
        NoneConfig {}.into()
    }
}

impl ActuatorKind for NoneConfig {
    fn build(&self, _clock: &SharedClock) -> Result<Box<dyn Actuator>, ActuatorError> {
        Ok(Box::new(NoActuator))
    }

    fn acts(&self) -> bool {
        false
    }

    fn facts(&self) -> Vec<(String, String)> {
        Vec::new()
    }
}

/// Actuator that does nothing.
struct NoActuator;

impl Actuator for NoActuator {
    fn act(&mut self, _action: Action<'_>, _recorder: &mut Recorder) -> Result<Feedback, ActuatorError> {
        Ok(Feedback::default())
    }
}
