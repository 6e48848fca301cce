//! The resource of stored runs.

mod recomputed;
mod schema;
mod statistics;

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use peernet_store::RunFilter;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use self::schema::{Run, RunDetail, RunList};
use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, parse_bounded, parse_slug, path};
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(list))
        .routes(routes!(get))
        .merge(statistics::routes())
        .merge(recomputed::routes())
}

/// Query parameters of the list of runs.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct Query {
    /// Name of the runs' pipeline.
    #[param(pattern = "^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    pipeline: Option<String>,
    /// Name or id of the runs' edge host.
    host: Option<String>,
    /// Maximum number of runs returned, 1 to 1,000; 50 unless given.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1_000, default = 50)]
    limit: Option<String>,
    /// Runs before this number: `next` of the previous page.
    before: Option<i64>,
}

/// Runs, newest first.
#[utoipa::path(get, path = "/api/v1/runs", operation_id = "listRuns", tag = "runs", params(Query), responses(
    (status = 200, body = RunList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn list(
    State(app): State<App>,
    Parameters(query): Parameters<Query>,
) -> Result<Json<RunList>, WebError> {
    let limit = parse_bounded("limit", query.limit.as_deref(), 50, 1..=1_000)?;
    let pipeline = query.pipeline.as_deref().map(|name| parse_slug("pipeline", name)).transpose()?;
    let host = match query.host {
        None => None,
        Some(name) => {
            let host = app.store().host(&name).await?.ok_or_else(|| {
                WebError::BadRequest(format!(
                    "query parameter host: no host {name} has ever reported to this aggregator"
                ))
            })?;
            Some(host.id)
        }
    };
    let filter = RunFilter { pipeline, host, limit, before: query.before };
    let runs = app.store().runs(&filter).await?;
    // Whether more rows follow a full page is not known: the next page may be empty.
    let next = runs.last().filter(|_| runs.len() == limit as usize).map(|run| run.number);
    Ok(Json(RunList { runs: runs.iter().map(Run::from).collect(), next }))
}

/// A run with its configuration and gaps.
#[utoipa::path(get, path = "/api/v1/runs/{run}", operation_id = "getRun", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 200, body = RunDetail),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn get(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<Json<RunDetail>, WebError> {
    let number = path(number)?;
    let run = app.store().run(number).await?.ok_or_else(|| WebError::no_run(number))?;
    Ok(Json(RunDetail::from(&run)))
}
