//! Pipelines, now.

use std::collections::BTreeMap;

use peernet_aggregator::{LiveSecond, Picture, PipelinePicture};
use serde::Serialize;
use utoipa::ToSchema;

use super::{Bound, Counts, NodeFigures, Placement, time};

/// Every pipeline that reported.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct PipelineList {
    /// When the figures were taken.
    pub at: String,
    pub pipelines: Vec<Pipeline>,
}

/// One pipeline, now.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Pipeline {
    /// Name of the host it senses on.
    pub host: String,
    pub host_id: String,
    /// Name on that host.
    pub name: String,
    /// `starting`, `waiting`, `running`, `finished`, `failed`, or `away` when its host is not connected.
    pub state: &'static str,
    /// Why it waits or failed.
    pub reason: Option<String>,
    /// Number of its current or last run, once that reached the store.
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
}

/// What happened within the last seconds of the edge's wall clock.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Window {
    /// Complete seconds: 1, 10 or 60.
    pub seconds: u32,
    /// Seconds really covered, with the one under way.
    pub covered_s: f64,
    pub counts: Counts,
    /// Iterations of any outcome per second.
    pub rate_hz: f64,
    /// Share of iterations without an answer, 0 to 1; null when there were none.
    pub lost_fraction: Option<f64>,
    pub values: Vec<NodeFigures>,
    pub bounds: Vec<Bound>,
}

/// One second of one pipeline.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Second {
    /// Seconds since the Unix epoch, on the edge's wall clock.
    pub at: i64,
    pub counts: Counts,
    /// Means by node name.
    pub means: BTreeMap<String, f64>,
    /// 95th percentile of `total` within the second, seconds.
    pub total_p95: Option<f64>,
}

impl From<&LiveSecond> for Second {
    fn from(second: &LiveSecond) -> Self {
        Self {
            at: second.at,
            counts: second.counts.into(),
            means: second.means.iter().map(|(name, mean)| (name.to_string(), *mean)).collect(),
            total_p95: second.total_p95,
        }
    }
}

impl Pipeline {
    /// A pipeline with its last `seconds`.
    pub(crate) fn new(picture: &PipelinePicture, seconds: usize) -> Self {
        let windows = picture.windows.iter().map(|window| Window {
            seconds: window.seconds,
            covered_s: window.covered_s,
            counts: window.counts.into(),
            rate_hz: window.rate_hz,
            lost_fraction: window.lost_fraction,
            values: NodeFigures::all(&window.values),
            bounds: window.bounds.iter().map(Bound::from).collect(),
        });
        let skip = picture.series.len().saturating_sub(seconds);
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
        }
    }
}

impl PipelineList {
    /// Seconds of each pipeline in lists and events: enough to bridge a slow reader's pauses.
    pub(crate) const SECONDS: usize = 5;

    /// Every pipeline, as far as it is taken.
    pub(crate) fn of(picture: &Picture, taken: impl Fn(&PipelinePicture) -> Pipeline) -> Self {
        let pipelines = picture.pipelines.iter().map(|one| taken(one));
        Self { at: time(picture.at), pipelines: pipelines.collect() }
    }
}
