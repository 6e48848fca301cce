//! Sensors: one file or folder for each kind, and their registration in [`SensorConfig`].

pub mod exec;
pub mod images;
pub mod python;
pub mod ros;
pub mod synthetic;
pub mod text;

use std::collections::BTreeMap;

use enum_dispatch::enum_dispatch;
use peernet_clock::SharedClock;
use peernet_external::exec::FingerprintKey;
use peernet_external::hide_values;
use serde::{Deserialize, Serialize};

use crate::{Sensor, SensorError};

/// Kind of sensor, implemented by its configuration.
#[enum_dispatch]
pub trait SensorKind {
    /// Opens the sensor; `clock` gives the times of its measurements and time limits.
    ///
    /// # Errors
    /// If the configuration contradicts itself, or if something that it names does not exist.
    fn open(&self, clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError>;

    /// Checks everything that can be checked without running custom code.
    ///
    /// # Errors
    /// If the configuration contradicts itself, or if something that it names does not exist.
    fn check(&self, clock: &SharedClock) -> Result<(), SensorError> {
        self.open(clock).map(drop)
    }

    /// Returns texts about conditions that prevent samples now but are not errors. May wait some seconds for other
    /// hosts.
    fn remarks(&self) -> Vec<String> {
        Vec::new()
    }

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
}

/// The key `sensor` in the configuration of a pipeline. New kinds are registered here.
#[enum_dispatch(SensorKind)]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum SensorConfig {
    /// Pictures from files, sent without any change.
    Images(images::ImagesConfig),
    /// Random letters and digits.
    Text(text::TextConfig),
    /// A custom program; see docs/external-programs.md.
    Exec(exec::ExecConfig),
    /// A custom Python object with `sample()`; see docs/python.md.
    Python(python::PythonConfig),
    /// The messages of a topic of ROS 1 or ROS 2; see docs/ros.md.
    Ros(ros::RosSensorConfig),
    /// Random bytes.
    Synthetic(synthetic::SyntheticConfig),
}

/// Default of the key `seed`, which several kinds of sensor have.
const fn default_seed() -> u64 {
    1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_names_unknown_key() {
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
