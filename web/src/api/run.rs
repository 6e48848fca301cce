//! One run: what it is, its statistics, their course and distribution.

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use peernet_logger::stage;
use serde::Deserialize;
use utoipa::IntoParams;

use super::schema::{Bound, Histogram, Recomputed, RunDetail, Series, Stage, StageList};
use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, bounded, names, path};
use crate::state::{App, AppState};

/// The error for a run that is not there.
pub(super) fn no_run(number: i64) -> WebError {
    WebError::NotFound(format!("no run {number} is stored"))
}

/// Refuses to answer about a run that is not there.
pub(super) async fn must_exist(app: &AppState, number: i64) -> Result<(), WebError> {
    app.store().run(number).await?.map(|_| ()).ok_or_else(|| no_run(number))
}

/// A run with its configuration and gaps.
#[utoipa::path(get, path = "/api/v1/runs/{run}", operation_id = "getRun", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 200, body = RunDetail),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
pub(crate) async fn one(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<Json<RunDetail>, WebError> {
    let number = path(number)?;
    let run = app.store().run(number).await?.ok_or_else(|| no_run(number))?;
    Ok(Json(RunDetail::from(&run)))
}

/// Statistics per node name.
#[utoipa::path(get, path = "/api/v1/runs/{run}/stages", operation_id = "getRunStages", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 200, body = StageList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
pub(crate) async fn stages(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<Json<StageList>, WebError> {
    let number = path(number)?;
    must_exist(&app, number).await?;
    let known = app.store().statistics_of(number).await?;
    Ok(Json(StageList {
        stages: known.stages.iter().map(Stage::from).collect(),
        bounds: known.bounds.iter().map(Bound::from).collect(),
    }))
}

/// Which course.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub(crate) struct SeriesQuery {
    /// Node names, parted by commas; `total` unless given, at most 20.
    #[param(pattern = "^,*[^,]+(,+[^,]+){0,19},*$")]
    stages: Option<String>,
    /// At most so many buckets, 1 to 2,000; 300 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 2_000, default = 300)]
    points: Option<String>,
}

/// Node names over the time of the run.
#[utoipa::path(get, path = "/api/v1/runs/{run}/series", operation_id = "getRunSeries", tag = "runs", params(("run" = i64, Path), SeriesQuery), responses(
    (status = 200, body = Series),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
pub(crate) async fn series(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
    Parameters(query): Parameters<SeriesQuery>,
) -> Result<Json<Series>, WebError> {
    let number = path(number)?;
    let points = bounded("points", query.points.as_deref(), 300, 1..=2_000)?;
    let names = query.stages.map_or_else(|| Ok(vec![stage::TOTAL]), |text| names("stages", &text))?;
    must_exist(&app, number).await?;
    Ok(Json(Series::from(&app.store().series(number, &names, points).await?)))
}

/// Which distribution.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub(crate) struct HistogramQuery {
    /// A node name; `total` unless given.
    stage: Option<String>,
    /// At most so many bins, 1 to 500; 50 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 500, default = 50)]
    bins: Option<String>,
}

/// The distribution of one node name.
#[utoipa::path(get, path = "/api/v1/runs/{run}/histogram", operation_id = "getRunHistogram", tag = "runs", params(("run" = i64, Path), HistogramQuery), responses(
    (status = 200, body = Histogram),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
pub(crate) async fn histogram(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
    Parameters(query): Parameters<HistogramQuery>,
) -> Result<Json<Histogram>, WebError> {
    let number = path(number)?;
    let bins = bounded("bins", query.bins.as_deref(), 50, 1..=500)?;
    let name = query.stage.unwrap_or_else(|| stage::TOTAL.to_string());
    must_exist(&app, number).await?;
    let found = app.store().histogram(number, &name, bins).await?;
    let found = found.ok_or_else(|| {
        WebError::NotFound(format!("run {number} has no successful iteration with a {name}"))
    })?;
    Ok(Json(found.into()))
}

/// The one-way delays of a run as they were judged while it ran, and again with the exchanges that came after them.
/// What was stamped is never touched.
#[utoipa::path(get, path = "/api/v1/runs/{run}/recomputed", operation_id = "getRunRecomputed", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 200, body = Recomputed),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
pub(crate) async fn recomputed(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<Json<Recomputed>, WebError> {
    let number = path(number)?;
    let recomputed = app.store().recompute(number).await?.ok_or_else(|| no_run(number))?;
    Ok(Json(Recomputed::from(&recomputed)))
}
