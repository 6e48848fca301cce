//! What a pipeline keeps over all its runs: its sensor, its actuator, its beat.

use std::io;
use std::sync::Arc;

use peernet_actuators::{ActuatorError, ActuatorKind};
use peernet_clock::{MonoTime, SharedClock};
use peernet_external::exec::FingerprintKey;
use peernet_sensors::{SensorError, SensorKind, Transform, TransformKind};
use tokio::task::JoinError;

use super::acting::Acting;
use super::alarm::Alarm;
use super::cycle::Awaited;
use super::load::Schedule;
use super::sensing::{Chain, Senses};
use crate::config::PipelineConfig;
use crate::live::Display;

/// The reason why a pipeline cannot be assembled.
#[derive(Debug, thiserror::Error)]
pub(super) enum AssembleError {
    /// The sensor or a transform cannot be set up.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// The actuator cannot be set up.
    #[error(transparent)]
    Actuator(#[from] ActuatorError),
    /// There is no thread for the sensor.
    #[error("cannot start a thread for the sensor: {0}")]
    Thread(#[source] io::Error),
    /// There is no timer for the starts.
    #[error("cannot have a timer: {0}")]
    Timer(#[source] io::Error),
    /// The configuration names no sensor.
    #[error("the pipeline has no sensor; add one")]
    NoSensor,
    /// The sensor panicked while it was set up.
    #[error("setting up the sensor panicked: {0}")]
    Panicked(#[from] JoinError),
}

/// An assembled pipeline without a place to compute.
pub(super) struct Line {
    pub(super) config: Arc<PipelineConfig>,
    pub(super) display: Arc<Display>,
    pub(super) senses: Senses,
    /// The sample that the sensor is asked for. It may outlive a connection: nobody can take the question back.
    pub(super) sensing: Option<Awaited>,
    /// `None` when answers are not acted upon.
    pub(super) actuator: Option<Acting>,
    pub(super) schedule: Schedule,
    pub(super) alarm: Alarm,
    /// Sensor, transforms, load and so on, as pairs for people.
    facts: Vec<(String, String)>,
}

impl Line {
    /// Opens the sensor and sets up the rest. Blocks: a folder of pictures may be on a slow disk.
    ///
    /// # Errors
    /// When a part of it cannot be set up.
    pub(super) fn assemble(
        config: Arc<PipelineConfig>,
        display: Arc<Display>,
        clock: SharedClock,
        fingerprints: &FingerprintKey,
    ) -> Result<Self, AssembleError> {
        let sensor_config = config.sensor.as_ref().ok_or(AssembleError::NoSensor)?;
        let sensor = sensor_config.open(&clock)?;
        let transforms = config.transforms.iter().map(TransformKind::build).collect::<Result<Vec<_>, _>>()?;
        let mut facts = sensor.facts();
        facts.extend(sensor_config.arguments(fingerprints));
        if !transforms.is_empty() {
            facts.push(("Transforms".to_owned(), in_words(&transforms)));
        }
        facts.push(("Load".to_owned(), config.load.describe()));
        if config.load.hz().is_some() {
            facts.push(("In flight".to_owned(), format!("at most {}", config.max_in_flight)));
        }
        facts.extend(config.actuator.facts());
        facts.extend(config.actuator.arguments(fingerprints));
        let senses =
            Senses::new(Chain { sensor, transforms }, &config.name).map_err(AssembleError::Thread)?;
        Ok(Self {
            actuator: Acting::new(&config.actuator, &clock)?,
            schedule: Schedule::new(&config.load, config.max_in_flight.get(), clock.mono()),
            alarm: Alarm::new(clock).map_err(AssembleError::Timer)?,
            config,
            display,
            senses,
            sensing: None,
            facts,
        })
    }

    /// Begins the beat anew, with a run: what came due before there was one is nobody's latency.
    pub(super) fn begin_beat(&mut self, now: MonoTime) {
        self.schedule = Schedule::new(&self.config.load, self.config.max_in_flight.get(), now);
    }

    /// What the run's page says of sensor, transforms and load, then of the model.
    pub(super) fn facts(&self, model: Vec<(String, String)>) -> Vec<(String, String)> {
        self.facts.iter().cloned().chain(model).collect()
    }

    /// Iterations that may be under way at once.
    pub(super) fn places(&self) -> usize {
        if self.schedule.is_closed() { 1 } else { self.config.max_in_flight.get() }
    }
}

fn in_words(transforms: &[Box<dyn Transform>]) -> String {
    transforms.iter().map(|transform| transform.describe()).collect::<Vec<_>>().join(", ")
}
