//! The live state: the current state of all agents for readers.
//!
//! Plain data, made by the task that owns the live state (`live/`) and shared by reference count: hosts and pipelines
//! that did not change since the previous snapshot are not copied.

use std::sync::Arc;

use peernet_analysis::delays::VerdictCounts;
use peernet_analysis::transfer::Transfers;
use peernet_analysis::trust::MissingCount;
use peernet_clock::{Span, WallTime};
use peernet_logger::{HostId, Name, RunId, Slug};
use peernet_stream::{
    Accounting, HostClock, HostDescription, HostMetrics, LinkLive, OutcomeCounts, PipelineState, Placement,
};
use serde::Serialize;

use peernet_store::{ClockPoint, DelayAccuracy, QuantityStatistics, StoredCounts};

/// Snapshot of all agents.
#[derive(Clone, Debug, Serialize)]
pub struct LiveState {
    /// Time of the snapshot on the aggregator's wall clock.
    pub at: WallTime,
    /// Name of the aggregator.
    pub aggregator: Slug,
    /// Address that agents connect to, with the actual port.
    pub listening: String,
    /// Hosts that have sent a message, sorted by name. A host that has been silent for a long time is removed. A name
    /// always means the first host of that name: a connected host, otherwise the host that sent the last message.
    pub hosts: Vec<Arc<HostSnapshot>>,
    /// All pipelines, sorted in the order of `hosts`, then by name.
    pub pipelines: Vec<Arc<PipelineSnapshot>>,
    /// All links, sorted in the order of `hosts`, then by the cloud's name and the network. Of several links with one
    /// name, the link that was reported last is first.
    pub links: Vec<Arc<LinkSnapshot>>,
    /// Hosts that were refused in the last ten minutes, newest first, at most 32.
    pub refused: Vec<RefusedHost>,
    /// Number of hosts that have stored events but are not in `hosts`, because they have sent no message for a long
    /// time, or none since the aggregator's start.
    pub absent: usize,
    /// Totals of all hosts, including hosts that are not in `hosts`.
    pub totals: Totals,
}

impl LiveState {
    /// Returns the pipeline of this name on the host of this name.
    pub fn pipeline(&self, host: &str, name: &str) -> Option<&PipelineSnapshot> {
        let mut pipelines = self.pipelines.iter().map(|pipeline| &**pipeline);
        pipelines.find(|pipeline| pipeline.host_name.as_str() == host && pipeline.pipeline.as_str() == name)
    }
}

/// Totals of all hosts. They never decrease while the aggregator runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Totals {
    /// Counts of the events in the database.
    pub stored: StoredCounts,
    /// Batches that arrived and were not stored.
    #[serde(rename = "arrivals")]
    pub rejected_batches: RejectedBatches,
    /// Frames that belong to no known host.
    pub refused: RefusedFrames,
}

/// Numbers of frames from no known host, since the aggregator's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RefusedFrames {
    /// Frames that cannot be decoded.
    pub unreadable: u64,
    /// Messages and batches of hosts without a session on their connection; the aggregator asks for their hello.
    pub strangers: u64,
}

/// Numbers of batches that arrived and were not stored, since the aggregator's start; they are sent again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RejectedBatches {
    /// Batches for which the queue of batches to store had no capacity.
    pub deferred: u64,
    /// Batches that did not match their hash.
    pub damaged: u64,
}

/// Estimate of how fast storing catches up with measuring.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CatchingUp {
    /// Seconds by which the storage lag falls per second, on average over about the last 10 s.
    pub rate: f64,
    /// Events stored per second, on average over the same 10 s.
    pub events_per_second: f64,
    /// Time until the lag is zero at this rate.
    #[serde(rename = "left")]
    pub remaining: Span,
}

/// Snapshot of one link: an edge and a cloud over one network.
#[derive(Clone, Debug, Serialize)]
pub struct LinkSnapshot {
    /// Host id of the edge.
    pub edge: HostId,
    /// Name of the edge.
    pub edge_name: Slug,
    /// `true` if the edge is connected and its latest update contains the link.
    pub connected: bool,
    /// Time of the latest update about the link, on the aggregator's wall clock.
    pub last_seen: WallTime,
    /// The latest update of the edge about the link.
    pub live: LinkLive,
    /// One point per second of the edge's wall clock over the last ten minutes, oldest first; seconds without an update
    /// are absent.
    pub history: Vec<Arc<ClockPoint>>,
}

/// A host that was refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RefusedHost {
    /// Name that the host stated.
    pub name: Slug,
    /// Address that the host connected from, if the transport states it.
    pub address: Option<String>,
    /// Reason of the refusal, and the remedy.
    pub reason: String,
    /// Time of the host's latest attempt, on the aggregator's wall clock.
    pub at: WallTime,
}

/// Snapshot of one host.
#[derive(Clone, Debug, Serialize)]
pub struct HostSnapshot {
    /// Host id, the identity of the host; names may change.
    pub id: HostId,
    /// Description that the host sent in its hello.
    pub description: HostDescription,
    /// `true` if the host sent a message in the last three seconds. After a restart of the agent it is `false` until
    /// the first update, because the other values belong to the previous process.
    pub connected: bool,
    /// `true` if the host said goodbye with nothing left in its spool: it stopped cleanly.
    #[serde(rename = "left")]
    pub has_left: bool,
    /// Time of the host's last message, on the aggregator's wall clock.
    pub last_seen: WallTime,
    /// The host's wall clock minus the aggregator's at the latest update. This difference includes the network delay of
    /// the update. It can therefore show that a clock is wrong, but not exactly by how much.
    pub clock_ahead: Span,
    /// Storage lag: age of the oldest event in the spool, on the host's clock at its latest update; `None` if nothing
    /// waits.
    pub behind: Option<Span>,
    /// Estimate of how fast the lag falls; `None` if the lag does not fall or is below five
    /// seconds.
    pub catching_up: Option<CatchingUp>,
    /// State of the host's wall clock, as reported by the host.
    pub clock: HostClock,
    /// Latest load metrics.
    pub metrics: HostMetrics,
    /// The metrics of the last ten minutes, one point per five seconds, oldest first.
    pub history: Vec<Arc<MetricsPoint>>,
    /// Counts of the host's events, as reported by the host.
    pub accounting: Accounting,
    /// Counts of the host's events in the database.
    pub stored: StoredCounts,
    /// Batches that arrived and were not stored.
    #[serde(rename = "arrivals")]
    pub rejected_batches: RejectedBatches,
    /// Time of the host's newest stored event on the host's clock; `None` if nothing was stored since the aggregator's
    /// start.
    pub newest_stored: Option<WallTime>,
    /// Number of pipelines, links, names and seconds of live updates that exceeded the limits and were discarded.
    pub live_left_out: u64,
}

impl HostSnapshot {
    /// Returns the number of the host's events that are missing in the database for ever. Events that are in another
    /// database are not counted.
    pub fn missing_events(&self) -> MissingCount {
        let stored = self.stored.missing_everywhere();
        // Both numbers count the gaps that the agent reported, so a sum would count these gaps twice. The aggregator
        // also counts batches that it found missing, and the agent also counts events whose gap it has not sent yet.
        MissingCount { known: self.accounting.dropped.max(stored.known), ..stored }
    }
}

/// Load metrics of a host at one time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MetricsPoint {
    /// Time on the aggregator's wall clock.
    pub at: WallTime,
    /// The metrics.
    pub metrics: HostMetrics,
}

/// Snapshot of one pipeline.
#[derive(Clone, Debug, Serialize)]
pub struct PipelineSnapshot {
    /// Host id of the edge that the pipeline runs on.
    pub host: HostId,
    /// Name of that host.
    pub host_name: Slug,
    /// Name of the pipeline on that host.
    pub pipeline: Slug,
    /// State of the pipeline.
    pub state: PipelineState,
    /// Id of the current or last run.
    pub run: Option<RunId>,
    /// Number of that run in the store; `None` until the run is stored.
    pub run_number: Option<i64>,
    /// Placement of the computation.
    pub placement: Placement,
    /// Configured load as text: `closed`, `5 Hz`.
    pub load: String,
    /// Time of the latest update, on the aggregator's wall clock.
    pub last_seen: WallTime,
    /// Figures of the last 1, 10 and 60 seconds.
    pub windows: [Window; 3],
    /// The last 600 seconds, oldest first; seconds without an update are absent.
    pub series: Vec<Arc<LiveSecond>>,
    /// 95th percentile of the total latency over the same seconds.
    pub total_p95: PercentileSeries,
}

/// The 95th percentile of the total latency over time. Each value is the percentile of all iterations of its bucket:
/// the sketches of the bucket's seconds are merged.
///
/// The bucket's length is the shortest of 1, 2, 5, 10, 20, 30, 60, 120, 300 and 600 s with enough iterations at the
/// pipeline's rate.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PercentileSeries {
    /// Length of each bucket, seconds; `None` if even the longest bucket would have too few iterations.
    pub bucket_s: Option<u32>,
    /// Buckets with enough iterations, oldest first; the newest bucket may be incomplete.
    pub points: Vec<PercentilePoint>,
}

/// The 95th percentile of one bucket.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PercentilePoint {
    /// First second of the bucket on the edge's wall clock, in Unix seconds; a multiple of the bucket's length.
    pub at: i64,
    /// Number of successful iterations in the bucket.
    pub count: u64,
    /// 95th percentile of their total latency, seconds.
    pub p95: f64,
}

/// Figures of the last seconds of the edge's wall clock.
///
/// Covers the given number of complete seconds and the incomplete second, so that a number is current and not computed
/// from a few milliseconds only. Rates refer to the time really covered: the time since the pipeline's first second if
/// that second is within the window.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Window {
    /// Number of complete seconds: 1, 10 or 60.
    pub seconds: u32,
    /// Time really covered including the incomplete second, seconds.
    pub covered_s: f64,
    /// Number of iterations by outcome, without warm-up.
    pub counts: OutcomeCounts,
    /// Iterations of any outcome per second.
    pub rate_hz: f64,
    /// Fraction of failed iterations (outcome `failed`, `lost` or `timeout`), 0 to 1; `None` if there were no
    /// iterations.
    #[serde(rename = "lost_fraction")]
    pub failed_fraction: Option<f64>,
    /// Fraction of iterations that missed their deadline or failed, 0 to 1; `None` without a deadline or
    /// without iterations.
    pub miss_rate: Option<f64>,
    /// Figures by node name in SI units: the stages in order, totals, throughputs, sizes, then user-defined names.
    ///
    /// Throughputs are statistics over single iterations. Their mean is not the data rate of the window, which is in
    /// [`transfers`].
    ///
    /// [`transfers`]: Window::transfers
    pub values: Vec<(Name, QuantityStatistics)>,
    /// Amounts of data and transfer times of both directions.
    pub transfers: Transfers,
    /// Bounds of the one-way delays `upload` and `download`: half-widths, ends and verdicts.
    pub bounds: Vec<DelayAccuracy>,
}

/// One second of one pipeline, a point of the live charts.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LiveSecond {
    /// The second on the edge's wall clock, in Unix seconds.
    pub at: i64,
    /// Number of iterations by outcome, without warm-up.
    pub counts: OutcomeCounts,
    /// Means by node name in SI units, in the order of [`Window::values`].
    pub means: Vec<(Name, f64)>,
    /// Parts that add up to the mean of the total, seconds: see
    /// [`StageSplit`](peernet_analysis::stage_split::StageSplit).
    pub parts: Vec<(Name, f64)>,
    /// 95th percentile of the total latency in this second, seconds; `None` if fewer than 60 iterations succeeded.
    pub total_p95: Option<f64>,
    /// Amounts of data and transfer times of both directions.
    pub transfers: Transfers,
    /// Number of one-way delays by verdict, upload and download.
    pub verdicts: [VerdictCounts; 2],
}

impl Window {
    /// Returns the statistics of a node name.
    pub fn value(&self, name: &str) -> Option<&QuantityStatistics> {
        self.values.iter().find(|(value_name, _)| value_name == name).map(|(_, statistics)| statistics)
    }
}

impl PipelineSnapshot {
    /// Returns the window of 1, 10 or 60 seconds.
    pub fn window(&self, seconds: u32) -> Option<&Window> {
        self.windows.iter().find(|window| window.seconds == seconds)
    }
}
