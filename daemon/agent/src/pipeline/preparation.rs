//! Preparation of the sensor and the actuator between two iterations: the reset before an episode, and the advance of a
//! simulation by the time that the previous iteration took.

use futures::future::{BoxFuture, FutureExt};
use peernet_clock::Span;
use peernet_sensors::SensorError;

use super::actuator_executor::{ActError, ActuatorExecutor};
use super::sensing::PreparationSender;

/// Preparation before the next sample.
#[derive(Clone, Copy, Debug)]
pub(super) enum Preparation {
    /// Resets sensor and actuator for an episode.
    Reset,
    /// Advances the simulation that the sensor observes by the duration of the previous iteration.
    Advance(Span),
}

/// A preparation in progress.
pub(super) type PendingPreparation = BoxFuture<'static, Result<(), PreparationError>>;

/// Reason why the next sample cannot be taken.
#[derive(Debug, thiserror::Error)]
pub(super) enum PreparationError {
    /// The actuator was not reset.
    #[error("cannot reset the actuator for an episode: {0}")]
    ActuatorReset(#[from] ActError),
    /// The sensor was not reset.
    #[error("cannot reset the sensor for an episode: {0}")]
    SensorReset(#[source] SensorError),
    /// The simulation was not advanced.
    #[error("cannot advance the simulation by {0}: {1}")]
    Advance(Span, #[source] SensorError),
    /// The thread of the sensor has ended.
    #[error("the sensor's thread has ended")]
    SensorDied,
}

/// Prepares the actuator first and then the sensor, so that the first sample shows the system after the actuator's
/// reset.
pub(super) fn prepare(
    preparation: Preparation,
    actuator: Option<ActuatorExecutor>,
    sensor: Option<PreparationSender>,
) -> PendingPreparation {
    async move {
        if let (Preparation::Reset, Some(actuator)) = (preparation, actuator) {
            actuator.reset().await?;
        }
        let Some(sensor) = sensor else { return Ok(()) };
        let result = sensor.send(preparation).await.map_err(|_| PreparationError::SensorDied)?;
        result.map_err(|error| match preparation {
            Preparation::Reset => PreparationError::SensorReset(error),
            Preparation::Advance(time) => PreparationError::Advance(time, error),
        })
    }
    .boxed()
}
