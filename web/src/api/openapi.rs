//! `GET /api/openapi.json`.

use axum::Json;
use utoipa::OpenApi;

/// What stands above the resources.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "PEERNet",
        description = "Where an edge-cloud loop spends its time: live and stored measurements of all hosts. Values are in SI base units (seconds, bytes, bits per second), times in RFC 3339 and UTC. Errors are problem+json (RFC 9457)."
    ),
    components(schemas(
        crate::error::ProblemDetails,
        super::schema::PictureEvent,
        super::schema::StatusEvent
    ))
)]
struct Head;

pub(crate) fn head() -> utoipa::openapi::OpenApi {
    Head::openapi()
}

pub(crate) async fn serve(document: utoipa::openapi::OpenApi) -> Json<utoipa::openapi::OpenApi> {
    Json(document)
}
