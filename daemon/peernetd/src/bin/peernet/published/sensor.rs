//! What the client senses.

use anyhow::anyhow;
use peernet_clock::ClockIdentity;
use peernet_sensors::{SensorConfig, TransformConfig};
use peernetd::clock;
use peernetd::exit::{Exit, Failure};
use serde_json::{Value, json};

use super::Arguments;

/// What the client senses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SensorType {
    /// A picture, or those of a folder.
    Image,
    /// Random text.
    Text,
    /// The user's own object or program.
    External,
    /// Random bytes.
    Synthetic,
}

impl SensorType {
    pub(super) fn read(text: &str) -> Result<Self, String> {
        match text {
            "image" => Ok(Self::Image),
            "random string" => Ok(Self::Text),
            "external" => Ok(Self::External),
            "synthetic" => Ok(Self::Synthetic),
            _ => Err("there is image, \"random string\", external and synthetic".to_owned()),
        }
    }
}

/// The sensor and what is done with its samples.
///
/// # Errors
/// When an option is missing (64), or the data set is not there (66).
pub(super) fn of(arguments: &Arguments) -> Result<(SensorConfig, Vec<TransformConfig>), Failure> {
    let missing = |text: &str| Failure::new(Exit::Usage, anyhow!("{text}"));
    // Naming an object is asking for it.
    let kind = match (&arguments.sensor_object, arguments.sensor_type) {
        (Some(_), SensorType::Image) => SensorType::External,
        (_, kind) => kind,
    };
    let size = arguments.text_size;
    let (config, transforms) = match kind {
        SensorType::Image => {
            let path = arguments.dataset_loc.as_deref().ok_or_else(|| {
                missing("the sensor image needs --dataset-loc: a picture or a folder of pictures")
            })?;
            (read(json!({ "kind": "images", "path": path }))?, arguments.encoding.transforms())
        }
        SensorType::Synthetic => (read(json!({ "kind": "synthetic", "size_bytes": size }))?, Vec::new()),
        SensorType::Text => (read(json!({ "kind": "text", "length": size }))?, Vec::new()),
        SensorType::External => {
            let object = arguments.sensor_object.as_deref().ok_or_else(|| {
                missing("the sensor external needs --sensor-object: module::object or exec:COMMAND")
            })?;
            (external(object, arguments.pickle)?, Vec::new())
        }
    };
    Ok((checked(config)?, transforms))
}

/// A sensor that is there.
fn checked(config: SensorConfig) -> Result<SensorConfig, Failure> {
    let clock =
        clock::system(ClockIdentity::SYSTEM).map_err(|error| Failure::new(Exit::Unavailable, error))?;
    peernet_sensors::check(&config, &clock).map_err(|error| Failure::new(Exit::NoInput, error))?;
    Ok(config)
}

/// A user's own object or program, which is to be run because this very command line names it.
fn external(object: &str, pickle: bool) -> Result<SensorConfig, Failure> {
    let config = match object.strip_prefix("exec:") {
        Some(command) => json!({ "kind": "exec", "command": command }),
        None => json!({ "kind": "python", "object": object, "pickle": pickle }),
    };
    read(config)
}

fn read(config: Value) -> Result<SensorConfig, Failure> {
    serde_json::from_value(config).map_err(|error| Failure::new(Exit::Usage, error))
}
