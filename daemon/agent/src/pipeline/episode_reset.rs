//! Reset of the sensor and the actuator before an episode.

use futures::future::{BoxFuture, FutureExt};
use peernet_sensors::SensorError;

use super::actuator_executor::{ActError, ActuatorExecutor};
use super::sensing::ResetRequest;

/// A reset in progress.
pub(super) type EpisodeReset = BoxFuture<'static, Result<(), ResetError>>;

/// Reason why an episode cannot begin.
#[derive(Debug, thiserror::Error)]
pub(super) enum ResetError {
    /// The actuator was not reset.
    #[error("cannot reset the actuator for an episode: {0}")]
    Actuator(#[from] ActError),
    /// The sensor was not reset.
    #[error("cannot reset the sensor for an episode: {0}")]
    Sensor(#[from] SensorError),
    /// The thread of the sensor has ended.
    #[error("the sensor's thread has ended")]
    SensorDied,
}

/// Resets the actuator, then the sensor: so the sensor's first sample shows the system that the actuator has reset.
pub(super) fn reset(actuator: Option<ActuatorExecutor>, sensor: Option<ResetRequest>) -> EpisodeReset {
    async move {
        if let Some(actuator) = actuator {
            actuator.reset().await?;
        }
        if let Some(sensor) = sensor {
            sensor.send().await.map_err(|_| ResetError::SensorDied)??;
        }
        Ok(())
    }
    .boxed()
}
