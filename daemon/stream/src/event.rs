//! Events that an agent sends over the durable lane to be stored.

use std::fmt;

use peernet_clock::WallTime;
use serde::{Deserialize, Serialize};

use super::clock::ClockSample;
use super::end_reason::EndReason;
use super::experiment::{Condition, ExperimentPosition};
use super::live::Placement;
use peernet_logger::{HostId, RunId, Slug, Tree};

/// An event on an agent that is to be stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// A run started.
    RunStarted(RunDescription),
    /// A run ended.
    RunEnded(RunEnded),
    /// An iteration ended, successfully or not.
    Iteration(Iteration),
    /// An incident: something that happened in addition to the measurements.
    Incident(Incident),
    /// Events were dropped.
    Gap(Gap),
    /// One second of the relation between this host's clock and a cloud's.
    Clock(Box<ClockSample>),
}

/// Run and host that an event states as its origin. A host may send only events of itself and of its own runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventOrigin {
    /// Run that the event belongs to, if any.
    pub run: Option<RunId>,
    /// Host that recorded the event, if the event names this host.
    pub reporter: Option<HostId>,
}

impl Event {
    /// Returns the run and the host that the event states as its origin. Before the aggregator stores a batch, it
    /// compares the origin of each event in the batch with the host that sent the batch.
    pub fn origin(&self) -> EventOrigin {
        // The `match` has no `_`, so that a new kind of event cannot skip the check.
        match self {
            Self::RunStarted(run) => EventOrigin { run: Some(run.run), reporter: None },
            Self::RunEnded(end) => EventOrigin { run: Some(end.run), reporter: None },
            Self::Iteration(iteration) => {
                // The tree may contain other hosts: the edge reports the cloud's part.
                let edge = iteration.tree.anchors().first().map(|anchor| anchor.host);
                EventOrigin { run: Some(iteration.run), reporter: edge }
            }
            Self::Incident(incident) => EventOrigin { run: incident.run, reporter: None },
            Self::Gap(gap) => EventOrigin { run: gap.run, reporter: None },
            // A clock sample does not name its edge: the edge is the host that sends the sample.
            Self::Clock(_) => EventOrigin { run: None, reporter: None },
        }
    }
}

/// Description of a run, sent when it begins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunDescription {
    /// Id of the run.
    pub run: RunId,
    /// Name of the pipeline on its host.
    pub pipeline: Slug,
    /// Start on the edge's wall clock.
    pub started: WallTime,
    /// Placement of the computation.
    pub placement: Placement,
    /// Sensor, transforms, load and so on, as pairs for people, in the order of the configuration.
    pub facts: Vec<(String, String)>,
    /// Table of the pipeline in the configuration file, so that the run can be repeated.
    pub configuration: String,
    /// Version of the agent.
    pub version: String,
    /// Place of the run in an experiment, if it belongs to one.
    pub experiment: Option<Box<ExperimentPosition>>,
    /// Findings about the hosts before the run.
    pub conditions: Vec<Condition>,
}

/// End of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunEnded {
    /// Id of the run.
    pub run: RunId,
    /// End on the edge's wall clock.
    pub ended: WallTime,
    /// Reason of the end.
    pub reason: EndReason,
}

/// One iteration and its tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Iteration {
    /// Run that the iteration belongs to.
    pub run: RunId,
    /// Number within the run, contiguous from 1.
    pub number: u64,
    /// Episode, from 0.
    pub episode: u32,
    /// Step within the episode, from 0.
    pub step: u32,
    /// `true` for a warm-up iteration, which is stored but not included in statistics.
    pub warm_up: bool,
    /// Outcome of the iteration.
    pub outcome: Outcome,
    /// Measurements of the iteration.
    pub tree: Tree,
}

/// Outcome of an iteration.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(from = "WireOutcome", into = "WireOutcome")]
pub enum Outcome {
    /// An answer arrived.
    Ok,
    /// The sample or the model failed; the text is the error.
    Failed(String),
    /// The answer will never arrive, because the connection ended; the text gives details.
    Lost(String),
    /// The answer did not arrive in time; the text states what was waited for, how long, and what to do. Agents before
    /// 0.3.0 send no text.
    Timeout(String),
}

/// Wire form of an [`Outcome`].
#[derive(Serialize, Deserialize)]
enum WireOutcome {
    Ok,
    Failed(String),
    Lost(String),
    /// Form of agents before 0.3.0, and of a timeout without a reason.
    Timeout,
    /// Since version 7 of the event stream.
    TimedOut(String),
}

impl From<WireOutcome> for Outcome {
    fn from(outcome: WireOutcome) -> Self {
        match outcome {
            WireOutcome::Ok => Self::Ok,
            WireOutcome::Failed(reason) => Self::Failed(reason),
            WireOutcome::Lost(reason) => Self::Lost(reason),
            WireOutcome::Timeout => Self::Timeout(String::new()),
            WireOutcome::TimedOut(reason) => Self::Timeout(reason),
        }
    }
}

impl From<Outcome> for WireOutcome {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Ok => Self::Ok,
            Outcome::Failed(reason) => Self::Failed(reason),
            Outcome::Lost(reason) => Self::Lost(reason),
            Outcome::Timeout(reason) if reason.is_empty() => Self::Timeout,
            Outcome::Timeout(reason) => Self::TimedOut(reason),
        }
    }
}

impl Outcome {
    /// Returns `ok`, `failed`, `lost` or `timeout`.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Failed(_) => "failed",
            Self::Lost(_) => "lost",
            Self::Timeout(_) => "timeout",
        }
    }

    /// Returns the text of the outcome, if it has one.
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Failed(reason) | Self::Lost(reason) => Some(reason),
            Self::Timeout(reason) => Some(reason.as_str()).filter(|reason| !reason.is_empty()),
            Self::Ok => None,
        }
    }
}

/// An incident: something that happened in addition to the measurements.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Incident {
    /// Time on the reporting host's wall clock.
    pub at: WallTime,
    /// Kind of the incident.
    pub kind: IncidentKind,
    /// Pipeline concerned, if any.
    pub pipeline: Option<Slug>,
    /// Run concerned, if any.
    pub run: Option<RunId>,
    /// Other host concerned, if any.
    pub peer: Option<HostId>,
    /// Description for people, one sentence.
    pub text: String,
}

/// Kinds of incidents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IncidentKind {
    /// A link was lost.
    Disconnected,
    /// A link was established, or established again.
    Connected,
    /// A peer refused a session.
    Refused,
    /// A model was loaded.
    ModelLoaded,
    /// A model was unloaded. Since version 7 of the event stream.
    ModelUnloaded,
    /// A clock was stepped, slewed or interrupted.
    ClockStep,
    /// Events were dropped.
    Gap,
    /// A pipeline could not start, or had to stop.
    PipelineFailed,
    /// A person changed the pipelines.
    Control,
}

impl IncidentKind {
    /// Returns the name used in storage, in the API and on the pages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Disconnected => "disconnected",
            Self::Connected => "connected",
            Self::Refused => "refused",
            Self::ModelLoaded => "model-loaded",
            Self::ModelUnloaded => "model-unloaded",
            Self::ClockStep => "clock-step",
            Self::Gap => "gap",
            Self::PipelineFailed => "pipeline-failed",
            Self::Control => "control",
        }
    }
}

impl fmt::Display for IncidentKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Events that were dropped, for example because a queue was full: measuring never waits for storing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// Pipeline whose events are missing; `None` if they belong to no pipeline or to several.
    pub pipeline: Option<Slug>,
    /// Run whose events are missing; `None` if they belong to no run or to several.
    pub run: Option<RunId>,
    /// Time of the first dropped event.
    pub from: WallTime,
    /// Time of the last dropped event.
    pub to: WallTime,
    /// Number of dropped events.
    pub count: u64,
    /// Reason why the events were dropped.
    pub reason: String,
}

impl Event {
    /// Returns the run that the event belongs to.
    pub const fn run(&self) -> Option<RunId> {
        match self {
            Self::RunStarted(started) => Some(started.run),
            Self::RunEnded(ended) => Some(ended.run),
            Self::Iteration(iteration) => Some(iteration.run),
            Self::Incident(incident) => incident.run,
            Self::Gap(gap) => gap.run,
            Self::Clock(_) => None,
        }
    }
}
