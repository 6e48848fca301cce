//! Schema of live pipelines.

use std::collections::BTreeMap;

use peernet_aggregator::{LiveSecond, LiveState, PercentileSeries, PipelineSnapshot};
use peernet_analysis::transfer;
use peernet_clock::Direction;
use serde::Serialize;
use utoipa::ToSchema;

use super::{Bound, Counts, NodeFigures, Placement, time};
use crate::view::speed;

/// All pipelines that reported.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct PipelineList {
    /// Time of the snapshot.
    pub at: String,
    pub pipelines: Vec<Pipeline>,
}

/// Current state of one pipeline.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Pipeline {
    /// Name of the host that runs the sensor.
    pub host: String,
    pub host_id: String,
    /// Name of the pipeline, unique on its host.
    pub name: String,
    /// `starting`, `waiting`, `running`, `finished`, `failed`, or `away` when its host is not connected.
    pub state: &'static str,
    /// Reason why the pipeline waits or failed.
    pub reason: Option<String>,
    /// Number of the current or last run; null until the run is stored.
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

/// 95th percentile of `total` over time. A bucket's value covers all iterations of the bucket, because their sketches are merged.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct TotalOverTime {
    /// Length of each bucket, seconds: the shortest of 1, 2, 5, 10, 20, 30, 60, 120, 300 and 600 that holds 60 iterations at the
    /// pipeline's rate; null if even the longest holds fewer.
    pub bucket_s: Option<u32>,
    /// Buckets of at least 60 iterations, oldest first; the newest one may be incomplete.
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
    /// Returns the buckets that end after `since_s`, in seconds since the Unix epoch.
    fn from_series(series: &PercentileSeries, since_s: i64) -> Self {
        let length = i64::from(series.bucket_s.unwrap_or(0));
        let points = series.points.iter().filter(|point| point.at + length > since_s);
        let points = points.map(|point| TotalPoint { at: point.at, count: point.count, p95: point.p95 });
        Self { bucket_s: series.bucket_s, points: points.collect() }
    }
}

/// Statistics of a window that ends now, by the edge's wall clock.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Window {
    /// Number of complete seconds: 1, 10 or 60. The current second is included in addition.
    pub seconds: u32,
    /// Seconds covered, with the elapsed part of the current second; fewer if the pipeline started within the window.
    pub covered_s: f64,
    pub counts: Counts,
    /// Iterations of any outcome per second.
    pub rate_hz: f64,
    /// Share of failed iterations (outcome `failed`, `lost` or `timeout`), 0 to 1; null without iterations.
    #[serde(rename = "lost_fraction")]
    pub failed_fraction: Option<f64>,
    /// Share of iterations that took longer than the pipeline's deadline or failed, 0 to 1; null without a deadline or without
    /// iterations.
    pub miss_rate: Option<f64>,
    /// Statistics of single iterations. The mean of `upload-throughput` is a mean of ratios; use `transfers` for the speed over the
    /// window.
    pub values: Vec<NodeFigures>,
    pub transfers: TransferRates,
    pub bounds: Vec<Bound>,
}

/// Speed and traffic of each direction.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct TransferRates {
    /// Direction from the edge to the cloud; null when nothing was sent.
    pub upload: Option<TransferRate>,
    /// Direction from the cloud to the edge; null when nothing was sent.
    pub download: Option<TransferRate>,
}

/// Rates of one direction, of successful iterations.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct TransferRate {
    /// Speed while sending: sum of bits divided by sum of transfer times; null where no delay is known, or the clocks do not determine
    /// the delays: at least 5 % of the delays have a verdict other than `ok` and `limited`.
    pub speed_bits_per_second: Option<f64>,
    /// Traffic: sum of bits divided by wall time.
    pub traffic_bits_per_second: Option<f64>,
}

impl TransferRates {
    fn new(window: &peernet_aggregator::Window) -> Self {
        let rate = |direction: Direction| {
            // The result is `None` if nothing was sent in this direction.
            window.transfers.of(direction)?;
            let speed = speed::known_speed(&window.transfers, &window.bounds, direction);
            Some(TransferRate {
                speed_bits_per_second: speed.map(|speed| speed.bits_per_second),
                traffic_bits_per_second: speed::direction_traffic(window, direction),
            })
        };
        Self { upload: rate(Direction::Up), download: rate(Direction::Down) }
    }
}

/// Sums of the messages sent within a second. Sums of several seconds can be added.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Transfers {
    /// Direction from the edge to the cloud; null when nothing was sent.
    pub upload: Option<Transfer>,
    /// Direction from the cloud to the edge; null when nothing was sent.
    pub download: Option<Transfer>,
}

/// Sums of one direction, of successful iterations. The speed while sending, in bytes per second over any number of seconds, is the sum
/// of `timed_bytes` divided by the sum of `seconds`.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Transfer {
    /// Bytes of all messages, payload and metadata.
    pub bytes: f64,
    /// Estimated bytes of the messages whose delay is known: these messages are assumed to have the average size.
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
    /// Means by node name, over single iterations; use `transfers` for speeds.
    pub means: BTreeMap<String, f64>,
    /// Parts of the mean of `total`, seconds: stages, `unattributed`, and `upload + download` where the clocks cannot split them.
    pub parts: BTreeMap<String, f64>,
    /// 95th percentile of `total` within the second, seconds; null below 60 successful iterations. Percentiles cannot be averaged; use
    /// `total_over_time` for a line over time.
    pub total_p95: Option<f64>,
    pub transfers: Transfers,
}

impl From<&LiveSecond> for Second {
    fn from(second: &LiveSecond) -> Self {
        Self {
            at: second.at,
            counts: second.counts.into(),
            means: second.means.iter().map(|(name, mean)| (name.to_string(), *mean)).collect(),
            parts: second.parts.iter().map(|(name, mean)| (name.to_string(), *mean)).collect(),
            total_p95: second.total_p95,
            transfers: Transfers::from(&second.transfers),
        }
    }
}

impl Pipeline {
    /// Converts a pipeline, with its last `seconds` seconds.
    pub(crate) fn new(snapshot: &PipelineSnapshot, seconds: usize) -> Self {
        let windows = snapshot.windows.iter().map(|window| Window {
            seconds: window.seconds,
            covered_s: window.covered_s,
            counts: window.counts.into(),
            rate_hz: window.rate_hz,
            failed_fraction: window.failed_fraction,
            miss_rate: window.miss_rate,
            values: NodeFigures::from_values(&window.values),
            transfers: TransferRates::new(window),
            bounds: window.bounds.iter().map(Bound::from).collect(),
        });
        let skip = snapshot.series.len().saturating_sub(seconds);
        // Without seconds, `total_over_time` has no points either.
        let since_s = snapshot.series.get(skip).map_or(i64::MAX, |second| second.at);
        Self {
            host: snapshot.host_name.to_string(),
            host_id: snapshot.host.to_string(),
            name: snapshot.pipeline.to_string(),
            state: snapshot.state.name(),
            reason: snapshot.state.reason().map(str::to_owned),
            run: snapshot.run_number,
            placement: Placement::from(&snapshot.placement),
            load: snapshot.load.clone(),
            last_seen: time(snapshot.last_seen),
            windows: windows.collect(),
            seconds: snapshot.series.iter().skip(skip).map(|second| Second::from(&**second)).collect(),
            total_over_time: TotalOverTime::from_series(&snapshot.total_p95, since_s),
        }
    }
}

impl PipelineList {
    /// Number of latest seconds of each pipeline in lists and events. Successive lists overlap, so
    /// that a client that reads a list only every few seconds misses no second.
    pub(crate) const SECONDS: usize = 5;

    /// Returns the list of all pipelines. `convert` converts one pipeline, and may omit the parts
    /// that a client did not request.
    pub(crate) fn of(snapshot: &LiveState, convert: impl Fn(&PipelineSnapshot) -> Pipeline) -> Self {
        let pipelines = snapshot.pipelines.iter().map(|pipeline| convert(pipeline));
        Self { at: time(snapshot.at), pipelines: pipelines.collect() }
    }
}
