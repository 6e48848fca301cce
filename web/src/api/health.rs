//! For those who watch the aggregator itself.

use axum::extract::State;
use axum::http::StatusCode;
use peernet_aggregator::Readiness;

use crate::state::App;

/// Whether the process answers.
#[utoipa::path(get, path = "/healthz", operation_id = "isAlive", tag = "health", responses((status = 200, body = String, content_type = "text/plain")))]
pub(crate) async fn alive() -> &'static str {
    "alive\n"
}

/// Whether events are being stored.
#[utoipa::path(get, path = "/readyz", operation_id = "isReady", tag = "health", responses(
    (status = 200, description = "batches are stored and acknowledged", body = String, content_type = "text/plain"),
    (status = 503, description = "agents keep their events; the log says why", body = String, content_type = "text/plain"),
))]
pub(crate) async fn ready(State(app): State<App>) -> (StatusCode, &'static str) {
    match app.aggregator.ready() {
        Readiness::Ready => (StatusCode::OK, "ready\n"),
        Readiness::NotStoring(_) => {
            (StatusCode::SERVICE_UNAVAILABLE, "not storing: agents keep their events\n")
        }
    }
}
