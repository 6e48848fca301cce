//! Runs the actuator of a pipeline, inline or on a thread.

use std::sync::Arc;

use peernet_actuators::{Actuator, ActuatorConfig, ActuatorError, ActuatorKind};
use peernet_clock::SharedClock;
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;
use tokio::sync::Mutex;
use tokio::task::{JoinError, spawn_blocking};

/// Reason why an actuator did not act on an answer.
#[derive(Debug, thiserror::Error)]
pub(super) enum ActError {
    /// The actuator returned an error.
    #[error(transparent)]
    Actuator(#[from] ActuatorError),
    /// The actuator panicked.
    #[error("the actuator panicked: {0}")]
    Panicked(#[from] JoinError),
}

/// Runs a pipeline's actuator on one answer at a time, in order of arrival.
#[derive(Clone)]
pub(super) struct ActuatorExecutor {
    actuator: Arc<Mutex<Box<dyn Actuator>>>,
    /// `true` if the actuator may block. It then runs on a thread, because it would delay all iterations in flight.
    blocks: bool,
}

impl ActuatorExecutor {
    /// Opens the actuator. `None` if the configuration has none; then no node is recorded.
    ///
    /// # Errors
    /// When the actuator cannot be set up.
    pub(super) fn new(config: &ActuatorConfig, clock: &SharedClock) -> Result<Option<Self>, ActuatorError> {
        if !config.acts() {
            return Ok(None);
        }
        let actuator = config.build(clock)?;
        let blocks = actuator.blocks();
        Ok(Some(Self { actuator: Arc::new(Mutex::new(actuator)), blocks }))
    }

    /// Acts on an answer and records `actuation`.
    pub(super) async fn act(
        &self,
        mut log: Recorder,
        source: &str,
        answer: &Sample,
    ) -> (Recorder, Result<(), ActError>) {
        let mut actuator = Arc::clone(&self.actuator).lock_owned().await;
        if !self.blocks {
            let acted = act(actuator.as_mut(), &mut log, source, answer);
            return (log, acted.map_err(ActError::from));
        }
        // If the thread panics, its recorder is lost; this copy has what was recorded before.
        let log_backup = log.clone();
        let (source, answer) = (source.to_owned(), answer.clone());
        let acting = spawn_blocking(move || {
            let acted = act(actuator.as_mut(), &mut log, &source, &answer);
            (log, acted.map_err(ActError::from))
        });
        acting.await.unwrap_or_else(|panic| (log_backup, Err(panic.into())))
    }
}

fn act(
    actuator: &mut dyn Actuator,
    log: &mut Recorder,
    source: &str,
    answer: &Sample,
) -> Result<(), ActuatorError> {
    actuator.act(source, answer, &mut log.time(stage::ACTUATION))
}
