//! Messages of the live lane. Each update contains the state itself and not a change of it, so that a lost update has
//! no lasting effect.

use peernet_clock::WallTime;
use peernet_statistics::Summary;
use serde::{Deserialize, Serialize};

use super::bounded::at_most;
use super::{HostClock, HostMetrics, LinkLive};
use crate::limits::MAX_LINKS;
use peernet_logger::{HostId, Name, RunId, Slug};

/// State of an agent, sent every 250 ms while the connection is up and never queued behind older updates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveUpdate {
    /// Host of the agent.
    pub host: HostId,
    /// Time of the agent's wall clock when the update was made.
    pub sent: WallTime,
    /// All pipelines of the agent.
    pub pipelines: Vec<PipelineLive>,
    /// All clouds and networks that the agent uses, at most [`MAX_LINKS`].
    #[serde(deserialize_with = "at_most::<MAX_LINKS, _, _>")]
    pub links: Vec<LinkLive>,
    /// Clock of the host.
    pub clock: HostClock,
    /// Load and state of the host.
    pub metrics: HostMetrics,
    /// Numbers of the agent's events by state.
    pub accounting: Accounting,
}

/// Current state of a pipeline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PipelineLive {
    /// Name of the pipeline on its host.
    pub pipeline: Slug,
    /// Current activity.
    pub state: PipelineState,
    /// Current or last run; `None` before the first run.
    pub run: Option<RunId>,
    /// Placement of the computation.
    pub placement: Placement,
    /// Configured load as text: `closed`, `5 Hz`.
    pub load: String,
    /// Seconds that changed since the last update, newest first. Each entry contains all iterations of its second so
    /// far: a receiver replaces its copy of the entry.
    pub seconds: Vec<Second>,
}

/// Current activity of a pipeline.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PipelineState {
    /// The pipeline prepares its sensor and its model.
    Starting,
    /// The pipeline waits for its peer; the text gives the reason.
    Waiting(String),
    /// The pipeline runs iterations.
    Running,
    /// The pipeline reached its limit, or was stopped together with its agent.
    Finished,
    /// The pipeline could not start or had to stop; the text gives the reason.
    Failed(String),
    /// The pipeline's host is not connected, so its activity is unknown. Only the aggregator uses this state.
    Away,
}

impl PipelineState {
    /// Returns the name used in the API and on the pages.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Waiting(_) => "waiting",
            Self::Running => "running",
            Self::Finished => "finished",
            Self::Failed(_) => "failed",
            Self::Away => "away",
        }
    }

    /// Returns the reason of a waiting or failed pipeline.
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Waiting(reason) | Self::Failed(reason) => Some(reason),
            Self::Starting | Self::Running | Self::Finished | Self::Away => None,
        }
    }
}

/// Placement of a pipeline's computation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Placement {
    /// Kind of the placement.
    pub kind: PlacementKind,
    /// Name of the serving host of a remote placement, once it is known.
    pub peer: Option<Slug>,
    /// Kind of network of a remote placement, such as `zmq-tcp`.
    pub network: Option<String>,
    /// Address of the peer of a remote placement.
    pub address: Option<String>,
    /// Name of the model; `none` for a sensor without a model.
    pub model: Slug,
    /// Device that the model runs on, once it is known.
    pub device: Option<String>,
}

impl Placement {
    /// Returns the placement of a sensor that has neither a peer nor a model.
    pub fn sensor_alone() -> Self {
        let (peer, network, address, device) = (None, None, None, None);
        Self { kind: PlacementKind::None, peer, network, address, model: Slug::none(), device }
    }

    /// Returns the placement of an observed system whose nodes run on one host. The system uses no model of this
    /// program.
    pub fn observed() -> Self {
        Self { kind: PlacementKind::Local, model: Slug::observed(), ..Self::sensor_alone() }
    }
}

/// Kinds of placement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlacementKind {
    /// On the edge itself.
    Local,
    /// On a cloud over a network.
    Remote,
    /// No computation: a sensor only.
    None,
}

impl PlacementKind {
    /// Returns the name used in storage, in results and in the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Local => "local",
            Self::Remote => "remote",
            Self::None => "none",
        }
    }
}

/// Summary of the iterations that ended within one second of the edge's wall clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Second {
    /// Seconds since the Unix epoch.
    pub at: i64,
    /// Iterations by outcome, without warm-up.
    pub counts: OutcomeCounts,
    /// Summaries in SI units, by the name of the node: the stages, `total`, `unattributed`, throughputs and sizes. A
    /// throughput's summary is over the throughputs of single iterations. Failed iterations and warm-up are not
    /// included.
    pub values: Vec<(Name, Summary)>,
    /// Clock bounds of the delays, in seconds. There are two kinds of entries: the half-widths under the names of the
    /// stages, `upload` and `download`; and the lower and upper bounds under the names that [`bound_names`] returns for
    /// each stage. Agents of earlier versions report the half-widths only.
    pub bounds: Vec<(Name, Summary)>,
    /// Verdicts of the one-way delays: node, name of the verdict, count.
    pub verdicts: Vec<(Name, Name, u64)>,
}

/// Returns the names under which [`Second::bounds`] has the lower and the upper bounds of a delay; the columns of
/// `data.csv` have the same names. `None` if the stage is not the delay of a message.
pub fn bound_names(stage: &str) -> Option<[Name; 2]> {
    match stage {
        "upload" => Some([Name::from_static("upload-lo"), Name::from_static("upload-hi")]),
        "download" => Some([Name::from_static("download-lo"), Name::from_static("download-hi")]),
        _ => None,
    }
}

/// Numbers of iterations by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutcomeCounts {
    /// Iterations with an answer.
    pub ok: u64,
    /// Iterations whose sample or model failed.
    pub failed: u64,
    /// Iterations whose connection ended.
    pub lost: u64,
    /// Iterations without an answer in time.
    pub timeout: u64,
}

/// Numbers of an agent's events since its spool was created. `produced = stored + waiting + dropped` always holds.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Accounting {
    /// Number of events that were submitted. Reported gaps count as events, too.
    pub produced: u64,
    /// Number of events that were written to the spool, or were stored without it while its disk failed.
    pub spooled: u64,
    /// Number of events that were sent at least once.
    pub sent: u64,
    /// Number of events that were acknowledged as stored.
    pub stored: u64,
    /// Number of events that the agent holds, in memory or in the spool.
    pub waiting: u64,
    /// Number of events that were dropped because no space was left, or lost when the agent was killed. Gaps report
    /// these events.
    pub dropped: u64,
    /// Number of gaps that were reported.
    pub gaps: u64,
    /// Bytes of the batches in the spool.
    pub spool_bytes: u64,
    /// Maximum number of bytes of batches in the spool.
    pub spool_limit_bytes: u64,
    /// Bytes of events in memory that are not in the spool yet.
    pub memory_bytes: u64,
    /// Time of the oldest waiting event on the agent's wall clock; its age is the storage lag.
    pub oldest: Option<WallTime>,
    /// `true` if batches are compressed: because compression is configured, or because batches wait for
    /// acknowledgements over a slow link or from a slow store.
    pub compressed: bool,
    /// Error that prevents writing or reading the spool. Events wait in memory meanwhile.
    pub trouble: Option<String>,
}

// Counts may come from another host or from a file, which can contain any number, so the sums saturate.
impl OutcomeCounts {
    /// Returns the number of all iterations.
    pub const fn total(&self) -> u64 {
        self.ok.saturating_add(self.all_failed())
    }

    /// Returns the number of iterations with any outcome but `ok`.
    pub const fn all_failed(&self) -> u64 {
        self.failed.saturating_add(self.lost).saturating_add(self.timeout)
    }

    /// Adds the counts of `other`.
    pub const fn merge(&mut self, other: &Self) {
        self.ok = self.ok.saturating_add(other.ok);
        self.failed = self.failed.saturating_add(other.failed);
        self.lost = self.lost.saturating_add(other.lost);
        self.timeout = self.timeout.saturating_add(other.timeout);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_of_implausible_counts_saturate() {
        let mut counts = OutcomeCounts { ok: 1, failed: u64::MAX, lost: 1, timeout: u64::MAX };
        assert_eq!((counts.total(), counts.all_failed()), (u64::MAX, u64::MAX));
        let other = counts;
        counts.merge(&other);
        assert_eq!(counts, OutcomeCounts { ok: 2, failed: u64::MAX, lost: 2, timeout: u64::MAX });
    }
}
