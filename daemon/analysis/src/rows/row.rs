//! Row of `data.csv`: one iteration.

use std::borrow::Cow;

use peernet_clock::{Interval, OneWayDelay, Span};
use peernet_logger::{Measure, Tree, stage};
use peernet_stream as stream;
use serde::{Deserialize, Serialize};

use super::columns;

/// Name of a column. The name of a standard column is not allocated.
pub type Column = Cow<'static, str>;

/// One iteration. The units are seconds, bytes and bits per second.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Number of the iteration in the run, from 1.
    pub iteration: u64,
    /// Intended start, seconds of the edge's wall clock since the Unix epoch; 0 if it was not recorded.
    pub at: f64,
    /// Episode, from 0.
    pub episode: u32,
    /// Step within the episode, from 0.
    pub step: u32,
    /// True if the iteration is warm-up. Such rows are stored, but left out of statistics.
    pub warm_up: bool,
    /// Outcome of the iteration.
    pub outcome: Outcome,
    /// Reason for a missing answer, if one was reported.
    pub reason: Option<String>,
    /// Columns and values of the measurements. First come the columns that every `data.csv` has. No value is NaN; a
    /// bound of a throughput may be infinite.
    pub values: Vec<(Column, f64)>,
    /// Delay from edge to cloud; `None` if no message was sent, or its delay was never judged.
    pub upload: Option<OneWayDelay>,
    /// Delay from cloud to edge; `None` if no message was sent, or its delay was never judged.
    pub download: Option<OneWayDelay>,
}

/// Outcome of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// The iteration ended with an answer.
    Ok,
    /// The sensor, the model or the actuator failed.
    Failed,
    /// The connection broke.
    Lost,
    /// The answer did not come in time.
    Timeout,
}

impl Outcome {
    /// Every value, in the order of declaration.
    pub const ALL: [Self; 4] = [Self::Ok, Self::Failed, Self::Lost, Self::Timeout];

    /// Returns `ok`, `failed`, `lost` or `timeout`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Failed => "failed",
            Self::Lost => "lost",
            Self::Timeout => "timeout",
        }
    }

    /// Returns the outcome as people read it: `ok`, `failed`, `lost` or `timed out`.
    pub const fn display_name(self) -> &'static str {
        match self {
            Self::Timeout => "timed out",
            outcome => outcome.name(),
        }
    }

    /// Returns the outcome with this name; `None` if no outcome has it.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|outcome| outcome.name() == name)
    }
}

impl From<&stream::Outcome> for Outcome {
    fn from(outcome: &stream::Outcome) -> Self {
        match outcome {
            stream::Outcome::Ok => Self::Ok,
            stream::Outcome::Failed(_) => Self::Failed,
            stream::Outcome::Lost(_) => Self::Lost,
            stream::Outcome::Timeout(_) => Self::Timeout,
        }
    }
}

impl Row {
    /// Returns the row of an iteration.
    pub fn from_iteration(iteration: &stream::Iteration) -> Self {
        Self::from_values(iteration, columns::values(&iteration.tree))
    }

    pub(super) fn from_values(iteration: &stream::Iteration, values: Vec<(Column, f64)>) -> Self {
        let tree = &iteration.tree;
        Self {
            iteration: iteration.number,
            // The first anchor is that of the edge, and its time is the intended start of the iteration.
            at: tree.anchors().first().map_or(0.0, |anchor| anchor.wall.unix_nanos() as f64 / 1e9),
            episode: iteration.episode,
            step: iteration.step,
            warm_up: iteration.warm_up,
            outcome: Outcome::from(&iteration.outcome),
            reason: iteration.outcome.reason().map(str::to_owned),
            values,
            upload: judged_delay(tree, &stage::UPLOAD),
            download: judged_delay(tree, &stage::DOWNLOAD),
        }
    }

    /// Returns the number in a column of `data.csv`; `None` if the cell is empty or text, or there is no such column.
    pub fn value(&self, column: &str) -> Option<f64> {
        let raw = |delay: Option<OneWayDelay>| delay.map(|delay| delay.raw.seconds());
        let bound = |delay: Option<OneWayDelay>, end_of: fn(Interval) -> Span| {
            delay?.bounds.map(|bounds| end_of(bounds).seconds())
        };
        match column {
            "iteration" => Some(self.iteration as f64),
            // An empty cell says that the start was not recorded. Other programs would read 0 as the year 1970.
            "at" => Some(self.at).filter(|at| *at != 0.0),
            "episode" => Some(f64::from(self.episode)),
            "step" => Some(f64::from(self.step)),
            "warm-up" => Some(f64::from(u8::from(self.warm_up))),
            "upload-lo" => bound(self.upload, |bounds| bounds.lo),
            "upload-hi" => bound(self.upload, |bounds| bounds.hi),
            "upload-raw" => raw(self.upload),
            "download-lo" => bound(self.download, |bounds| bounds.lo),
            "download-hi" => bound(self.download, |bounds| bounds.hi),
            "download-raw" => raw(self.download),
            _ => self.values.iter().find(|(name, _)| name == column).map(|(_, value)| *value),
        }
    }

    /// Returns whether statistics include the iteration: it succeeded and is not warm-up.
    pub fn is_in_statistics(&self) -> bool {
        self.outcome == Outcome::Ok && !self.warm_up
    }
}

/// Returns the delay of the stage `upload` or `download`; `None` if no message was sent, or its delay was never judged.
// The delay is returned even if the size of the message is not known: the messages of an observed ROS system have
// delays, but their sizes on the network are not known.
pub(crate) fn judged_delay(tree: &Tree, transit: &str) -> Option<OneWayDelay> {
    match &tree.find(&[transit])?.1.measure {
        Measure::Transit(transit) => transit.delay,
        _ => None,
    }
}
