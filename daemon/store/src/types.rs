//! Types of the results of the store's queries: plain data in SI units.

mod episodes;
mod experiment;
mod measured_time;
mod pairs;
mod recomputed;
mod statistics;

pub use episodes::Episodes;
pub use experiment::{ExperimentSummary, MeanBucket, StageBuckets, StageMeans};
pub use measured_time::{MeasuredTime, MeasuredWithin};
pub use pairs::ValuePairs;
pub use recomputed::{Judgement, RecomputedDelays, RecomputedStage};
pub(crate) use statistics::NameSummary;
pub use statistics::{MergeableStatistics, RunStatistics, StageStatistics};

use peernet_analysis::actuator_results::ActuatorResults;
use peernet_analysis::deadline::Misses;
use peernet_analysis::rows::Outcome;
use peernet_analysis::slowness::{Cause, Medians};
use peernet_clock::{DelaySource, RelatedClocks, Verdict, WallTime};
use peernet_logger::{HostId, Name, RunId, Slug, Tree};
use peernet_stream::{
    ClockSample, Condition, EndReason, ExperimentPosition, HostDescription, NetworkName, OutcomeCounts,
    Placement,
};
use serde::Serialize;

use crate::quantity_statistics::{QuantityStatistics, medians};
use crate::stored::{ClockPoint, StoredCounts};

/// Selection of the runs to list, newest first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFilter {
    /// Name of the pipelines; `None` for all.
    pub pipeline: Option<Slug>,
    /// Edge host; `None` for all.
    pub host: Option<HostId>,
    /// Maximum number of runs, 1 to 1,000.
    pub limit: u32,
    /// Selects the runs with a smaller number than this: the number of the last run of the previous page.
    pub before: Option<i64>,
}

impl Default for RunFilter {
    fn default() -> Self {
        Self { pipeline: None, host: None, limit: 50, before: None }
    }
}

/// A run in a list.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunSummary {
    /// The small number that people use; it is shown as `#412` and never used twice.
    pub number: i64,
    /// The id that the agent gave the run.
    pub id: RunId,
    /// The edge host.
    pub host: HostId,
    /// The edge host's name.
    pub host_name: Slug,
    /// The pipeline's name; `unknown` when the run's start never reached the store.
    pub pipeline: Slug,
    /// Placement: where the run computed, with the peer's name.
    pub placement: Placement,
    /// Start of the run on the edge's wall clock.
    pub started: WallTime,
    /// End of the run on the edge's wall clock; `None` while the run is running, or if its end never reached the
    /// store.
    pub ended: Option<WallTime>,
    /// Reason of the run's end.
    pub reason: Option<EndReason>,
    /// Start of the newest stored iteration on the edge's wall clock.
    pub last_iteration: Option<WallTime>,
    /// Iterations by outcome, without the warm-up.
    pub counts: OutcomeCounts,
    /// Iterations of the warm-up: stored, but excluded from statistics.
    pub warm_up: u64,
    /// Number of starts that an open loop skipped, without the warm-up.
    pub skipped_starts: u64,
    /// Longest allowed duration of an iteration in seconds; `None` without a deadline.
    pub deadline_s: Option<f64>,
    /// Iterations that missed the deadline; `None` without a deadline.
    pub misses: Option<Misses>,
    /// Superseded answers, and success and return of the episodes.
    pub actuator: ActuatorResults,
    /// Statistics of `total`, seconds; only of successful iterations after the warm-up.
    pub total: Option<QuantityStatistics>,
    /// `true` if a clock fault was injected on one of the run's hosts.
    pub has_clock_fault: bool,
    /// `true` if the run is pinned, so retention deletes none of its data.
    pub pinned: bool,
    /// Number of the last iteration that retention deleted; 0 if it deleted none.
    #[serde(rename = "nodes_from")]
    pub last_deleted_iteration: u64,
    /// Position of the run in an experiment, if it belongs to one.
    pub experiment: Option<ExperimentPosition>,
}

impl RunSummary {
    /// Returns the end of the run, or the start of its last stored iteration if no end was reported.
    pub fn end_time(&self) -> Option<WallTime> {
        self.ended.or(self.last_iteration)
    }
}

/// A run with all values that the store has of it, except for statistics and iterations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunDetail {
    /// The run as it appears in a list.
    #[serde(flatten)]
    pub summary: RunSummary,
    /// The run's facts: sensor, transforms, load and so on, as pairs of name and text, in the order of the
    /// configuration.
    pub facts: Vec<(String, String)>,
    /// The pipeline's table of the configuration file.
    pub configuration: String,
    /// Version of the agent.
    pub version: String,
    /// Conditions of the hosts before the run started; empty if none were recorded.
    pub conditions: Vec<Condition>,
    /// Missing events, oldest first. The gaps after the first 1,000 are combined into few rows.
    pub gaps: Vec<GapRow>,
}

impl From<RunSummary> for RunDetail {
    /// Makes a run that has only the values of `summary`. Its other fields are empty.
    fn from(summary: RunSummary) -> Self {
        Self {
            summary,
            facts: Vec::new(),
            configuration: String::new(),
            version: String::new(),
            conditions: Vec::new(),
            gaps: Vec::new(),
        }
    }
}

/// Events that never reached the store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct GapRow {
    /// Time at which the first event was dropped, on the host's wall clock.
    pub from: WallTime,
    /// Time at which the last event was dropped, on the host's wall clock.
    pub to: WallTime,
    /// Number of missing events; 0 when unknown.
    pub count: u64,
    /// Reason for the loss.
    pub reason: String,
    /// Number of gaps that this row combines. It is 1 for the first 1,000 gaps of a run; further gaps are combined.
    pub gaps: u64,
}

/// Distribution of one node name over a run, in bins of equal width.
///
/// It is made from a sketch whose bins are 2 % wide. Each bin of the sketch spreads its count evenly over its own
/// width; each bin of the histogram gets the part of this count that lies within it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Histogram {
    /// The node's name.
    pub stage: Name,
    /// Unit of the values.
    pub unit: String,
    /// Edges of the bins in ascending order, one more than `counts`.
    pub edges: Vec<f64>,
    /// Number of values per bin.
    pub counts: Vec<u64>,
    /// Number of values below the first bin.
    pub below: u64,
    /// Number of values above the last bin.
    pub beyond: u64,
    /// Statistics of all values.
    pub statistics: QuantityStatistics,
}

/// Several node names over the time of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Series {
    /// Width of a bucket, seconds.
    pub bucket_s: u32,
    /// One entry per name that has values, in the requested order.
    pub stages: Vec<StageSeries>,
    /// Missing events, oldest first. Rows that combine several gaps are left out, because events between these gaps
    /// were recorded.
    pub gaps: Vec<GapRow>,
}

/// One node name over time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageSeries {
    /// The node's name.
    pub stage: Name,
    /// Unit of the values.
    pub unit: String,
    /// Buckets that have values, oldest first; a bucket without values is absent.
    pub points: Vec<SeriesPoint>,
}

/// Statistics of one bucket.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SeriesPoint {
    /// Start of the bucket on the edge's wall clock; a multiple of the bucket's width.
    pub at: WallTime,
    /// Number of values.
    pub count: u64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile; `None` below 60 values.
    pub p95: Option<f64>,
}

/// Selection of the iterations of a run to list, in the order of their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IterationFilter {
    /// Selects the iterations with a greater number than this: the last number of the previous page; 0 for the first
    /// page.
    pub after: u64,
    /// Maximum number of iterations, 1 to 1,000.
    pub limit: u32,
    /// `true` for failed iterations only: those with the outcome `failed`, `lost` or `timeout`.
    pub failed_only: bool,
}

impl Default for IterationFilter {
    fn default() -> Self {
        Self { after: 0, limit: 100, failed_only: false }
    }
}

/// An iteration in a list.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IterationRow {
    /// Number within the run, contiguous from 1.
    pub number: u64,
    /// Number of the episode, from 0.
    pub episode: u32,
    /// Step within the episode, from 0.
    pub step: u32,
    /// `true` if the iteration belongs to the warm-up and is excluded from statistics.
    pub warm_up: bool,
    /// Outcome of the iteration.
    pub outcome: Outcome,
    /// Reason for which the iteration failed; `None` if it succeeded.
    pub reason: Option<String>,
    /// Start of the iteration on the edge's wall clock.
    pub started: WallTime,
    /// Seconds from the intended start to the end.
    pub total: Option<f64>,
    /// `total` divided by the run's median of `total`.
    pub factor: Option<f64>,
    /// Causes of the slow iteration, the largest excess first: stages, `lateness`, `unattributed`,
    /// [`REST_OF_UNATTRIBUTED`](peernet_analysis::slowness::REST_OF_UNATTRIBUTED), or
    /// [`BOTH_DIRECTIONS`](peernet_analysis::slowness::BOTH_DIRECTIONS). Empty if the iteration took less than 1.05
    /// times the run's median.
    pub causes: Vec<Cause>,
    /// Seconds per stage, in the order of the stages; several nodes of one stage are added up.
    pub stages: Vec<(Name, f64)>,
    /// Seconds of the total outside of all stages, as the agent measured them; `None` if the agent did not
    /// record them.
    pub unattributed: Option<f64>,
    /// Seconds of `upload` and `download` together if they are not known separately: the total minus the other stages
    /// and `unattributed`. `None` if each is known, or if nothing was sent.
    pub both_ways: Option<f64>,
    /// The one-way delays that were judged, in the order of the tree.
    pub delays: Vec<DelayRow>,
}

/// A one-way delay, seconds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DelayRow {
    /// `upload` or `download`.
    pub stage: Name,
    /// The estimate; `None` if the delay is unknown.
    pub value: Option<f64>,
    /// Bounds that contain the true delay; `None` when no bounds are known.
    pub bounds: Option<(f64, f64)>,
    /// The receiver's stamp minus the sender's stamp, both on wall clocks; may be negative.
    pub raw: f64,
    /// Source of the estimate and the bounds.
    pub source: DelaySource,
    /// Verdict on how far the estimate can be trusted.
    pub verdict: Verdict,
    /// Assumptions behind the bounds; `None` if no clock sample of the time of the delay is stored, or if sender and
    /// receiver read the same clock.
    pub assumptions: Option<DelayAssumptions>,
}

/// Assumptions behind the bounds of one-way delays, in addition to the exchanges and the source.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DelayAssumptions {
    /// The related clocks.
    pub clocks: RelatedClocks,
    /// Highest drift between the two clocks, parts per million; `None` if the agent did not report a valid limit.
    pub max_drift_ppm: Option<f64>,
    /// Highest change of the drift, parts per million per second; `None` if no limit was assumed.
    pub max_drift_change_ppm_per_s: Option<f64>,
    /// `true` if claims of time daemons might narrow the interval; `None` if not reported (releases before 0.3).
    pub claims_trusted: Option<bool>,
    /// `true` if all probes were authenticated; `None` if there were no probes, or if the agent did not report whether
    /// they were authenticated.
    pub probes_authenticated: Option<bool>,
}

impl From<&ClockSample> for DelayAssumptions {
    fn from(sample: &ClockSample) -> Self {
        Self {
            clocks: sample.clocks(),
            max_drift_ppm: Some(sample.max_drift_ppm).filter(|drift| drift.is_finite()),
            max_drift_change_ppm_per_s: sample.basis.and_then(|basis| basis.max_drift_change_ppm_per_s),
            claims_trusted: sample.basis.map(|basis| basis.claims_trusted),
            probes_authenticated: sample.basis.and_then(|basis| basis.probes_authenticated),
        }
    }
}

/// One iteration with its tree.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IterationDetail {
    /// The iteration as it appears in a list.
    #[serde(flatten)]
    pub row: IterationRow,
    /// The tree as the agent sent it.
    pub tree: Tree,
    /// Names of the hosts of the tree's anchors, in the order of the anchors; `None` for a host that never introduced
    /// itself to this aggregator and is not the run's cloud.
    pub hosts: Vec<Option<Slug>>,
    /// Rank among the slowest successful iterations of the run, from 1; `None` beyond the 1,000 slowest, and for
    /// iterations that are excluded from statistics.
    pub rank: Option<u64>,
    /// Number of the previous stored iteration.
    pub previous: Option<u64>,
    /// Number of the next stored iteration.
    pub next: Option<u64>,
    /// Number of the next slower successful iteration; `None` without a `rank`.
    pub slower: Option<u64>,
    /// Number of the next faster successful iteration; `None` without a `rank`.
    pub faster: Option<u64>,
    /// Statistics of the run per node name, for comparison with this iteration; in the order in which tables list the
    /// names.
    pub run_figures: Vec<(Name, QuantityStatistics)>,
}

impl IterationDetail {
    /// Returns the run's median of each node name.
    pub fn medians(&self) -> Medians {
        medians(&self.run_figures)
    }
}

/// Selection of the incidents to list, newest first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IncidentFilter {
    /// Maximum number of incidents, 1 to 1,000.
    pub limit: u32,
    /// Selects the incidents that are older than the incident with this id: the last incident of the previous page.
    pub before: Option<i64>,
    /// Selects the incidents of this kind; `None` for all kinds.
    pub kind: Option<String>,
    /// Selects the incidents that the host of this name reported; `None` for all hosts and the aggregator.
    pub host: Option<String>,
}

impl IncidentFilter {
    /// Selects the newest incidents of all kinds and hosts.
    pub const fn newest(limit: u32) -> Self {
        Self { limit, before: None, kind: None, host: None }
    }
}

/// An event that is not a measurement, such as a lost connection or a step of a clock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IncidentRow {
    /// Number in the order of arrival, for paging.
    pub id: i64,
    /// Time on the reporting host's wall clock.
    pub at: WallTime,
    /// Kind of the incident. Of a host: `disconnected`, `connected`, `refused`, `model-loaded`, `model-unloaded`,
    /// `clock-step`, `gap`, `pipeline-failed`, `control`. Of the aggregator: the names of [`AggregatorIncidentKind`].
    pub kind: String,
    /// The reporting host; `None` for the aggregator itself.
    pub host: Option<HostId>,
    /// The host's name; `None` for the aggregator itself.
    pub host_name: Option<Slug>,
    /// The pipeline concerned, if any.
    pub pipeline: Option<String>,
    /// The number of the run concerned, if any.
    pub run: Option<i64>,
    /// The name of the other host concerned, if any; the id of that host if it never introduced itself to this
    /// aggregator.
    pub peer: Option<String>,
    /// One sentence for people.
    pub text: String,
}

/// Kinds of incidents of the aggregator itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum AggregatorIncidentKind {
    /// The aggregator's wall clock was stepped.
    ClockStep,
    /// Retention deleted data.
    Retention,
    /// The database could not be written or read, or was damaged.
    Storage,
}

impl AggregatorIncidentKind {
    /// Returns the name used in storage, in the API and on the pages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ClockStep => "clock-step",
            Self::Retention => "retention",
            Self::Storage => "storage",
        }
    }
}

/// A host that has introduced itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HostRow {
    /// Random identifier of the host; stays the same when the host is renamed.
    pub id: HostId,
    /// Latest name of the host.
    pub name: Slug,
    /// Latest description that the host sent of itself.
    pub description: HostDescription,
    /// Time of the host's first message, on the aggregator's wall clock.
    pub first_seen: WallTime,
    /// Time of the host's last hello or stored event, on the aggregator's wall clock.
    pub last_seen: WallTime,
    /// Counts of the host's stored data.
    pub stored: StoredCounts,
}

/// Key of a link: two hosts that use several networks have one link over each.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct LinkKey {
    /// The edge.
    pub edge: HostId,
    /// The cloud.
    pub cloud: HostId,
    /// The network.
    pub network: NetworkName,
}

/// A link in a list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LinkRow {
    /// The edge.
    pub edge: HostId,
    /// Name of the edge.
    pub edge_name: Slug,
    /// The cloud.
    pub cloud: HostId,
    /// Name of the cloud.
    pub cloud_name: Slug,
    /// The network.
    pub network: NetworkName,
    /// Time of the first stored clock sample, on the edge's wall clock.
    pub first: WallTime,
    /// Time of the last stored clock sample, on the edge's wall clock.
    pub last: WallTime,
}

impl LinkRow {
    /// Returns the key of the link.
    pub fn key(&self) -> LinkKey {
        LinkKey { edge: self.edge, cloud: self.cloud, network: self.network.clone() }
    }
}

/// The clock relation of a link over time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockSeries {
    /// Width of a bucket, seconds; with 1, each point is one stored clock sample.
    pub bucket_s: u32,
    /// One point per bucket, oldest first; buckets without clock samples have no point.
    pub points: Vec<ClockPoint>,
}
