//! Pinning of runs. Retention deletes nothing of a pinned run.

use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::error::{ProblemDetails, WebError};
use crate::parameters::path;
use crate::state::{App, AppState};

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(put, delete))
}

/// Pins a run. Retention deletes nothing of a pinned run.
#[utoipa::path(put, path = "/api/v1/runs/{run}/pin", operation_id = "pinRun", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 204, description = "the run is pinned"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn put(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<StatusCode, WebError> {
    set_pinned(&app, path(number)?, true).await
}

/// Unpins a run. Retention deletes its data by age again.
#[utoipa::path(delete, path = "/api/v1/runs/{run}/pin", operation_id = "unpinRun", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 204, description = "the run is no longer pinned"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn delete(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<StatusCode, WebError> {
    set_pinned(&app, path(number)?, false).await
}

async fn set_pinned(app: &AppState, run: i64, pinned: bool) -> Result<StatusCode, WebError> {
    let exists = app.aggregator.pin(run, pinned).await?;
    if exists { Ok(StatusCode::NO_CONTENT) } else { Err(WebError::no_run(run)) }
}
