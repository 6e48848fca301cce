//! The resource of live pipelines.

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use peernet_aggregator::PipelineSnapshot;
use peernet_logger::Name;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::schema::{Pipeline, PipelineList};
use crate::error::{ProblemDetails, WebError};
use crate::parameters::{Parameters, parse_names, path};
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list)).routes(routes!(get))
}

/// Lengths of the windows as query values, seconds.
const WINDOWS: [&str; 3] = ["1", "10", "60"];
/// Maximum number of seconds of one pipeline if no window is selected.
const MAX_SECONDS: usize = 600;

/// Query parameters that select parts of a pipeline. Without them all parts are returned.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct Query {
    /// Length of the only window to return: 1, 10 or 60 seconds. `seconds` is then limited to the same length.
    #[param(pattern = "^(1|10|60)$")]
    window: Option<String>,
    /// Names of nodes to return, separated by commas, at most 20: `total,upload`. A name that was never measured has no values.
    #[param(pattern = "^,*[^,]+(,+[^,]+){0,19},*$")]
    stage: Option<String>,
}

/// The parts of a pipeline that a [`Query`] selects.
struct PipelineSelection {
    window: Option<u32>,
    names: Option<Vec<Name>>,
}

impl PipelineSelection {
    fn from_query(query: &Query) -> Result<Self, WebError> {
        let window = |text: &String| {
            let seconds = WINDOWS.contains(&text.as_str()).then(|| text.parse().ok()).flatten();
            seconds.ok_or_else(|| {
                WebError::BadRequest(format!("query parameter window: {text:?} is not one of 1, 10 and 60"))
            })
        };
        let window = query.window.as_ref().map(window).transpose()?;
        Ok(Self { window, names: query.stage.as_deref().map(|text| parse_names("stage", text)).transpose()? })
    }

    /// Returns the selected parts of the pipeline, with at most `seconds` seconds.
    fn apply(&self, snapshot: &PipelineSnapshot, seconds: usize) -> Pipeline {
        let seconds = self.window.map_or(seconds, |window| seconds.min(window as usize));
        let mut pipeline = Pipeline::new(snapshot, seconds);
        pipeline.windows.retain(|window| self.window.is_none_or(|seconds| window.seconds == seconds));
        let Some(names) = &self.names else { return pipeline };
        let is_selected = |name: &str| names.iter().any(|selected| selected == name);
        for window in &mut pipeline.windows {
            window.values.retain(|value| is_selected(&value.name));
            window.bounds.retain(|bound| is_selected(&bound.stage));
            window.transfers.upload.take_if(|_| !is_selected("upload"));
            window.transfers.download.take_if(|_| !is_selected("download"));
        }
        for second in &mut pipeline.seconds {
            second.means.retain(|name, _| is_selected(name));
            second.parts.retain(|name, _| is_selected(name));
            second.total_p95.take_if(|_| !is_selected("total"));
            second.transfers.upload.take_if(|_| !is_selected("upload"));
            second.transfers.download.take_if(|_| !is_selected("download"));
        }
        if !is_selected("total") {
            pipeline.total_over_time.points.clear();
        }
        pipeline
    }
}

/// All pipelines that reported, with their statistics over 1, 10 and 60 seconds.
#[utoipa::path(get, path = "/api/v1/pipelines", operation_id = "listPipelines", tag = "pipelines", params(Query), responses(
    (status = 200, body = PipelineList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn list(
    State(app): State<App>,
    Parameters(query): Parameters<Query>,
) -> Result<Json<PipelineList>, WebError> {
    let selection = PipelineSelection::from_query(&query)?;
    let select = |pipeline: &PipelineSnapshot| selection.apply(pipeline, PipelineList::SECONDS);
    Ok(Json(PipelineList::of(&app.live_state(), select)))
}

/// One pipeline with its last 600 seconds.
#[utoipa::path(get, path = "/api/v1/pipelines/{host}/{pipeline}", operation_id = "getPipeline", tag = "pipelines",
    params(
        ("host" = String, Path, description = "name of the host that runs the sensor"),
        ("pipeline" = String, Path, description = "name of the pipeline on that host"),
        Query,
    ),
    responses(
        (status = 200, body = Pipeline),
        (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
    )
)]
async fn get(
    State(app): State<App>,
    names: Result<Path<(String, String)>, PathRejection>,
    Parameters(query): Parameters<Query>,
) -> Result<Json<Pipeline>, WebError> {
    let ((host, name), selection) = (path(names)?, PipelineSelection::from_query(&query)?);
    let snapshot = app.live_state();
    snapshot
        .pipeline(&host, &name)
        .map(|pipeline| Json(selection.apply(pipeline, MAX_SECONDS)))
        .ok_or_else(|| WebError::NotFound(format!("host {host} has not reported a pipeline {name}")))
}
