//! Pipelines, now.

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};

use super::parameters::path;
use super::schema::{Pipeline, PipelineList};
use crate::error::{ProblemDetails, WebError};
use crate::state::App;

/// Every pipeline that reported, with its figures over 1, 10 and 60 seconds.
#[utoipa::path(get, path = "/api/v1/pipelines", operation_id = "listPipelines", tag = "pipelines", responses((status = 200, body = PipelineList)))]
pub(crate) async fn list(State(app): State<App>) -> Json<PipelineList> {
    Json(PipelineList::new(&app.picture()))
}

/// One pipeline with its last 600 seconds.
#[utoipa::path(get, path = "/api/v1/pipelines/{host}/{pipeline}", operation_id = "getPipeline", tag = "pipelines",
    params(("host" = String, Path, description = "name of the host it senses on"), ("pipeline" = String, Path, description = "its name there")),
    responses(
        (status = 200, body = Pipeline),
        (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
    )
)]
pub(crate) async fn one(
    State(app): State<App>,
    names: Result<Path<(String, String)>, PathRejection>,
) -> Result<Json<Pipeline>, WebError> {
    let (host, name) = path(names)?;
    let picture = app.picture();
    let found =
        picture.pipelines.iter().find(|one| one.host_name.as_str() == host && one.pipeline.as_str() == name);
    found
        .map(|one| Json(Pipeline::new(one, 600)))
        .ok_or_else(|| WebError::NotFound(format!("no pipeline {name} of host {host} has reported")))
}
