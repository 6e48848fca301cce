//! The sensor of the client.

use crate::clock;
use crate::exit::{Exit, Failure};
use anyhow::anyhow;
use peernet_clock::ClockIdentity;
use peernet_sensors::{SensorConfig, SensorError, SensorKind, TransformConfig};

use super::Arguments;

/// Type of the client's sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SensorType {
    /// A picture, or the pictures of a folder.
    Image,
    /// Random text.
    Text,
    /// A custom object or program.
    External,
    /// Random bytes.
    Synthetic,
}

/// A text that is not the name of a sensor type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("use image, \"random string\", external or synthetic")]
pub(super) struct UnknownSensorType;

impl SensorType {
    pub(super) fn read(text: &str) -> Result<Self, UnknownSensorType> {
        match text {
            "image" => Ok(Self::Image),
            "random string" => Ok(Self::Text),
            "external" => Ok(Self::External),
            "synthetic" => Ok(Self::Synthetic),
            _ => Err(UnknownSensorType),
        }
    }
}

/// Returns the sensor and the transforms of its samples.
///
/// # Errors
/// When an option is missing or invalid (exit code 64), or the data set does not exist (exit code
/// 66).
pub(super) fn from_arguments(arguments: &Arguments) -> Result<(SensorConfig, Vec<TransformConfig>), Failure> {
    let usage_error = |text: &str| Failure::new(Exit::Usage, anyhow!("{text}"));
    // The type `image` is the default, so `--sensor-object` alone means the type `external`.
    let kind = match (&arguments.sensor_object, arguments.sensor_type) {
        (Some(_), SensorType::Image) => SensorType::External,
        (_, kind) => kind,
    };
    let size = arguments.text_size;
    let (config, transforms) = match kind {
        SensorType::Image => {
            let path = arguments.dataset_loc.as_deref().ok_or_else(|| {
                usage_error("--sensor-type image needs --dataset-loc: a picture or a folder of pictures")
            })?;
            let path = path.to_str().ok_or_else(|| {
                let path = path.display();
                usage_error(&format!("--dataset-loc {path}: run.json cannot hold a name that is not UTF-8; rename the file, or name a link to the file"))
            })?;
            (SensorConfig::pictures(path.into()), arguments.encoding.transforms())
        }
        SensorType::Synthetic => (SensorConfig::random_bytes(size), Vec::new()),
        SensorType::Text => (SensorConfig::random_text(size), Vec::new()),
        SensorType::External => {
            let object = arguments.sensor_object.as_deref().ok_or_else(|| {
                usage_error("--sensor-type external needs --sensor-object: module::object or exec:COMMAND")
            })?;
            (external_sensor(object, arguments.pickle)?, Vec::new())
        }
    };
    Ok((check(config)?, transforms))
}

/// Checks that the sensor can be used.
fn check(config: SensorConfig) -> Result<SensorConfig, Failure> {
    let clock =
        clock::system(ClockIdentity::SYSTEM).map_err(|error| Failure::new(Exit::Unavailable, error))?;
    config.check(&clock).map_err(|error| {
        let is_usage_error = error.is_invalid_object_name() || matches!(error, SensorError::Config(_));
        let exit = if is_usage_error { Exit::Usage } else { Exit::NoInput };
        Failure::new(exit, error)
    })?;
    Ok(config)
}

/// Makes the configuration of a sensor that is a Python object or a program.
fn external_sensor(object: &str, pickle: bool) -> Result<SensorConfig, Failure> {
    Ok(match super::exec_command(object)? {
        Some(command) => SensorConfig::program(command),
        None => SensorConfig::python_object(object, pickle),
    })
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;
    use std::os::unix::ffi::OsStringExt;

    use clap::Parser;

    use super::*;
    use crate::Cli;

    #[test]
    fn invalid_sensor_options_are_usage_errors() {
        let refused = |words: [OsString; 2]| {
            let line = "peernet --client --name a --network-config b.yaml --iterations 7 --sensor-type";
            let kind = if words[0] == "--text-size" { "random string" } else { "image" };
            let words = line.split(' ').map(OsString::from).chain([kind.into()]).chain(words);
            let line = Cli::try_parse_from(words).expect("a command line of the paper's program");
            let failure = from_arguments(&line.paper.expect("its options")).expect_err("refused");
            (failure.exit, failure.to_string())
        };
        let (exit, message) = refused(["--dataset-loc".into(), OsString::from_vec(b"pic\xff".to_vec())]);
        assert!(exit == Exit::Usage && message.contains("not UTF-8"), "{message}");
        let (exit, message) = refused(["--text-size".into(), "99999999999999".into()]);
        assert!(exit == Exit::Usage && message.contains("lower its length"), "{message}");
        assert_eq!(refused(["--dataset-loc".into(), "nowhere".into()]).0, Exit::NoInput);
    }
}
