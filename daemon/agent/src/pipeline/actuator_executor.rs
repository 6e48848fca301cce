//! Runs the actuator of a pipeline, inline or on a thread.

use std::sync::Arc;

use peernet_actuators::{Action, Actuator, ActuatorConfig, ActuatorError, ActuatorKind, Feedback};
use peernet_analysis::actuator_results::{EPISODE_ENDED, SUCCESS, SUPERSEDED};
use peernet_clock::SharedClock;
use peernet_logger::{Name, Recorder, RunId, Unit, stage};
use peernet_sample::Sample;
use tokio::sync::Mutex;
use tokio::task::{JoinError, spawn_blocking};

use super::progress::Position;

/// Name of the reward that the actuator reported for an action.
const REWARD: Name = Name::from_static("reward");

/// Reason why an actuator did not act on an answer, or was not reset.
#[derive(Debug, thiserror::Error)]
pub(super) enum ActError {
    /// The actuator returned an error.
    #[error(transparent)]
    Actuator(#[from] ActuatorError),
    /// The actuator panicked.
    #[error("the actuator panicked: {0}")]
    Panicked(#[from] JoinError),
}

/// Sample whose answer the actuator acts on.
#[derive(Clone, Copy, Debug)]
pub(super) struct AnsweredSample<'a> {
    pub(super) run: RunId,
    pub(super) position: Position,
    /// Origin of the sample, such as the name of a file.
    pub(super) source: &'a str,
}

/// Runs a pipeline's actuator on one answer at a time, in the order of the samples.
#[derive(Clone)]
pub(super) struct ActuatorExecutor {
    // The lock is held during the action, which may take long, so waiting for the lock must not block a thread of
    // tokio.
    ordered_actuator: Arc<Mutex<OrderedActuator>>,
    /// `true` if the actuator may block. It then runs on a separate thread, so that it delays no iteration in flight.
    blocks: bool,
    /// `true` if the actuator has to be reset before each episode.
    needs_resets: bool,
    /// Facts about the actuator that are known only after it was opened.
    facts: Arc<[(String, String)]>,
}

/// An actuator that acts on answers only in the order of their samples.
struct OrderedActuator {
    actuator: Box<dyn Actuator>,
    /// Run and number of the iteration whose answer the actuator acted on last.
    last_acted: Option<(RunId, u64)>,
    /// Run and number of the last episode whose end the actuator reported.
    ended_episode: Option<(RunId, u32)>,
}

impl ActuatorExecutor {
    /// Opens the actuator. `None` if the pipeline has no actuator; its iterations then have no node `actuation`.
    ///
    /// # Errors
    /// When the actuator cannot be set up.
    pub(super) fn new(config: &ActuatorConfig, clock: &SharedClock) -> Result<Option<Self>, ActuatorError> {
        if !config.acts() {
            return Ok(None);
        }
        let actuator = config.build(clock)?;
        let (blocks, needs_resets, facts) = (actuator.blocks(), actuator.resets(), actuator.facts().into());
        let ordered_actuator = OrderedActuator { actuator, last_acted: None, ended_episode: None };
        Ok(Some(Self {
            ordered_actuator: Arc::new(Mutex::new(ordered_actuator)),
            blocks,
            needs_resets,
            facts,
        }))
    }

    /// Returns facts about the actuator that are known only after it was opened.
    pub(super) fn facts(&self) -> &[(String, String)] {
        &self.facts
    }

    /// Returns whether the actuator has to be reset before each episode.
    pub(super) fn needs_resets(&self) -> bool {
        self.needs_resets
    }

    /// Acts on an answer, and records `actuation` and the feedback. If the answer is superseded, does not act but
    /// records the value `superseded`.
    pub(super) async fn act(
        &self,
        mut log: Recorder,
        answered: AnsweredSample<'_>,
        answer: &Sample,
    ) -> (Recorder, Result<Feedback, ActError>) {
        // The guard is owned, because it moves into the thread below.
        let mut ordered_actuator = Arc::clone(&self.ordered_actuator).lock_owned().await;
        if !ordered_actuator.accepts(&answered) {
            log.record_value(Name::from_static(SUPERSEDED), 1.0, Unit::NONE);
            return (log, Ok(Feedback::default()));
        }
        if !self.blocks {
            let feedback = ordered_actuator.act(&mut log, answered, answer);
            return (log, feedback.map_err(ActError::from));
        }
        // If the thread panics, its recorder is lost. This copy has the nodes that were recorded before.
        let log_backup = log.clone();
        let (run, position) = (answered.run, answered.position);
        let (source, answer) = (answered.source.to_owned(), answer.clone());
        let thread_result = spawn_blocking(move || {
            let feedback =
                ordered_actuator.act(&mut log, AnsweredSample { run, position, source: &source }, &answer);
            (log, feedback.map_err(ActError::from))
        });
        thread_result.await.unwrap_or_else(|panic| (log_backup, Err(panic.into())))
    }

    /// Resets the actuator for an episode.
    pub(super) async fn reset(&self) -> Result<(), ActError> {
        let mut ordered_actuator = Arc::clone(&self.ordered_actuator).lock_owned().await;
        if !self.blocks {
            return Ok(ordered_actuator.actuator.reset()?);
        }
        Ok(spawn_blocking(move || ordered_actuator.actuator.reset()).await??)
    }
}

impl OrderedActuator {
    /// Returns whether the actuator may act on an answer. It must not act on the answer to an older sample after the
    /// answer to a newer sample, and must not continue an episode that has ended.
    fn accepts(&self, answered: &AnsweredSample<'_>) -> bool {
        let Position { number, episode, .. } = answered.position;
        let is_older =
            self.last_acted.is_some_and(|(run, last_number)| run == answered.run && number < last_number);
        !is_older && self.ended_episode != Some((answered.run, episode))
    }

    /// Acts on an answer, and records `actuation` and the feedback.
    fn act(
        &mut self,
        log: &mut Recorder,
        answered: AnsweredSample<'_>,
        answer: &Sample,
    ) -> Result<Feedback, ActuatorError> {
        let AnsweredSample { run, position: Position { number, episode, step, .. }, source } = answered;
        // The field is set before the action, because a failed action may have been carried out in part.
        self.last_acted = Some((run, number));
        let action = Action { answer, source, iteration: number, episode, step };
        let feedback = self.actuator.act(action, &mut log.time(stage::ACTUATION))?;
        if feedback.episode_ended {
            self.ended_episode = Some((run, episode));
        }
        record_feedback(log, &feedback);
        Ok(feedback)
    }
}

fn record_feedback(log: &mut Recorder, feedback: &Feedback) {
    if let Some(reward) = feedback.reward {
        log.record_value(REWARD, reward, Unit::NONE);
    }
    if let Some(success) = feedback.success {
        log.record_value(Name::from_static(SUCCESS), if success { 1.0 } else { 0.0 }, Unit::NONE);
    }
    if feedback.episode_ended {
        log.record_value(Name::from_static(EPISODE_ENDED), 1.0, Unit::NONE);
    }
}
