//! One run: its description, its numbers, its events.

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::{RunId, Slug, Tree};
use peernet_stream::{
    Condition, EndReason, Event, Iteration, Outcome, Placement as Description, RunDescription, RunEnded,
};

use super::context::PipelineContext;
use super::deadline;
use super::failure_log::FailureLog;
use super::pipeline_loop::LoopEnd;
use super::progress::{Position, Progress};
use crate::config::PipelineConfig;
use crate::live::Display;

const SECONDS_PER_DAY: i64 = 86_400;

/// A run under way.
#[derive(Debug)]
pub(super) struct Run {
    id: RunId,
    pipeline: Slug,
    /// Days since the Unix epoch at its start; `None` when midnight does not concern it.
    day: Option<i64>,
    placement: Description,
    deadline: Option<Span>,
    progress: Progress,
    failures: FailureLog,
}

impl Run {
    /// Begins a run and reports it. `warm` when it directly continues another.
    pub(super) fn begin(
        config: &PipelineConfig,
        placement: Description,
        (mut facts, conditions): (Vec<(String, String)>, Vec<Condition>),
        warm: bool,
        context: &PipelineContext,
        display: &Display,
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
        context.events.runs.began(description.clone());
        context.events.event_queue.event(Some(&config.name), Event::RunStarted(description));
        display.set_run(id);
        Self {
            id,
            pipeline: config.name.clone(),
            day: config.limit.is_none().then(|| day(started)),
            placement,
            deadline: config.deadline().map(Span::from),
            progress: Progress::new(config, warm),
            failures: FailureLog::default(),
        }
    }

    pub(super) const fn id(&self) -> RunId {
        self.id
    }

    /// Whether the run describes a pipeline that computes there.
    pub(super) fn is_at(&self, placement: &Description) -> bool {
        self.placement == *placement
    }

    /// Whether an iteration that is meant to begin at `intended` is beyond the limit.
    pub(super) fn is_over(&self, intended: MonoTime) -> bool {
        self.progress.is_over(intended)
    }

    /// Whether midnight (UTC) has passed since the start and the run is one of those that end there.
    pub(super) fn is_from_previous_day(&self, now: WallTime) -> bool {
        self.day.is_some_and(|started| day(now) > started)
    }

    /// Gives the next iteration its place.
    pub(super) fn place(&mut self, intended: MonoTime) -> Position {
        self.progress.place(intended)
    }

    /// How many iterations it was to have, once that is settled: one that was stopped or lost its peer may go on.
    pub(super) fn planned_iterations(&self, ended: &LoopEnd) -> Option<u64> {
        match ended {
            LoopEnd::Limit | LoopEnd::Midnight => Some(self.progress.given()),
            LoopEnd::NoMoreSamples | LoopEnd::Broken(_) => Some(self.progress.planned_iterations()),
            LoopEnd::Stopped | LoopEnd::Disconnected(_) => None,
        }
    }

    /// Hands a finished iteration to the live statistics and to the outbox.
    pub(super) fn record(
        &mut self,
        position: Position,
        outcome: Outcome,
        mut tree: Tree,
        ended: Stamp,
        context: &PipelineContext,
        display: &Display,
    ) {
        if let Some(deadline) = self.deadline {
            deadline::judge(&mut tree, &outcome, deadline);
        }
        if !position.warm_up {
            display.record(ended.wall.unix_seconds(), &outcome, &tree);
        }
        let Position { number, episode, step, warm_up } = position;
        for line in self.failures.record(number, &outcome, ended.mono) {
            tracing::warn!(pipeline = %self.pipeline, "{line}");
        }
        let iteration = Iteration { run: self.id, number, episode, step, warm_up, outcome, tree };
        context.events.event_queue.iteration(&self.pipeline, iteration);
    }

    /// Reports the end.
    pub(super) fn end(&mut self, reason: EndReason, context: &PipelineContext) {
        for line in self.failures.finish(context.host.clock.mono()) {
            tracing::warn!(pipeline = %self.pipeline, "{line}");
        }
        end(&self.pipeline, self.id, reason, context);
    }
}

/// Reports the end of a run that nobody holds any more, if the pipeline has one.
pub(super) fn end_orphan(pipeline: &Slug, reason: EndReason, context: &PipelineContext) {
    if let Some(run) = context.events.runs.current(pipeline) {
        end(pipeline, run, reason, context);
    }
}

fn end(pipeline: &Slug, run: RunId, reason: EndReason, context: &PipelineContext) {
    let ended = RunEnded { run, ended: context.host.clock.wall(), reason };
    context.events.runs.ended(pipeline, run);
    context.events.event_queue.event(Some(pipeline), Event::RunEnded(ended));
}

fn day(at: WallTime) -> i64 {
    at.unix_seconds().div_euclid(SECONDS_PER_DAY)
}

/// The pipeline's table, as it could stand in a configuration file, without what may be secret.
fn configuration(config: &PipelineConfig) -> String {
    toml::to_string(&config.publishable())
        .unwrap_or_else(|error| format!("# cannot be written down: {error}\n"))
}
