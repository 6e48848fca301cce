//! The parts of a pipeline that outlive a run and a connection.

use std::io;
use std::sync::Arc;

use peernet_actuators::{ActuatorError, ActuatorKind};
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_external::exec::FingerprintKey;
use peernet_sensors::{SensorError, SensorKind, Transform, TransformKind};
use tokio::task::JoinError;

use super::actuator_executor::ActuatorExecutor;
use super::load::Schedule;
use super::pipeline_loop::PendingSample;
use super::preparation::{self, PendingPreparation, Preparation};
use super::sensing::{SensorChain, SensorExecutor};
use super::start_timer::StartTimer;
use crate::config::PipelineConfig;
use crate::live::PipelineLiveState;

/// Reason why a pipeline cannot be assembled.
#[derive(Debug, thiserror::Error)]
pub(super) enum AssembleError {
    /// The sensor or a transform cannot be set up.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// The actuator cannot be set up.
    #[error(transparent)]
    Actuator(#[from] ActuatorError),
    /// The operating system refuses a thread for the sensor.
    #[error("cannot start a thread for the sensor: {0}")]
    Thread(#[source] io::Error),
    /// The kernel refuses a timer for the starts.
    #[error("cannot create a timer for the starts of iterations: {0}")]
    Timer(#[source] io::Error),
    /// The configuration names no sensor.
    #[error("the pipeline has no sensor; add the key sensor")]
    NoSensor,
    /// The sensor panicked while it was set up.
    #[error("setting up the sensor panicked: {0}")]
    Panicked(#[from] JoinError),
}

/// The parts of a pipeline that outlive a run and a connection: its configuration and live state, the sensor with its
/// transforms, the actuator, and the schedule of the starts. The placement is not one of these parts, because it ends
/// with its connection.
pub(super) struct PipelineResources {
    pub(super) config: Arc<PipelineConfig>,
    pub(super) live_state: Arc<PipelineLiveState>,
    pub(super) sensor: SensorExecutor,
    /// The requested sample. A request cannot be cancelled, so it may outlive the connection.
    pub(super) pending_sample: Option<PendingSample>,
    /// `None` if the pipeline has no actuator.
    pub(super) actuator: Option<ActuatorExecutor>,
    /// `true` if the sensor or the actuator has to be reset before each episode.
    needs_resets: bool,
    /// `true` if the sensor observes a simulation that is advanced by the duration of each iteration.
    needs_advances: bool,
    /// The preparation in progress. It cannot be cancelled, so it may outlive the connection.
    pub(super) pending_preparation: Option<PendingPreparation>,
    /// `true` from a reset until the first sample after it.
    pub(super) is_reset: bool,
    /// Time by which the simulation is advanced before the next sample: the sum of the durations of the iterations
    /// since the previous preparation. `None` if no iteration has ended since then, or if there is no simulation.
    pending_advance: Option<Span>,
    /// Start of the advance in progress.
    advance_started_at: Option<MonoTime>,
    pub(super) schedule: Schedule,
    pub(super) start_timer: StartTimer,
    /// Facts about sensor, transforms, load and actuator (label and text) for the page of a run.
    facts: Vec<(String, String)>,
}

impl PipelineResources {
    /// Opens the sensor, the transforms and the actuator. Blocks: a folder of images may be on a slow disk.
    ///
    /// # Errors
    /// When a resource cannot be set up.
    pub(super) fn assemble(
        config: Arc<PipelineConfig>,
        live_state: Arc<PipelineLiveState>,
        clock: SharedClock,
        fingerprint_key: &FingerprintKey,
    ) -> Result<Self, AssembleError> {
        let sensor_config = config.sensor.as_ref().ok_or(AssembleError::NoSensor)?;
        let sensor = sensor_config.open(&clock)?;
        let transforms = config.transforms.iter().map(TransformKind::build).collect::<Result<Vec<_>, _>>()?;
        let mut facts = sensor.facts();
        facts.extend(sensor_config.arguments_fact(fingerprint_key));
        if !transforms.is_empty() {
            facts.push(("Transforms".to_owned(), transforms_text(&transforms)));
        }
        facts.push(("Load".to_owned(), config.load.describe()));
        // A closed loop has no rate. It has one iteration in flight, which needs no fact.
        if config.load.hz().is_some() {
            let maximum = if sensor.advances() { 1 } else { config.max_in_flight.get() };
            facts.push(("In flight".to_owned(), format!("at most {maximum}")));
        }
        let actuator = ActuatorExecutor::new(&config.actuator, &clock)?;
        facts.extend(config.actuator.facts());
        facts.extend(actuator.iter().flat_map(|actuator| actuator.facts().iter().cloned()));
        facts.extend(config.actuator.arguments_fact(fingerprint_key));
        let needs_resets = sensor.resets() || actuator.as_ref().is_some_and(ActuatorExecutor::needs_resets);
        let needs_advances = sensor.advances();
        let sensor = SensorExecutor::new(SensorChain { sensor, transforms }, &config.name)
            .map_err(AssembleError::Thread)?;
        Ok(Self {
            actuator,
            needs_resets,
            needs_advances,
            pending_preparation: None,
            is_reset: false,
            pending_advance: None,
            advance_started_at: None,
            schedule: Schedule::new(&config.load, config.max_in_flight.get(), clock.mono()),
            start_timer: StartTimer::new(clock).map_err(AssembleError::Timer)?,
            config,
            live_state,
            sensor,
            pending_sample: None,
            facts,
        })
    }

    /// Restarts the schedule for a run.
    pub(super) fn restart_schedule(&mut self, now: MonoTime) {
        // Starts that came due before the run must not count in its latencies. An advance that began before the run
        // must not postpone the starts of the run.
        self.advance_started_at = None;
        self.schedule = Schedule::new(&self.config.load, self.config.max_in_flight.get(), now);
    }

    /// Returns the preparation that must precede the next iteration, if there is one. `begins_episode` is `true` if the
    /// next iteration is the first of an episode.
    pub(super) fn due_preparation(&self, begins_episode: bool) -> Option<Preparation> {
        if begins_episode && self.needs_resets {
            return (!self.is_reset).then_some(Preparation::Reset);
        }
        self.pending_advance.map(Preparation::Advance)
    }

    /// Adds the duration of an iteration to the time by which the simulation is advanced before the next sample.
    pub(super) fn extend_pending_advance(&mut self, duration: Span) {
        if self.needs_advances {
            self.pending_advance = Some(self.pending_advance.unwrap_or(Span::ZERO) + duration);
        }
    }

    /// Starts a preparation. The caller must do so only while no sample is requested, because the sensor handles one
    /// request at a time.
    pub(super) fn start_preparation(&mut self, preparation: Preparation, now: MonoTime) {
        if matches!(preparation, Preparation::Advance(_)) {
            // The latency of an iteration counts from its intended start. With a start that is due already, the latency
            // would contain time by which the simulation is advanced now, so these starts are skipped.
            self.schedule.skip_due(now);
            self.advance_started_at = Some(now);
        }
        // `Preparation::Advance` contains the pending time. A reset begins a new simulation, in which the time of
        // earlier iterations does not pass.
        self.pending_advance = None;
        let actuator = self.actuator.clone().filter(ActuatorExecutor::needs_resets);
        let sensor = self.sensor.preparation_sender();
        self.pending_preparation = Some(preparation::prepare(preparation, actuator, sensor));
    }

    /// Continues the schedule after a preparation that ended at `now`. The duration of the preparation belongs to no
    /// iteration.
    pub(super) fn resume_schedule(&mut self, now: MonoTime) {
        match self.advance_started_at.take() {
            // The intervals between the iterations of an episode are as if the advance had taken no time.
            Some(started_at) => self.schedule.postpone(now - started_at),
            None => self.schedule.resume_at(now),
        }
    }

    /// Skips and counts the starts that came due without a connection, except the newest, which still wait.
    pub(super) fn skip_missed_starts(&mut self, now: MonoTime) {
        if self.pending_preparation.is_some() {
            // The preparation may have ended long before the connection is open again. The schedule then restarts: if
            // it were postponed by the time until then, the starts would pause for as long once more.
            self.advance_started_at = None;
            self.schedule.skip_due(now);
        } else {
            self.schedule.catch_up(now);
        }
    }

    /// Returns the facts about sensor, transforms, load and actuator, then `model_facts`.
    pub(super) fn facts(&self, model_facts: Vec<(String, String)>) -> Vec<(String, String)> {
        self.facts.iter().cloned().chain(model_facts).collect()
    }

    /// Returns the maximum number of iterations in flight: one in a closed loop.
    pub(super) fn max_in_flight(&self) -> usize {
        if self.schedule.is_closed() { 1 } else { self.config.max_in_flight.get() }
    }

    /// Ends the sensor, and waits for a limited time until it has released its port or its device.
    pub(super) async fn close(self) {
        let Self { config, sensor, pending_preparation, .. } = self;
        // A preparation that waits for the actuator's reset can still send a request to the sensor's thread. The thread
        // ends only when nothing can send a request.
        drop(pending_preparation);
        sensor.close(&config.name).await;
    }

    /// Returns whether a sample may be taken while an iteration is in flight. With a simulation it may not, because the
    /// simulation has to be advanced by the duration of that iteration first.
    pub(super) fn iterations_may_overlap(&self) -> bool {
        !self.schedule.is_closed() && !self.needs_advances
    }
}

fn transforms_text(transforms: &[Box<dyn Transform>]) -> String {
    transforms.iter().map(|transform| transform.describe()).collect::<Vec<_>>().join(", ")
}
