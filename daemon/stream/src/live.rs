//! What the live lane carries: everything in it is a state, not a change, so that a lost update harms nothing.

use peernet_clock::WallTime;
use peernet_statistics::Summary;
use serde::{Deserialize, Serialize};

use super::bounded::at_most;
use super::{HostClock, HostMetrics, LinkLive};
use crate::limits::MAX_LINKS;
use peernet_logger::{HostId, Name, RunId, Slug};

/// Sent every 250 ms while the connection is up, never queued behind older ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveUpdate {
    /// Whose.
    pub host: HostId,
    /// The agent's wall clock when it was made.
    pub sent: WallTime,
    /// Every pipeline of the agent.
    pub pipelines: Vec<PipelineLive>,
    /// Every cloud and network that the agent has to do with, at most [`MAX_LINKS`].
    #[serde(deserialize_with = "at_most::<MAX_LINKS, _, _>")]
    pub links: Vec<LinkLive>,
    /// The host's own clock.
    pub clock: HostClock,
    /// How the host fares.
    pub metrics: HostMetrics,
    /// What became of the agent's events.
    pub accounting: Accounting,
}

/// One pipeline, now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PipelineLive {
    /// Name on its host.
    pub pipeline: Slug,
    /// What it does at the moment.
    pub state: PipelineState,
    /// The current or last run; `None` before the first.
    pub run: Option<RunId>,
    /// Where it computes.
    pub placement: Placement,
    /// The intended load in words: `closed`, `5 Hz`.
    pub load: String,
    /// The seconds that changed since the last update, newest first, each complete up to now: a receiver
    /// replaces what it has of that second.
    pub seconds: Vec<Second>,
}

/// What a pipeline does at the moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PipelineState {
    /// Preparing its sensor and model.
    Starting,
    /// Waiting for its peer; the text says for what.
    Waiting(String),
    /// Measuring.
    Running,
    /// Reached its limit, or was stopped with its agent.
    Finished,
    /// Could not start or had to stop; the text says why.
    Failed(String),
    /// Its host is not connected: what it does is not known. Said by the aggregator, never by an agent.
    Away,
}

impl PipelineState {
    /// The word for it in the API and on the pages.
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

    /// Why it waits or failed.
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Waiting(reason) | Self::Failed(reason) => Some(reason),
            Self::Starting | Self::Running | Self::Finished | Self::Away => None,
        }
    }
}

/// Where a pipeline computes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Placement {
    /// Here or there.
    pub kind: PlacementKind,
    /// The serving host's name once known, for a remote placement.
    pub peer: Option<Slug>,
    /// Kind of network, such as `zmq-tcp`, for a remote placement.
    pub network: Option<String>,
    /// Address of the peer, for a remote placement.
    pub address: Option<String>,
    /// The model's name; `none` for a sensor alone.
    pub model: Slug,
    /// The device it runs on, once known.
    pub device: Option<String>,
}

impl Placement {
    /// A sensor alone: there is neither peer nor model.
    pub fn sensor_alone() -> Self {
        let (peer, network, address, device) = (None, None, None, None);
        Self { kind: PlacementKind::None, peer, network, address, model: Slug::none(), device }
    }

    /// Nodes of another system that are observed: what computes there is no model of this program.
    pub fn observed() -> Self {
        Self { kind: PlacementKind::Local, model: Slug::observed(), ..Self::sensor_alone() }
    }
}

/// Here, there or nowhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlacementKind {
    /// On the edge itself.
    Local,
    /// On a cloud over a network.
    Remote,
    /// Nowhere: a sensor alone.
    None,
}

impl PlacementKind {
    /// The word for it in storage, in results and in the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Local => "local",
            Self::Remote => "remote",
            Self::None => "none",
        }
    }
}

/// What happened within one second of the edge's wall clock, by the iterations' ends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Second {
    /// Seconds since the Unix epoch.
    pub at: i64,
    /// Iterations by outcome, warm-up left out.
    pub counts: OutcomeCounts,
    /// Summaries by node name: the stages, `total`, `unattributed`, throughputs and sizes, in SI units; those of
    /// throughputs are of the ratios of single iterations;
    /// successful iterations only, warm-up left out.
    pub values: Vec<(Name, Summary)>,
    /// Half-widths of the clock bound of `upload` and `download` in seconds, and how often each verdict was
    /// given: (`upload` | `download`, verdict, count).
    pub bounds: Vec<(Name, Summary)>,
    /// Verdicts of the one-way delays: node, verdict's name, count.
    pub verdicts: Vec<(Name, Name, u64)>,
}

/// Iterations by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutcomeCounts {
    /// With an answer.
    pub ok: u64,
    /// The sample or the model failed.
    pub failed: u64,
    /// The connection broke.
    pub lost: u64,
    /// No answer in time.
    pub timeout: u64,
}

/// What became of an agent's events since its spool was made. `produced = stored + waiting + dropped` at any time.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Accounting {
    /// Events that were handed in; gaps that are reported count as events of their own.
    pub produced: u64,
    /// Of those, written to the spool, or stored without it while its disk failed.
    pub spooled: u64,
    /// Of those, sent at least once.
    pub sent: u64,
    /// Acknowledged as stored.
    pub stored: u64,
    /// Waiting on the agent, in memory or in the spool.
    pub waiting: u64,
    /// Dropped for want of room or lost when the agent was killed, and counted in gaps.
    pub dropped: u64,
    /// Gaps that were reported.
    pub gaps: u64,
    /// Bytes of the batches in the spool.
    pub spool_bytes: u64,
    /// Bytes that the spool may take.
    pub spool_limit_bytes: u64,
    /// Bytes of events in memory that are not in the spool yet.
    pub memory_bytes: u64,
    /// When the oldest event that waits came, on the agent's wall clock: storing is so far behind measuring.
    pub oldest: Option<WallTime>,
    /// Batches carry their events compressed: that is configured, or they wait for acknowledgements, because of a slow
    /// link or a slow store.
    pub compressed: bool,
    /// Why the spool cannot be written or read, in words; events wait in memory meanwhile.
    pub trouble: Option<String>,
}

impl OutcomeCounts {
    /// All iterations.
    pub const fn total(&self) -> u64 {
        self.ok + self.failed + self.lost + self.timeout
    }

    /// Adds the counts of another.
    pub const fn merge(&mut self, other: &Self) {
        self.ok += other.ok;
        self.failed += other.failed;
        self.lost += other.lost;
        self.timeout += other.timeout;
    }
}
