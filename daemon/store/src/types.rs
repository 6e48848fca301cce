//! What the store answers: plain data in SI units.

mod episodes;
mod experiment;
mod pairs;
mod statistics;

pub use episodes::Episodes;
pub use experiment::{ExperimentSummary, MeanBucket, StageCourse, StageMeans};
pub use pairs::Pairs;
pub(crate) use statistics::Known;
pub use statistics::{Kept, RunStatistics, StageStatistics};

use peernet_analysis::deadline::Misses;
use peernet_analysis::slowness::Cause;
use peernet_clock::{DelaySource, RelatedClocks, Verdict, WallTime};
use peernet_logger::{HostId, Name, RunId, Slug, Tree};
use peernet_stream::{
    ClockSample, Condition, EndReason, ExperimentPlace, HostDescription, NetworkName, OutcomeCounts,
    Placement,
};
use serde::Serialize;

use crate::figures::Figures;
use crate::stored::{ClockPoint, Stored};

/// Which runs to list, newest first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFilter {
    /// Only runs of pipelines of this name.
    pub pipeline: Option<Slug>,
    /// Only runs of this edge host.
    pub host: Option<HostId>,
    /// At most so many, 1 to 1,000.
    pub limit: u32,
    /// Only runs of smaller number: the number of the last run of the page before.
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
    /// The small number people use: shown as `#412`, never used twice.
    pub number: i64,
    /// The id its agent gave it.
    pub id: RunId,
    /// The edge host.
    pub host: HostId,
    /// The edge host's name.
    pub host_name: Slug,
    /// The pipeline's name; `unknown` when the run's beginning never reached the store.
    pub pipeline: Slug,
    /// Where it computed, with the peer's name.
    pub placement: Placement,
    /// When it began, on the edge's wall clock.
    pub started: WallTime,
    /// When it ended; `None` while it goes on, or when its end never reached the store.
    pub ended: Option<WallTime>,
    /// Why it ended.
    pub reason: Option<EndReason>,
    /// When the newest stored iteration began, on the edge's wall clock.
    pub last_iteration: Option<WallTime>,
    /// Iterations by outcome, warm-up left out.
    pub counts: OutcomeCounts,
    /// Iterations of the warm-up, stored but in no statistic.
    pub warm_up: u64,
    /// Starts of an open loop that were skipped before its iterations, whatever became of these; warm-up left out.
    pub skipped_starts: u64,
    /// How long an iteration may take, seconds; `None` without a deadline.
    pub deadline_s: Option<f64>,
    /// How many iterations missed it; `None` without a deadline.
    pub misses: Option<Misses>,
    /// Figures of `total`, seconds; successful iterations only.
    pub total: Option<Figures>,
    /// Whether the clock of one of its hosts was made wrong on purpose.
    pub rehearsed: bool,
    /// Whether it is kept whole, whatever its age.
    pub pinned: bool,
    /// Iterations up to and including this number were deleted, because of their age or for want of room; 0 when none
    /// were.
    pub nodes_from: u64,
    /// Its place in an experiment, if it belongs to one.
    pub experiment: Option<ExperimentPlace>,
}

/// A run with all that is known of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunDetail {
    /// As in a list.
    #[serde(flatten)]
    pub summary: RunSummary,
    /// Sensor, transforms, load and so on, as pairs for people, in the order of the configuration.
    pub facts: Vec<(String, String)>,
    /// The pipeline's table of the configuration file.
    pub configuration: String,
    /// Version of the agent.
    pub version: String,
    /// What was found of the hosts before it began; empty when nobody looked.
    pub conditions: Vec<Condition>,
    /// What is missing, oldest first, at most 1,000.
    pub gaps: Vec<GapRow>,
}

impl From<RunSummary> for RunDetail {
    /// A run of which no more is known than a list says.
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
    /// When the first was dropped, on the host's wall clock.
    pub from: WallTime,
    /// When the last was dropped.
    pub to: WallTime,
    /// How many; 0 when that is not known.
    pub count: u64,
    /// Why.
    pub reason: String,
}

/// Distribution of one node name over a run, in bins of equal width.
///
/// Made from a sketch whose own bins are 2 % wide, each spread evenly over the bins it overlaps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Histogram {
    /// The node's name.
    pub stage: Name,
    /// Unit of the edges.
    pub unit: String,
    /// Edges of the bins, one more than `counts`, rising.
    pub edges: Vec<f64>,
    /// Samples per bin.
    pub counts: Vec<u64>,
    /// Samples above the last edge.
    pub beyond: u64,
    /// Figures of all samples.
    pub figures: Figures,
}

/// Several node names over the time of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Series {
    /// Width of a bucket, seconds.
    pub bucket_s: u32,
    /// One entry per name that has samples, in the order asked for.
    pub stages: Vec<StageSeries>,
    /// What is missing, oldest first.
    pub gaps: Vec<GapRow>,
}

/// One node name over time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageSeries {
    /// The node's name.
    pub stage: Name,
    /// Unit of the values.
    pub unit: String,
    /// Buckets that have samples, oldest first; a bucket without samples is absent.
    pub points: Vec<SeriesPoint>,
}

/// One bucket.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SeriesPoint {
    /// Begin of the bucket, on the edge's wall clock; a multiple of the bucket's width.
    pub at: WallTime,
    /// Samples.
    pub count: u64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile; `None` below 60 samples.
    pub p95: Option<f64>,
}

/// Which iterations of a run to list, by rising number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IterationFilter {
    /// Only iterations of greater number: the last number of the page before; 0 begins.
    pub after: u64,
    /// At most so many, 1 to 1,000.
    pub limit: u32,
    /// Only iterations without an answer: failed, lost, timeout.
    pub unsuccessful: bool,
}

impl Default for IterationFilter {
    fn default() -> Self {
        Self { after: 0, limit: 100, unsuccessful: false }
    }
}

/// An iteration in a list.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IterationRow {
    /// Contiguous from 1 within the run.
    pub number: u64,
    /// Episode, from 0.
    pub episode: u32,
    /// Step within the episode, from 0.
    pub step: u32,
    /// Left out of statistics.
    pub warm_up: bool,
    /// `ok`, `failed`, `lost` or `timeout`.
    pub outcome: String,
    /// Why it failed or was lost.
    pub reason: Option<String>,
    /// When it began, on the edge's wall clock.
    pub started: WallTime,
    /// Seconds from the intended start to the end.
    pub total: Option<f64>,
    /// `total` over the run's median of it.
    pub factor: Option<f64>,
    /// What made it slow, the largest excess first: stages, `lateness`, `unattributed`, or [`BOTH_WAYS`](peernet_analysis::slowness::BOTH_WAYS). Empty where it took
    /// no longer than the run's median.
    pub causes: Vec<Cause>,
    /// Seconds per stage, in the order of the stages; a stage that occurs several times is added up.
    pub stages: Vec<(Name, f64)>,
    /// Seconds that the total holds beyond its stages, as the agent measured it; `None` where it could not tell.
    pub unattributed: Option<f64>,
    /// Seconds of `upload` and `download` together where the two are not known apart: the total less the other stages
    /// and `unattributed`. `None` where each is known, or nothing was sent.
    pub both_ways: Option<f64>,
    /// The one-way delays that were judged, in the order of the tree.
    pub delays: Vec<DelayRow>,
}

/// A one-way delay, seconds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DelayRow {
    /// `upload` or `download`.
    pub stage: Name,
    /// The estimate; `None` when it is not known.
    pub value: Option<f64>,
    /// The bounds that contain the truth; `None` when nothing is known.
    pub bounds: Option<(f64, f64)>,
    /// The receiver's stamp less the sender's: may be negative.
    pub raw: f64,
    /// What the correction rests on.
    pub source: DelaySource,
    /// How far it can be trusted.
    pub verdict: Verdict,
    /// What its bounds rest on; `None` where no clock sample of its time is stored, and where both ends are on one clock.
    pub assumptions: Option<DelayAssumptions>,
}

/// What the bounds of one-way delays rest on, beside the exchanges and the source.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DelayAssumptions {
    /// The clocks that were related.
    pub clocks: RelatedClocks,
    /// The fastest that the two clocks may drift apart, parts per million; `None` where it was not told.
    pub max_drift_ppm: Option<f64>,
    /// How fast that rate may change, parts per million per second; `None` where nothing was assumed of it.
    pub max_drift_change_ppm_per_s: Option<f64>,
    /// Whether claims of time daemons might narrow the interval; `None` where it was not told (releases before 0.3).
    pub claims_trusted: Option<bool>,
    /// Whether all probes were authenticated; `None` where there were none or it was not told.
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
    /// As in a list.
    #[serde(flatten)]
    pub row: IterationRow,
    /// The tree as the agent sent it.
    pub tree: Tree,
    /// The names of the hosts of the tree's anchors, in their order; `None` for one that never reported here and is not
    /// the run's server.
    pub hosts: Vec<Option<Slug>>,
    /// Place among the slowest successful iterations of the run, from 1; `None` beyond the 1,000 slowest, and for
    /// iterations that are in no statistic.
    pub rank: Option<u64>,
    /// The stored iteration before.
    pub previous: Option<u64>,
    /// The stored iteration after.
    pub next: Option<u64>,
    /// The successful iteration that is slower by one place; `None` without a `rank`.
    pub slower: Option<u64>,
    /// The one that is faster by one place; `None` without a `rank`.
    pub faster: Option<u64>,
    /// Figures of the run per node name, for comparison; in the order of tables.
    pub run_figures: Vec<(Name, Figures)>,
}

/// Which incidents to list, newest first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IncidentFilter {
    /// At most so many, 1 to 1,000.
    pub limit: u32,
    /// Only incidents before this one: the id of the last of the page before.
    pub before: Option<i64>,
    /// Only incidents of this kind.
    pub kind: Option<String>,
    /// Only incidents that the host of this name reported.
    pub host: Option<String>,
}

impl IncidentFilter {
    /// Returns the newest ones of all kinds and hosts.
    pub const fn newest(limit: u32) -> Self {
        Self { limit, before: None, kind: None, host: None }
    }
}

/// Something that happened beside the measurements.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IncidentRow {
    /// Rises with the order of arrival: for paging.
    pub id: i64,
    /// When, on the reporting host's wall clock.
    pub at: WallTime,
    /// Of a host: `disconnected`, `connected`, `refused`, `model-loaded`, `clock-step`, `gap`, `pipeline-failed`,
    /// `control`. Of the aggregator: the names of [`AggregatorIncidentKind`].
    pub kind: String,
    /// The reporting host; `None`: the aggregator itself.
    pub host: Option<HostId>,
    /// Its name; `None`: the aggregator itself.
    pub host_name: Option<Slug>,
    /// The pipeline concerned, if one.
    pub pipeline: Option<String>,
    /// The number of the run concerned, if one.
    pub run: Option<i64>,
    /// The other host's name, if one is concerned; its id where it never introduced itself here.
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
    /// The name used in storage, in the API and on the pages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ClockStep => "clock-step",
            Self::Retention => "retention",
            Self::Storage => "storage",
        }
    }
}

/// A host that once introduced itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HostRow {
    /// Decides.
    pub id: HostId,
    /// Its last name.
    pub name: Slug,
    /// As it last introduced itself.
    pub description: HostDescription,
    /// When it first came, on the aggregator's wall clock.
    pub first_seen: WallTime,
    /// When it last said hello or had something stored, on the aggregator's wall clock.
    pub last_seen: WallTime,
    /// What the database holds of it.
    pub stored: Stored,
}

/// What a link is known by: two hosts that use several networks have a link over each.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct LinkKey {
    /// The edge.
    pub edge: HostId,
    /// The cloud.
    pub cloud: HostId,
    /// The network.
    pub network: NetworkName,
}

/// A link that the store knows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LinkRow {
    /// The edge.
    pub edge: HostId,
    /// Its name.
    pub edge_name: Slug,
    /// The cloud.
    pub cloud: HostId,
    /// Its name.
    pub cloud_name: Slug,
    /// The network.
    pub network: NetworkName,
    /// The first stored sample, on the edge's wall clock.
    pub first: WallTime,
    /// The last one.
    pub last: WallTime,
}

impl LinkRow {
    /// What the link is known by.
    pub fn key(&self) -> LinkKey {
        LinkKey { edge: self.edge, cloud: self.cloud, network: self.network.clone() }
    }
}

/// The clock relation of a link over time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockSeries {
    /// Width of a bucket, seconds; 1 is as stored.
    pub bucket_s: u32,
    /// Oldest first; buckets without samples are absent.
    pub points: Vec<ClockPoint>,
}

/// The one-way delays of a run as they were judged while it ran, and as all exchanges judge them, those after it
/// included. What was stamped is never touched.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recomputed {
    /// The run.
    pub number: i64,
    /// Stored clock samples that were used.
    pub samples: u64,
    /// The clocks by whose stamps delays were judged again. Wall clocks are those of runs that were recorded before free-running clocks were
    /// stamped: their steps and slews reach these delays. Empty where all delays stay as they were judged.
    pub clocks: Vec<RelatedClocks>,
    /// `upload`, `download`.
    pub stages: Vec<RecomputedStage>,
}

/// One direction, before and after. Successful iterations only, warm-up left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecomputedStage {
    /// The node's name.
    pub stage: Name,
    /// As stored.
    pub before: Judgement,
    /// As computed again.
    pub after: Judgement,
}

/// Delays and how well they are known.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Judgement {
    /// Figures of the delays that have a value, seconds.
    pub delay: Option<Figures>,
    /// Figures of half the width of their bounds, seconds.
    pub half_width: Option<Figures>,
    /// How often each verdict was given.
    pub verdicts: Vec<(Verdict, u64)>,
}
