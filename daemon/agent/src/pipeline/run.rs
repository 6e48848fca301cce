//! A run in progress: its description, its progress and its events.

use peernet_actuators::Feedback;
use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::{RunId, Slug, Tree};
use peernet_stream::{Condition, EndReason, Event, Iteration, Outcome, Placement, RunDescription, RunEnded};

use super::context::PipelineContext;
use super::deadline;
use super::episode_scores::{EpisodeResult, EpisodeScores};
use super::failure_log::FailureLog;
use super::pipeline_loop::LoopEnd;
use super::progress::{Position, Progress};
use crate::config::PipelineConfig;
use crate::incidents::remark;
use crate::live::PipelineLiveState;

const SECONDS_PER_DAY: i64 = 86_400;

/// A run in progress.
#[derive(Debug)]
pub(super) struct Run {
    id: RunId,
    pipeline: Slug,
    /// Day on which the run started, in days since the Unix epoch; `None` if the run does not end at midnight.
    start_day: Option<i64>,
    placement: Placement,
    deadline: Option<Span>,
    progress: Progress,
    failures: FailureLog,
    scores: EpisodeScores,
    /// Episode whose end the actuator has reported; `None` once the next episode may begin.
    ended_episode: Option<u32>,
}

impl Run {
    /// Starts a run and reports its start. `is_continuation` is `true` if it directly continues another run.
    pub(super) fn start(
        config: &PipelineConfig,
        placement: Placement,
        (mut facts, conditions): (Vec<(String, String)>, Vec<Condition>),
        is_continuation: bool,
        context: &PipelineContext,
        live_state: &PipelineLiveState,
    ) -> Self {
        let id = RunId::random();
        facts.extend(config.deadline_ms.map(|deadline| ("Deadline".to_owned(), format!("{deadline} ms"))));
        let started = context.host.clock.wall();
        let description = RunDescription {
            run: id,
            pipeline: config.name.clone(),
            started,
            placement: placement.clone(),
            facts,
            configuration: configuration(config),
            version: context.host.version.to_owned(),
            experiment: config.experiment.clone().map(Box::new),
            conditions,
        };
        context.events.runs.record_start(description.clone());
        context.events.event_queue.push_event(Some(&config.name), Event::RunStarted(description));
        live_state.set_run(id);
        Self {
            id,
            pipeline: config.name.clone(),
            // A run with a limit does not end at midnight, so that a measurement over midnight is one run.
            start_day: config.limit.is_none().then(|| day_number(started)),
            placement,
            deadline: config.deadline().map(Span::from),
            progress: Progress::new(config, is_continuation),
            failures: FailureLog::default(),
            scores: EpisodeScores::default(),
            ended_episode: None,
        }
    }

    pub(super) const fn id(&self) -> RunId {
        self.id
    }

    /// Returns whether the run computes at this placement.
    pub(super) fn has_placement(&self, placement: &Placement) -> bool {
        self.placement == *placement
    }

    /// Returns whether an iteration with this intended start would exceed the run's limit.
    pub(super) fn is_limit_reached(&self, intended: MonoTime) -> bool {
        self.progress.is_limit_reached(intended)
    }

    /// Returns whether the run ends at midnight (UTC), and midnight has passed since its start.
    pub(super) fn is_from_previous_day(&self, now: WallTime) -> bool {
        self.start_day.is_some_and(|start_day| day_number(now) > start_day)
    }

    /// Assigns number, episode and step to the next iteration.
    pub(super) fn assign_position(&mut self, intended: MonoTime) -> Position {
        let is_after_warm_up = !self.progress.next_is_run_warm_up();
        let position = self.progress.assign_position(intended);
        if position.step == 0 {
            self.scores.begin(position.episode, is_after_warm_up);
        }
        position
    }

    /// Assigns number, episode and step to an iteration whose preparation failed.
    pub(super) fn assign_unprepared_position(&mut self, intended: MonoTime) -> Position {
        let is_after_warm_up = !self.progress.next_is_run_warm_up();
        let position = self.progress.assign_unprepared_position(intended);
        if position.step == 0 {
            self.scores.begin_unprepared(position.episode, is_after_warm_up);
        }
        position
    }

    /// Returns whether the next iteration is the first of its episode.
    pub(super) const fn begins_episode(&self) -> bool {
        self.progress.begins_episode()
    }

    /// Ends the episode whose end the actuator has reported, if there is one.
    pub(super) fn end_reported_episode(&mut self) {
        if let Some(episode) = self.ended_episode.take() {
            self.progress.end_episode(episode);
        }
    }

    /// Adds the feedback on an iteration. Returns the result of the iteration's episode if the episode ends with this
    /// iteration: because of the feedback, or because all iterations of the episode are complete. `has_pending` is
    /// `true` while other iterations of the episode are not complete.
    pub(super) fn add_feedback(
        &mut self,
        episode: u32,
        feedback: &Feedback,
        has_pending: bool,
    ) -> Option<EpisodeResult> {
        self.scores.add(episode, feedback);
        if feedback.episode_ended {
            self.ended_episode = Some(episode);
        }
        let is_over = feedback.episode_ended || self.progress.has_passed_episode(episode) && !has_pending;
        let result = is_over.then(|| self.scores.close(episode)).flatten()?;
        if let Some(text) = result.remark(&self.pipeline, episode) {
            remark(&text);
        }
        Some(result)
    }

    /// Returns the planned number of iterations of a run whose loop ended for `reason`. `None` if the run was stopped,
    /// or if it lost its peer, to which it cannot send the number.
    pub(super) fn planned_iterations(&self, reason: &LoopEnd) -> Option<u64> {
        match reason {
            // No further iteration starts, so the number of iterations so far is the planned number.
            LoopEnd::Limit | LoopEnd::Midnight => Some(self.progress.started_iterations()),
            LoopEnd::NoMoreSamples | LoopEnd::Broken(_) => Some(self.progress.planned_iterations()),
            LoopEnd::Stopped | LoopEnd::Disconnected(_) => None,
        }
    }

    /// Passes a completed iteration to the live statistics and to the event queue.
    pub(super) fn record(
        &mut self,
        position: Position,
        outcome: Outcome,
        mut tree: Tree,
        ended: Stamp,
        context: &PipelineContext,
        live_state: &PipelineLiveState,
    ) {
        if let Some(deadline) = self.deadline {
            deadline::record_deadline(&mut tree, &outcome, deadline);
        }
        let Position { number, episode, step, warm_up } = position;
        live_state.record(ended.wall.unix_seconds(), &outcome, warm_up, &tree);
        for line in self.failures.record(number, &outcome, ended.mono) {
            tracing::warn!(pipeline = %self.pipeline, "{line}");
        }
        let iteration = Iteration { run: self.id, number, episode, step, warm_up, outcome, tree };
        context.events.event_queue.push_iteration(&self.pipeline, iteration);
    }

    /// Reports the end of the run.
    pub(super) fn end(&mut self, reason: EndReason, context: &PipelineContext) {
        for line in self.failures.take_remaining(context.host.clock.mono()) {
            tracing::warn!(pipeline = %self.pipeline, "{line}");
        }
        end(&self.pipeline, self.id, reason, context);
    }
}

/// Reports the end of the pipeline's run in progress, if there is one, after a panic dropped its [`Run`].
pub(super) fn end_orphaned_run(pipeline: &Slug, reason: EndReason, context: &PipelineContext) {
    if let Some(run) = context.events.runs.current_run(pipeline) {
        end(pipeline, run, reason, context);
    }
}

/// Reports the end of a run.
fn end(pipeline: &Slug, run: RunId, reason: EndReason, context: &PipelineContext) {
    let ended = RunEnded { run, ended: context.host.clock.wall(), reason };
    // Recorded before the event is queued, so that the outbox does not send the start of the run again after its end.
    context.events.runs.record_end(pipeline, run);
    context.events.event_queue.push_event(Some(pipeline), Event::RunEnded(ended));
}

/// Returns the number of days since the Unix epoch.
fn day_number(at: WallTime) -> i64 {
    at.unix_seconds().div_euclid(SECONDS_PER_DAY)
}

/// Returns the pipeline's table as TOML, without values that may be secret.
fn configuration(config: &PipelineConfig) -> String {
    toml::to_string(&config.redacted())
        .unwrap_or_else(|error| format!("# cannot be written as TOML: {error}\n"))
}
