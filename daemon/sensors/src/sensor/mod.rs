//! The sensors: one file or folder for each kind, and the registration of each in [`SensorConfig`].

pub mod exec;
pub mod images;
pub mod python;
pub mod ros;
pub mod synthetic;
pub mod text;

use enum_dispatch::enum_dispatch;
use peernet_clock::SharedClock;
use peernet_external::exec::FingerprintKey;
use peernet_logger::Name;
use serde::{Deserialize, Serialize};

use crate::{Sensor, SensorError};

/// Samples that a sensor could not give since the one before, because the pipeline was busy or they were lost.
const DROPPED_SAMPLES: Name = Name::from_static("dropped-samples");

/// A kind of sensor, implemented by its configuration.
#[enum_dispatch]
pub trait SensorKind {
    /// Opens the sensor; `clock` is what its deadlines are taken from.
    ///
    /// # Errors
    /// When the configuration contradicts itself, or what it names is not there.
    fn open(&self, clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError>;

    /// Checks what can be checked without running a user's code.
    ///
    /// # Errors
    /// When the configuration contradicts itself, or what it names is not there.
    fn check(&self, clock: &SharedClock) -> Result<(), SensorError> {
        self.open(clock).map(drop)
    }

    /// What is not wrong, but keeps samples from coming now, for people. May ask other hosts for some seconds.
    fn remarks(&self) -> Vec<String> {
        Vec::new()
    }

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
}

/// `sensor` in the configuration of a pipeline. A new kind is registered here.
#[enum_dispatch(SensorKind)]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum SensorConfig {
    /// Pictures from files, sent as they are.
    Images(images::ImagesConfig),
    /// Random letters and digits.
    Text(text::TextConfig),
    /// A program of your own: docs/external-programs.md.
    Exec(exec::ExecConfig),
    /// A Python object of your own with `sample()`: docs/python.md.
    Python(python::PythonConfig),
    /// The messages of a topic of ROS 1 or ROS 2: docs/ros.md.
    Ros(ros::RosSensorConfig),
    /// Random bytes.
    Synthetic(synthetic::SyntheticConfig),
}

/// Default of the key `seed`, which several kinds have.
const fn default_seed() -> u64 {
    1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_key_is_refused_by_name() {
        for text in [
            "kind = 'images'\npath = 'p'\nzz = 1",
            "kind = 'text'\nlength = 3\nzz = 1",
            "kind = 'exec'\ncommand = 'x'\nzz = 1",
            "kind = 'python'\nobject = 'a::b'\nzz = 1",
            "kind = 'ros'\ntopic = '/t'\nzz = 1",
            "kind = 'synthetic'\nzz = 1",
        ] {
            let error = toml::from_str::<SensorConfig>(text).expect_err("has an unknown key").to_string();
            assert!(error.contains("unknown field `zz`, expected "), "{error}");
        }
    }
}
