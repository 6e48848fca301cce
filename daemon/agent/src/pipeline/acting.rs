//! The actuator of a pipeline, on the thread that suits it.

use std::sync::Arc;

use peernet_actuators::{Actuator, ActuatorConfig, ActuatorKind};
use peernet_clock::SharedClock;
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;
use tokio::sync::Mutex;
use tokio::task::spawn_blocking;

/// Acts on one answer after the other, in the order in which they came.
#[derive(Clone)]
pub(super) struct Acting {
    actuator: Arc<Mutex<Box<dyn Actuator>>>,
    /// It may block: in the pipeline's own task it would hold up all that is under way.
    blocks: bool,
}

impl Acting {
    /// Sets up the actuator; `None` when answers are not acted upon: then nothing is recorded either.
    ///
    /// # Errors
    /// A sentence that says what could not be set up.
    pub(super) fn new(config: &ActuatorConfig, clock: &SharedClock) -> Result<Option<Self>, String> {
        if !config.acts() {
            return Ok(None);
        }
        let actuator = config.build(clock).map_err(|error| error.to_string())?;
        let blocks = actuator.blocks();
        Ok(Some(Self { actuator: Arc::new(Mutex::new(actuator)), blocks }))
    }

    /// Acts on an answer, recording `actuation`. An error is a sentence.
    pub(super) async fn act(
        &self,
        mut log: Recorder,
        source: &str,
        answer: &Sample,
    ) -> (Recorder, Result<(), String>) {
        let mut actuator = Arc::clone(&self.actuator).lock_owned().await;
        if !self.blocks {
            let acted = act(actuator.as_mut(), &mut log, source, answer);
            return (log, acted);
        }
        // When the thread panics this copy tells what was known before.
        let spare = log.clone();
        let (source, answer) = (source.to_owned(), answer.clone());
        let acting = spawn_blocking(move || {
            let acted = act(actuator.as_mut(), &mut log, &source, &answer);
            (log, acted)
        });
        acting.await.unwrap_or_else(|error| (spare, Err(format!("the actuator did not finish: {error}"))))
    }
}

fn act(actuator: &mut dyn Actuator, log: &mut Recorder, source: &str, answer: &Sample) -> Result<(), String> {
    actuator.act(source, answer, &mut log.time(stage::ACTUATION)).map_err(|error| error.to_string())
}
