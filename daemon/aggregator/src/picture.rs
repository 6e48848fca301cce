//! The live picture: what readers see of all agents, now.
//!
//! Plain data, made by the one task that owns the live state (`live/`) and shared by reference
//! count: hosts and pipelines that did not change since the last picture are not copied.

use std::sync::Arc;

use peernet_analysis::transfer::Transfers;
use peernet_clock::{Span, Verdict, WallTime};
use peernet_logger::{HostId, Name, RunId, Slug};
use peernet_stream::{
    Accounting, HostClock, HostDescription, HostMetrics, LinkLive, OutcomeCounts, PipelineState, Placement,
};
use serde::Serialize;

use peernet_store::{Bound, ClockPoint, Figures, Stored};

/// All agents, now.
#[derive(Clone, Debug, Serialize)]
pub struct Picture {
    /// When it was made, on the aggregator's wall clock.
    pub at: WallTime,
    /// Name of the aggregator.
    pub aggregator: Slug,
    /// Address at which agents connect, with the port really taken.
    pub listening: String,
    /// Every host heard of, by name.
    pub hosts: Vec<Arc<HostPicture>>,
    /// Every pipeline heard of, by host name and name.
    pub pipelines: Vec<Arc<PipelinePicture>>,
    /// Every link heard of, by the edge's and the cloud's name and the network.
    pub links: Vec<Arc<LinkPicture>>,
    /// Hosts that were turned away in the last ten minutes, newest first, at most 32.
    pub refused: Vec<RefusedHost>,
    /// Hosts of which something is stored and nothing was heard lately, or since the aggregator started.
    pub absent: usize,
    /// Of all hosts together, those included that are not in the picture.
    pub totals: Totals,
}

/// What is stored and what became of batches, all hosts together: only ever grows while the aggregator runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Totals {
    /// What the database holds.
    pub stored: Stored,
    /// Batches that came and were not taken.
    pub arrivals: Arrivals,
    /// What came and could not be told whose it is.
    pub refused: RefusedFrames,
}

/// What came and could not be told whose it is; since the aggregator started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RefusedFrames {
    /// Frames that are no message.
    pub unreadable: u64,
    /// Messages and batches of hosts that did not say hello on that connection; they are asked to.
    pub strangers: u64,
}

/// Batches that came and were not taken, to be sent again; since the aggregator started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Arrivals {
    /// There was no room for them.
    pub deferred: u64,
    /// Their bytes did not match their hash.
    pub damaged: u64,
}

/// How fast storing catches up with measuring.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CatchingUp {
    /// Seconds by which the lag falls in a second, over the last 10 s or so.
    pub rate: f64,
    /// Events stored in a second, over the same time.
    pub events_per_second: f64,
    /// Time until there is no lag, if it goes on like this.
    pub left: Span,
}

/// One link, now: an edge and a cloud over one network.
#[derive(Clone, Debug, Serialize)]
pub struct LinkPicture {
    /// The edge.
    pub edge: HostId,
    /// Its name.
    pub edge_name: Slug,
    /// Whether the edge is connected: its report is fresh.
    pub connected: bool,
    /// When the edge last reported, on the aggregator's wall clock.
    pub last_seen: WallTime,
    /// As the edge reported it last.
    pub live: LinkLive,
    /// The last ten minutes, a point per second of the edge's wall clock, oldest first; seconds without a report are
    /// absent.
    pub history: Vec<Arc<ClockPoint>>,
}

/// A host that was turned away.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RefusedHost {
    /// The name it gave.
    pub name: Slug,
    /// Where it connected from, where the transport tells.
    pub address: Option<String>,
    /// What was wrong and what to do about it.
    pub reason: String,
    /// When it last tried, on the aggregator's wall clock.
    pub at: WallTime,
}

/// One host, now.
#[derive(Clone, Debug, Serialize)]
pub struct HostPicture {
    /// Decides.
    pub id: HostId,
    /// As the host introduced itself.
    pub description: HostDescription,
    /// Whether it said hello and has been heard of in the last seconds; after a restart, from its first update on:
    /// until then, what it told is of the process before.
    pub connected: bool,
    /// Whether it took its leave and had handed over everything: then it is in order that it is not connected.
    pub left: bool,
    /// When it was last heard of, on the aggregator's wall clock.
    pub last_seen: WallTime,
    /// Its wall clock minus the aggregator's, by the last update: includes that update's way, so it is a hint
    /// that a clock is wrong and nothing more.
    pub clock_ahead: Span,
    /// How far storing is behind measuring: the age of the oldest event that waits, by the host's own clock at its last
    /// update; `None` when nothing waits.
    pub behind: Option<Span>,
    /// How fast that falls; `None` while it does not, or is below five seconds.
    pub catching_up: Option<CatchingUp>,
    /// Its wall clock, by its own account.
    pub clock: HostClock,
    /// How it fares.
    pub metrics: HostMetrics,
    /// The last ten minutes of `metrics`, one point per five seconds, oldest first.
    pub history: Vec<Arc<MetricsPoint>>,
    /// What became of its events, by its own account.
    pub accounting: Accounting,
    /// What became of its events, by the aggregator's account.
    pub stored: Stored,
    /// Batches of it that came and were not taken.
    pub arrivals: Arrivals,
    /// The newest moment that is stored of it, on its clock, as far as it was stored since the aggregator started.
    pub newest_stored: Option<WallTime>,
    /// Pipelines, names and seconds of live updates that were beyond the limits and left out of the picture.
    pub live_left_out: u64,
}

/// How a host fared at one moment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MetricsPoint {
    /// When, on the aggregator's wall clock.
    pub at: WallTime,
    /// How it fared.
    pub metrics: HostMetrics,
}

/// One pipeline, now.
#[derive(Clone, Debug, Serialize)]
pub struct PipelinePicture {
    /// The host it senses on.
    pub host: HostId,
    /// That host's name.
    pub host_name: Slug,
    /// Its name on that host.
    pub pipeline: Slug,
    /// What it does.
    pub state: PipelineState,
    /// The current or last run.
    pub run: Option<RunId>,
    /// The number under which the store knows that run; `None` until the run has reached the store.
    pub run_number: Option<i64>,
    /// Where it computes.
    pub placement: Placement,
    /// The intended load in words: `closed`, `5 Hz`.
    pub load: String,
    /// When it was last heard of, on the aggregator's wall clock.
    pub last_seen: WallTime,
    /// The last 1, 10 and 60 seconds.
    pub windows: [Window; 3],
    /// The last 600 seconds, oldest first; seconds without a report are absent.
    pub series: Vec<Arc<LiveSecond>>,
    /// The 95th percentile of `total` over the same seconds.
    pub total_p95: PercentileSeries,
}

/// The 95th percentile of `total` over time. Each is that of all iterations of its bucket: their sketches are merged.
///
/// The bucket is the shortest of 1, 2, 5, 10, 30, 60, 120, 300 and 600 s that holds enough iterations at the pipeline's
/// rate.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PercentileSeries {
    /// Length of each bucket, seconds; `None` while even the longest would hold too few iterations.
    pub bucket_s: Option<u32>,
    /// Buckets that hold enough iterations, oldest first; the newest one may be under way.
    pub points: Vec<PercentilePoint>,
}

/// The 95th percentile of one bucket.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PercentilePoint {
    /// First second of the bucket, since the Unix epoch, on the edge's wall clock; a multiple of the bucket's length.
    pub at: i64,
    /// Successful iterations in the bucket.
    pub count: u64,
    /// 95th percentile of their `total`, seconds.
    pub p95: f64,
}

/// What happened within the last seconds of the edge's wall clock.
///
/// Holds the given number of complete seconds and the one that is under way, so that a figure is neither
/// late nor made of a few milliseconds; rates are over the time really covered: that since the pipeline's first second
/// where this is within the window.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Window {
    /// Complete seconds: 1, 10 or 60.
    pub seconds: u32,
    /// Seconds really covered, with the one under way.
    pub covered_s: f64,
    /// Iterations by outcome, warm-up left out.
    pub counts: OutcomeCounts,
    /// Iterations of any outcome per second.
    pub rate_hz: f64,
    /// Share of iterations without an answer (failed, lost, timeout), 0 to 1; `None` when there were none.
    pub lost_fraction: Option<f64>,
    /// Share of iterations that took longer than their deadline or have no answer, 0 to 1; `None` without a deadline, and
    /// when there were none.
    pub miss_rate: Option<f64>,
    /// Figures by node name in SI units: the stages in order, totals, throughputs, sizes, then the user's own.
    ///
    /// A throughput's are of the single iterations: its mean is no speed over the window, which [`transfers`] gives.
    ///
    /// [`transfers`]: Window::transfers
    pub values: Vec<(Name, Figures)>,
    /// What was sent, and how long it was on its way.
    pub transfers: Transfers,
    /// How well the one-way delays are known: `upload`, `download`.
    pub bounds: Vec<Bound>,
}

/// One second of one pipeline, as the live charts draw it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LiveSecond {
    /// Seconds since the Unix epoch, on the edge's wall clock.
    pub at: i64,
    /// Iterations by outcome, warm-up left out.
    pub counts: OutcomeCounts,
    /// Means by node name in SI units, in the order of [`Window::values`].
    pub means: Vec<(Name, f64)>,
    /// 95th percentile of `total` within the second, seconds; `None` when fewer than 60 iterations succeeded.
    pub total_p95: Option<f64>,
    /// What was sent, and how long it was on its way.
    pub transfers: Transfers,
    /// How many delays of a direction deserve which verdict.
    pub verdicts: Vec<(Name, Verdict, u64)>,
}

impl Window {
    /// The figures of one node name.
    pub fn value(&self, name: &str) -> Option<&Figures> {
        self.values.iter().find(|(known, _)| known == name).map(|(_, figures)| figures)
    }
}

impl PipelinePicture {
    /// The window of that many seconds: 1, 10 or 60.
    pub fn window(&self, seconds: u32) -> Option<&Window> {
        self.windows.iter().find(|window| window.seconds == seconds)
    }
}
