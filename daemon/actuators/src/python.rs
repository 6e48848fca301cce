//! Actuator kind `python`: a custom object with `act(answer)`.

use std::collections::BTreeMap;

use peernet_clock::SharedClock;
pub use peernet_external::python::PythonConfig;
use peernet_external::python::{PythonObject, Role};
use peernet_logger::{Recorder, stage};

use crate::{Action, Actuator, ActuatorError, ActuatorKind, Feedback};

/// Actuator that passes each answer to a Python object.
struct PythonActuator {
    name: String,
    object: PythonObject,
}

impl ActuatorKind for PythonConfig {
    /// Starts the Python process and creates the object in it.
    fn build(&self, clock: &SharedClock) -> Result<Box<dyn Actuator>, ActuatorError> {
        let name = format!("actuator {}", self.object);
        // Only a model is configured for a device.
        let device = None;
        let object = PythonObject::start(self, Role::Actuator, &name, device, clock)?;
        Ok(Box::new(PythonActuator { name: self.object.clone(), object }))
    }

    fn try_build(&self, clock: &SharedClock) -> Result<(), ActuatorError> {
        self.build(clock).map(drop)
    }

    // Creating the object would run custom code.
    fn remarks(&self, _clock: &SharedClock) -> Vec<String> {
        Vec::new()
    }

    fn ends_episodes(&self) -> bool {
        true
    }

    // Only the created object can state its facts; see `Actuator::facts()`.
    fn facts(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        Some(&mut self.env)
    }

    fn check(&self, clock: &SharedClock) -> Result<(), ActuatorError> {
        Ok(PythonObject::check(self, clock)?)
    }
}

impl Actuator for PythonActuator {
    fn act(&mut self, action: Action<'_>, recorder: &mut Recorder) -> Result<Feedback, ActuatorError> {
        let call = self.object.call(&action.answer.parts);
        let started_at = call.times.started_at;
        if let Some(from) = call.times.restart_began_at {
            recorder.record_timer(stage::ACTUATION_RESTART, from, started_at);
        }
        recorder.record_timer(stage::ACTUATION_IPC, started_at, started_at + call.times.overhead());
        let parts = call.result?.unwrap_or_default();
        let Some(part) = parts.first() else { return Ok(Feedback::default()) };
        Feedback::from_json(&part.bytes)
            .map_err(|reason| ActuatorError::Feedback { actuator: self.name.clone(), reason })
    }

    fn blocks(&self) -> bool {
        true
    }

    fn resets(&self) -> bool {
        self.object.resets()
    }

    fn reset(&mut self) -> Result<(), ActuatorError> {
        Ok(self.object.reset()?)
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.object.description().facts("Actuator")
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, SystemClock};
    use peernet_logger::HostId;
    use peernet_sample::{Description, MediaType, Sample};

    use super::*;
    use crate::ActuatorConfig;

    const ARM: &str = "
class Arm:
    def __init__(self): self.resets = 0
    def reset(self): self.resets += 1
    def act(self, answer):
        if answer == 'wall': raise RuntimeError('too close')
        return {'reward': self.resets, 'success': answer == 'door'}
";

    fn folder_of(config: &ActuatorConfig) -> Option<std::path::PathBuf> {
        let ActuatorConfig::Python(config) = config else { return None };
        config.folder.clone()
    }

    #[test]
    fn object_acts_resets_and_gives_feedback() {
        let folder = tempfile::tempdir().expect("can be made");
        std::fs::write(folder.path().join("own.py"), ARM).expect("can be written");
        let folder = Some(folder.path().to_owned());
        let config = ActuatorConfig::Python(PythonConfig { folder, ..PythonConfig::new("own::Arm") });
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        config.check(&clock).expect("is there");
        let mut actuator = config.build(&clock).expect("is there");
        assert!(actuator.blocks() && actuator.resets() && config.ends_episodes());
        assert!(actuator.facts()[0].1.starts_with("the Python class own::Arm"), "{:?}", actuator.facts());
        actuator.reset().expect("is reset");
        let mut recorder = Recorder::new(SharedClock::clone(&clock), HostId::random());
        let mut act = |answer: &'static str| {
            let answer = Sample::from_part(Description::unshaped(MediaType::Text), answer.into());
            actuator.act(Action::first(&answer, "eye"), &mut recorder)
        };
        let expected = Feedback { success: Some(true), reward: Some(1.0), ..Feedback::default() };
        assert_eq!(act("door").expect("acts"), expected);
        let error = act("wall").expect_err("raises").to_string();
        assert!(error.contains("too close") && error.contains("own.py"), "{error}");
        assert_eq!(act("left").expect("goes on").success, Some(false));
        assert!(recorder.tree().find(&["actuation-ipc"]).is_some());
        let missing = ActuatorConfig::Python(PythonConfig::new("nowhere::Arm")).check(&clock);
        assert!(missing.expect_err("is not there").to_string().contains("nowhere.py"));
        config.try_build(&clock).expect("can be created");
        let folder = folder_of(&config);
        let no_class = ActuatorConfig::Python(PythonConfig { folder, ..PythonConfig::new("own::Leg") });
        no_class.check(&clock).expect("the module is there");
        let error = no_class.try_build(&clock).expect_err("the class is not there").to_string();
        assert!(error.contains("own::Leg"), "{error}");
    }
}
