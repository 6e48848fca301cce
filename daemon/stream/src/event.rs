//! What the durable lane carries.

use std::fmt;

use peernet_clock::WallTime;
use serde::{Deserialize, Serialize};

use super::clock::ClockSample;
use super::end_reason::EndReason;
use super::experiment::{Condition, ExperimentPlace};
use super::live::Placement;
use peernet_logger::{HostId, RunId, Slug, Tree};

/// Something that happened on an agent, on its way to the store.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// A run began.
    RunStarted(RunDescription),
    /// A run ended.
    RunEnded(RunEnded),
    /// An iteration finished, well or not.
    Iteration(Iteration),
    /// Something happened beside the measurements.
    Incident(Incident),
    /// Events were dropped.
    Gap(Gap),
    /// A second of the relation between this host's clock and a cloud's.
    Clock(Box<ClockSample>),
}

/// What an event says something about. A host may speak of itself and of its own runs only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Claim {
    /// The run that it concerns, if one.
    pub run: Option<RunId>,
    /// The host that it says it was measured on, where it says so.
    pub reporter: Option<HostId>,
}

impl Event {
    /// What this event says something about. Whoever stores events checks this, and nothing else, against the host that
    /// sent them: every kind of event has to answer here.
    pub fn claim(&self) -> Claim {
        match self {
            Self::RunStarted(run) => Claim { run: Some(run.run), reporter: None },
            Self::RunEnded(end) => Claim { run: Some(end.run), reporter: None },
            Self::Iteration(iteration) => {
                // Other hosts may stand in the tree: what the cloud did is reported by the edge.
                let edge = iteration.tree.anchors().first().map(|edge| edge.host);
                Claim { run: Some(iteration.run), reporter: edge }
            }
            Self::Incident(incident) => Claim { run: incident.run, reporter: None },
            Self::Gap(gap) => Claim { run: gap.run, reporter: None },
            // Its edge is whoever sends it.
            Self::Clock(_) => Claim { run: None, reporter: None },
        }
    }
}

/// One pipeline configuration about to be executed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunDescription {
    /// The run.
    pub run: RunId,
    /// The pipeline's name on its host.
    pub pipeline: Slug,
    /// When, on the edge's wall clock.
    pub started: WallTime,
    /// Where it computes.
    pub placement: Placement,
    /// Sensor, transforms, load and so on, as pairs for people, in the order of the configuration.
    pub facts: Vec<(String, String)>,
    /// The pipeline's table of the configuration file, so that the run can be repeated.
    pub configuration: String,
    /// Version of the agent.
    pub version: String,
    /// Its place in an experiment, if it belongs to one.
    pub experiment: Option<Box<ExperimentPlace>>,
    /// What was found of the hosts before it began.
    pub conditions: Vec<Condition>,
}

/// A run is over.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunEnded {
    /// The run.
    pub run: RunId,
    /// When, on the edge's wall clock.
    pub ended: WallTime,
    /// Why.
    pub reason: EndReason,
}

/// One iteration and its tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Iteration {
    /// The run it belongs to.
    pub run: RunId,
    /// Contiguous from 1 within the run.
    pub number: u64,
    /// Episode, from 0.
    pub episode: u32,
    /// Step within the episode, from 0.
    pub step: u32,
    /// Kept, but left out of statistics.
    pub warm_up: bool,
    /// How it ended.
    pub outcome: Outcome,
    /// What was measured.
    pub tree: Tree,
}

/// How an iteration ended.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Outcome {
    /// With an answer.
    Ok,
    /// The sample or the model failed; the text says how.
    Failed(String),
    /// The answer will never come: the connection broke; the text says how.
    Lost(String),
    /// The answer did not come in time.
    Timeout,
}

impl Outcome {
    /// `ok`, `failed`, `lost` or `timeout`.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Failed(_) => "failed",
            Self::Lost(_) => "lost",
            Self::Timeout => "timeout",
        }
    }

    /// The reason, where there is one.
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Failed(reason) | Self::Lost(reason) => Some(reason),
            Self::Ok | Self::Timeout => None,
        }
    }
}

/// Something that happened beside the measurements.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Incident {
    /// When, on the reporting host's wall clock.
    pub at: WallTime,
    /// What kind of thing.
    pub kind: IncidentKind,
    /// The pipeline concerned, if one.
    pub pipeline: Option<Slug>,
    /// The run concerned, if one.
    pub run: Option<RunId>,
    /// The other host concerned, if one.
    pub peer: Option<HostId>,
    /// One sentence for people.
    pub text: String,
}

/// Kinds of incidents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IncidentKind {
    /// A link went away.
    Disconnected,
    /// A link came up, or came back.
    Connected,
    /// A peer refused a session.
    Refused,
    /// A model was loaded.
    ModelLoaded,
    /// A wall clock was stepped.
    ClockStep,
    /// Events were dropped.
    Gap,
    /// A pipeline could not start or had to stop.
    PipelineFailed,
    /// Someone changed what runs.
    Control,
}

impl IncidentKind {
    /// The name used in storage, in the API and on the pages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Disconnected => "disconnected",
            Self::Connected => "connected",
            Self::Refused => "refused",
            Self::ModelLoaded => "model-loaded",
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

/// Events that were dropped because a queue was full: measuring never waits for storing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gap {
    /// The pipeline whose events are missing; `None` for incidents.
    pub pipeline: Option<Slug>,
    /// The run, likewise.
    pub run: Option<RunId>,
    /// When the first was dropped.
    pub from: WallTime,
    /// When the last was dropped.
    pub to: WallTime,
    /// How many.
    pub count: u64,
    /// Why.
    pub reason: String,
}

impl Event {
    /// The run that it belongs to.
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
