//! Schema of live pipelines.

use std::collections::BTreeMap;

use peernet_aggregator::{LiveSecond, LiveState, PercentileSeries, PipelineSnapshot};
use peernet_analysis::transfer;
use serde::Serialize;
use utoipa::ToSchema;

use super::{Bound, Counts, NodeFigures, Placement, time};

/// Every pipeline that reported.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct PipelineList {
    /// Time of the figures.
    pub at: String,
    pub pipelines: Vec<Pipeline>,
}

/// Current state of one pipeline.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Pipeline {
    /// Name of the host it senses on.
    pub host: String,
    pub host_id: String,
    /// Name on that host.
    pub name: String,
    /// `starting`, `waiting`, `running`, `finished`, `failed`, or `away` when its host is not connected.
    pub state: &'static str,
    /// Reason why it waits or failed.
    pub reason: Option<String>,
    /// Number of its current or last run; null until that is stored.
    pub run: Option<i64>,
    pub placement: Placement,
    /// The intended load in words: `closed`, `5 Hz`.
    pub load: String,
    pub last_seen: String,
    /// The last 1, 10 and 60 seconds.
    pub windows: Vec<Window>,
    /// Seconds, oldest first: the last five in lists and events, the last 600 of a single pipeline. A second
    /// without a report is absent.
    pub seconds: Vec<Second>,
    /// 95th percentile of `total` over the time of `seconds`.
    pub total_over_time: TotalOverTime,
}

/// 95th percentile of `total` over time, of all iterations of a bucket: their sketches are merged.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct TotalOverTime {
    /// Length of each bucket, seconds: the shortest of 1, 2, 5, 10, 30, 60, 120, 300 and 600 that holds 60 iterations at
    /// the pipeline's rate; null while even the longest holds fewer.
    pub bucket_s: Option<u32>,
    /// Buckets that hold 60 iterations or more, oldest first; the newest one may be incomplete.
    pub points: Vec<TotalPoint>,
}

/// 95th percentile of `total` in one bucket.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct TotalPoint {
    /// First second of the bucket, since the Unix epoch, on the edge's wall clock.
    pub at: i64,
    /// Successful iterations in the bucket.
    pub count: u64,
    /// 95th percentile of their `total`, seconds.
    pub p95: f64,
}

impl TotalOverTime {
    /// Returns the buckets that reach to `since` or beyond, in seconds since the Unix epoch.
    fn since(series: &PercentileSeries, since: i64) -> Self {
        let length = i64::from(series.bucket_s.unwrap_or(0));
        let points = series.points.iter().filter(|point| point.at + length > since);
        let points = points.map(|point| TotalPoint { at: point.at, count: point.count, p95: point.p95 });
        Self { bucket_s: series.bucket_s, points: points.collect() }
    }
}

/// Statistics of the last seconds of the edge's wall clock.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Window {
    /// Complete seconds: 1, 10 or 60.
    pub seconds: u32,
    /// Seconds covered, including the current one: fewer where the pipeline began within the window.
    pub covered_s: f64,
    pub counts: Counts,
    /// Iterations of any outcome per second.
    pub rate_hz: f64,
    /// Share of iterations without an answer, 0 to 1; null when there were none.
    pub lost_fraction: Option<f64>,
    /// The miss rate: share of iterations that took longer than the pipeline's deadline or have no answer, 0 to 1; null without a
    /// deadline, and when there were none.
    pub miss_rate: Option<f64>,
    /// Statistics of single iterations. For the speed over the window take `transfers`, not the mean of `upload-throughput`, which is a
    /// mean of ratios.
    pub values: Vec<NodeFigures>,
    pub transfers: TransferRates,
    pub bounds: Vec<Bound>,
}

/// Throughput and sizes of messages.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct TransferRates {
    /// Direction from the edge to the cloud; null when nothing was sent.
    pub upload: Option<TransferRate>,
    /// Direction from the cloud to the edge; null when nothing was sent.
    pub download: Option<TransferRate>,
}

/// One direction, of successful iterations.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct TransferRate {
    /// Speed while sending: the sum of bits over the sum of transfer times; null while no delay is known.
    pub speed_bits_per_second: Option<f64>,
    /// Traffic: the sum of bits over wall time.
    pub traffic_bits_per_second: Option<f64>,
}

impl TransferRates {
    fn new(transfers: &transfer::Transfers, wall_s: f64) -> Self {
        let rate = |transfer: transfer::Transfer| TransferRate {
            speed_bits_per_second: transfer.speed(),
            traffic_bits_per_second: transfer.traffic(wall_s),
        };
        Self { upload: transfers.up.map(rate), download: transfers.down.map(rate) }
    }
}

/// Messages sent within a second, as sums that can be added up.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Transfers {
    /// Direction from the edge to the cloud; null when nothing was sent.
    pub upload: Option<Transfer>,
    /// Direction from the cloud to the edge; null when nothing was sent.
    pub download: Option<Transfer>,
}

/// One direction, of successful iterations. The speed while sending over any seconds is the sum of `timed_bytes` over the
/// sum of `seconds`.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Transfer {
    /// Bytes of all messages, payload and metadata.
    pub bytes: f64,
    /// Bytes of the messages whose delay is known.
    pub timed_bytes: f64,
    /// Sum of these delays, seconds.
    pub seconds: f64,
}

impl From<&transfer::Transfers> for Transfers {
    fn from(transfers: &transfer::Transfers) -> Self {
        let sums = |transfer: transfer::Transfer| {
            let transfer::Transfer { bytes, timed_bytes, seconds } = transfer;
            Transfer { bytes, timed_bytes, seconds }
        };
        Self { upload: transfers.up.map(sums), download: transfers.down.map(sums) }
    }
}

/// One second of one pipeline.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Second {
    /// Seconds since the Unix epoch, on the edge's wall clock.
    pub at: i64,
    pub counts: Counts,
    /// Means by node name, of single iterations: for a speed take `transfers`.
    pub means: BTreeMap<String, f64>,
    /// 95th percentile of `total` within the second, seconds; null below 60 successful iterations. For a line over time take
    /// `total_over_time`: percentiles cannot be averaged.
    pub total_p95: Option<f64>,
    pub transfers: Transfers,
}

impl From<&LiveSecond> for Second {
    fn from(second: &LiveSecond) -> Self {
        Self {
            at: second.at,
            counts: second.counts.into(),
            means: second.means.iter().map(|(name, mean)| (name.to_string(), *mean)).collect(),
            total_p95: second.total_p95,
            transfers: Transfers::from(&second.transfers),
        }
    }
}

impl Pipeline {
    /// Returns a pipeline with its last `seconds`.
    pub(crate) fn new(picture: &PipelineSnapshot, seconds: usize) -> Self {
        let windows = picture.windows.iter().map(|window| Window {
            seconds: window.seconds,
            covered_s: window.covered_s,
            counts: window.counts.into(),
            rate_hz: window.rate_hz,
            lost_fraction: window.lost_fraction,
            miss_rate: window.miss_rate,
            values: NodeFigures::all(&window.values),
            transfers: TransferRates::new(&window.transfers, window.covered_s),
            bounds: window.bounds.iter().map(Bound::from).collect(),
        });
        let skip = picture.series.len().saturating_sub(seconds);
        let since = picture.series.get(skip).map_or(i64::MAX, |second| second.at);
        Self {
            host: picture.host_name.to_string(),
            host_id: picture.host.to_string(),
            name: picture.pipeline.to_string(),
            state: picture.state.name(),
            reason: picture.state.reason().map(str::to_owned),
            run: picture.run_number,
            placement: Placement::from(&picture.placement),
            load: picture.load.clone(),
            last_seen: time(picture.last_seen),
            windows: windows.collect(),
            seconds: picture.series.iter().skip(skip).map(|second| Second::from(&**second)).collect(),
            total_over_time: TotalOverTime::since(&picture.total_p95, since),
        }
    }
}

impl PipelineList {
    /// Seconds of each pipeline in lists and events: enough to bridge a slow reader's pauses.
    pub(crate) const SECONDS: usize = 5;

    /// Converts the requested part of every pipeline.
    pub(crate) fn of(picture: &LiveState, taken: impl Fn(&PipelineSnapshot) -> Pipeline) -> Self {
        let pipelines = picture.pipelines.iter().map(|one| taken(one));
        Self { at: time(picture.at), pipelines: pipelines.collect() }
    }
}
