//! Pinned runs: retention deletes nothing of them.

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

/// Keeps (pins) a run: retention deletes nothing of it.
#[utoipa::path(put, path = "/api/v1/runs/{run}/pin", operation_id = "pinRun", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 204, description = "it is kept"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn put(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<StatusCode, WebError> {
    set(&app, path(number)?, true).await
}

/// Unpins a run: retention deletes it like others.
#[utoipa::path(delete, path = "/api/v1/runs/{run}/pin", operation_id = "unpinRun", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 204, description = "it is kept no longer than others"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn delete(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<StatusCode, WebError> {
    set(&app, path(number)?, false).await
}

async fn set(app: &AppState, run: i64, pinned: bool) -> Result<StatusCode, WebError> {
    let known = app.aggregator.pin(run, pinned).await?;
    if known { Ok(StatusCode::NO_CONTENT) } else { Err(WebError::no_run(run)) }
}
