//! Statistics of a run, over time and as distributions.

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use peernet_clock::Direction;
use peernet_logger::stage;
use peernet_store::{self as store, QuantityStatistics, RunStatistics};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::schema::Gap;
use crate::api::schema::{Bound, time};
use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, parse_bounded, parse_names, path};
use crate::state::{App, AppState};
use crate::view::speed;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(stages)).routes(routes!(series)).routes(routes!(histogram))
}

/// Statistics per node name.
#[utoipa::path(get, path = "/api/v1/runs/{run}/stages", operation_id = "getRunStages", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 200, body = StageList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn stages(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<Json<StageList>, WebError> {
    let number = path(number)?;
    check_exists(&app, number).await?;
    let statistics = app.store().statistics_of(number).await?;
    Ok(Json(StageList {
        stages: statistics.stages.iter().map(Stage::from).collect(),
        bounds: statistics.bounds.iter().map(Bound::from).collect(),
        speed_while_sending: SpeedWhileSending::new(&statistics),
    }))
}

/// Returns an error if the run does not exist.
async fn check_exists(app: &AppState, number: i64) -> Result<(), WebError> {
    app.store().run(number).await?.map(|_| ()).ok_or_else(|| WebError::no_run(number))
}

/// Query parameters of a time series.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct SeriesQuery {
    /// Node names, separated by commas; `total` unless given, at most 20.
    #[param(pattern = "^,*[^,]+(,+[^,]+){0,19},*$")]
    stages: Option<String>,
    /// Maximum number of buckets, 1 to 2,000; 300 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 2_000, default = 300)]
    points: Option<String>,
}

/// Statistics of nodes over the time of a run.
#[utoipa::path(get, path = "/api/v1/runs/{run}/series", operation_id = "getRunSeries", tag = "runs", params(("run" = i64, Path), SeriesQuery), responses(
    (status = 200, body = Series),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn series(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
    Parameters(query): Parameters<SeriesQuery>,
) -> Result<Json<Series>, WebError> {
    let number = path(number)?;
    let points = parse_bounded("points", query.points.as_deref(), 300, 1..=2_000)?;
    let names = query.stages.map_or_else(|| Ok(vec![stage::TOTAL]), |text| parse_names("stages", &text))?;
    check_exists(&app, number).await?;
    Ok(Json(Series::from(&app.store().series(number, &names, points).await?)))
}

/// Query parameters of a histogram.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct HistogramQuery {
    /// A node name; `total` unless given.
    stage: Option<String>,
    /// Maximum number of bins, 1 to 500; 50 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 500, default = 50)]
    bins: Option<String>,
}

/// The distribution of one node name.
#[utoipa::path(get, path = "/api/v1/runs/{run}/histogram", operation_id = "getRunHistogram", tag = "runs", params(("run" = i64, Path), HistogramQuery), responses(
    (status = 200, body = Histogram),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn histogram(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
    Parameters(query): Parameters<HistogramQuery>,
) -> Result<Json<Histogram>, WebError> {
    let number = path(number)?;
    let bins = parse_bounded("bins", query.bins.as_deref(), 50, 1..=500)?;
    let name = query.stage.unwrap_or_else(|| stage::TOTAL.to_string());
    check_exists(&app, number).await?;
    let histogram = app.store().histogram(number, &name, bins).await?;
    let histogram = histogram.ok_or_else(|| {
        WebError::NotFound(format!("run {number} has no successful iteration with a node {name}"))
    })?;
    Ok(Json(histogram.into()))
}

/// Statistics of a run per node name; successful iterations only, warm-up left out.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct StageList {
    pub stages: Vec<Stage>,
    /// Accuracy of the one-way delays, even if no delay has a value.
    pub bounds: Vec<Bound>,
    pub speed_while_sending: SpeedWhileSending,
}

/// Sum of bits divided by sum of transfer times. The mean of `upload-throughput` is a different figure, the mean of the ratios of single
/// iterations.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct SpeedWhileSending {
    /// Throughput from the edge to the cloud; null when nothing was sent, no delay is known, or the clocks do not determine the delays:
    /// at least 5 % of the delays have a verdict other than `ok` and `limited`.
    pub upload_bits_per_second: Option<f64>,
    /// Throughput from the cloud to the edge; null in the same cases.
    pub download_bits_per_second: Option<f64>,
}

impl SpeedWhileSending {
    fn new(statistics: &RunStatistics) -> Self {
        let transfers = statistics.transfers();
        let speed = |direction| {
            let speed = speed::known_speed(&transfers, &statistics.bounds, direction)?;
            Some(speed.bits_per_second)
        };
        Self {
            upload_bits_per_second: speed(Direction::Up),
            download_bits_per_second: speed(Direction::Down),
        }
    }
}

/// Statistics of one node name over a run.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Stage {
    pub name: String,
    /// Unit: `s`, `B`, `bit/s` or user-defined.
    pub unit: String,
    /// `true` if it is one of the stages that add up to `stages-total`.
    pub is_stage: bool,
    #[serde(flatten)]
    pub statistics: QuantityStatistics,
    /// Share of `total`, 0 to 1; for durations only.
    pub share: Option<f64>,
    pub bound: Option<Bound>,
}

impl From<&store::StageStatistics> for Stage {
    fn from(stage: &store::StageStatistics) -> Self {
        Self {
            name: stage.stage.to_string(),
            unit: stage.unit.clone(),
            is_stage: stage.is_stage,
            statistics: stage.statistics,
            share: stage.share,
            bound: stage.bound.as_ref().map(Bound::from),
        }
    }
}

/// Distribution of one node name over a run, in bins of equal width.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Histogram {
    pub name: String,
    /// Unit of the edges.
    pub unit: String,
    /// Edges of the bins, increasing; one more than `counts`.
    pub edges: Vec<f64>,
    pub counts: Vec<u64>,
    /// Number of samples below the first edge.
    pub below: u64,
    /// Number of samples above the last edge.
    pub beyond: u64,
    #[serde(rename = "figures")]
    pub statistics: QuantityStatistics,
}

impl From<store::Histogram> for Histogram {
    fn from(histogram: store::Histogram) -> Self {
        Self {
            name: histogram.stage.to_string(),
            unit: histogram.unit,
            edges: histogram.edges,
            counts: histogram.counts,
            below: histogram.below,
            beyond: histogram.beyond,
            statistics: histogram.statistics,
        }
    }
}

/// Statistics of nodes over the time of a run.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Series {
    /// Width of a bucket, seconds.
    pub bucket_s: u32,
    pub stages: Vec<StageSeries>,
    pub gaps: Vec<Gap>,
}

/// One node name over time. Buckets without samples are absent.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct StageSeries {
    pub name: String,
    pub unit: String,
    pub points: Vec<Point>,
}

/// One bucket.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Point {
    /// Start of the bucket, on the edge's wall clock.
    pub at: String,
    pub count: u64,
    pub mean: f64,
    pub p50: f64,
    /// Null below 60 samples.
    pub p95: Option<f64>,
}

impl From<&store::Series> for Series {
    fn from(series: &store::Series) -> Self {
        let point = |point: &store::SeriesPoint| Point {
            at: time(point.at),
            count: point.count,
            mean: point.mean,
            p50: point.p50,
            p95: point.p95,
        };
        let stages = series.stages.iter().map(|stage| StageSeries {
            name: stage.stage.to_string(),
            unit: stage.unit.clone(),
            points: stage.points.iter().map(point).collect(),
        });
        Self {
            bucket_s: series.bucket_s,
            stages: stages.collect(),
            gaps: series.gaps.iter().map(Gap::from).collect(),
        }
    }
}
