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
use crate::parameters::{Parameters, names, path};
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list)).routes(routes!(get))
}

/// Lengths of the windows, seconds.
const WINDOWS: [&str; 3] = ["1", "10", "60"];
/// Number of seconds of one pipeline where no window is selected.
const HISTORY: usize = 600;

/// Parts of a pipeline to return; all of them unless given.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
struct Query {
    /// Length of the only window to return: 1, 10 or 60 seconds; `seconds` is then cut to the same length.
    #[param(pattern = "^(1|10|60)$")]
    window: Option<String>,
    /// Names of nodes, separated by commas, at most 20: `total,upload`. A name that was never measured has no values.
    #[param(pattern = "^,*[^,]+(,+[^,]+){0,19},*$")]
    stage: Option<String>,
}

/// A valid [`Query`].
struct Part {
    window: Option<u32>,
    names: Option<Vec<Name>>,
}

impl Part {
    fn of(query: &Query) -> Result<Self, WebError> {
        let window = |text: &String| {
            let known = WINDOWS.contains(&text.as_str()).then(|| text.parse().ok()).flatten();
            known.ok_or_else(|| {
                WebError::BadRequest(format!("query parameter window: {text:?} is not one of 1, 10 and 60"))
            })
        };
        let window = query.window.as_ref().map(window).transpose()?;
        Ok(Self { window, names: query.stage.as_deref().map(|text| names("stage", text)).transpose()? })
    }

    /// Returns the selected parts of the pipeline, with at most `seconds` seconds.
    fn take(&self, picture: &PipelineSnapshot, seconds: usize) -> Pipeline {
        let seconds = self.window.map_or(seconds, |window| seconds.min(window as usize));
        let mut taken = Pipeline::new(picture, seconds);
        taken.windows.retain(|window| self.window.is_none_or(|wanted| window.seconds == wanted));
        let Some(names) = &self.names else { return taken };
        let wanted = |name: &str| names.iter().any(|known| known == name);
        for window in &mut taken.windows {
            window.values.retain(|value| wanted(&value.name));
            window.bounds.retain(|bound| wanted(&bound.stage));
            window.transfers.upload.take_if(|_| !wanted("upload"));
            window.transfers.download.take_if(|_| !wanted("download"));
        }
        for second in &mut taken.seconds {
            second.means.retain(|name, _| wanted(name));
            second.transfers.upload.take_if(|_| !wanted("upload"));
            second.transfers.download.take_if(|_| !wanted("download"));
        }
        taken
    }
}

/// Every pipeline that reported, with its figures over 1, 10 and 60 seconds.
#[utoipa::path(get, path = "/api/v1/pipelines", operation_id = "listPipelines", tag = "pipelines", params(Query), responses(
    (status = 200, body = PipelineList),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn list(
    State(app): State<App>,
    Parameters(query): Parameters<Query>,
) -> Result<Json<PipelineList>, WebError> {
    let part = Part::of(&query)?;
    let taken = |one: &PipelineSnapshot| part.take(one, PipelineList::SECONDS);
    Ok(Json(PipelineList::of(&app.picture(), taken)))
}

/// One pipeline with its last 600 seconds.
#[utoipa::path(get, path = "/api/v1/pipelines/{host}/{pipeline}", operation_id = "getPipeline", tag = "pipelines",
    params(
        ("host" = String, Path, description = "name of the host it senses on"),
        ("pipeline" = String, Path, description = "its name there"),
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
    let ((host, name), part) = (path(names)?, Part::of(&query)?);
    let picture = app.picture();
    let found =
        picture.pipelines.iter().find(|one| one.host_name.as_str() == host && one.pipeline.as_str() == name);
    found
        .map(|one| Json(part.take(one, HISTORY)))
        .ok_or_else(|| WebError::NotFound(format!("no pipeline {name} of host {host} has reported")))
}
