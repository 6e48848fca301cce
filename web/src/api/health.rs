//! Health of the aggregator, for monitoring and orchestration.

use axum::Json;
use axum::extract::State;
use axum::http::header::{ACCEPT, RETRY_AFTER};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{AppendHeaders, IntoResponse, Response};
use peernet_aggregator::Readiness as AggregatorReadiness;
use serde::Serialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(alive)).routes(routes!(ready))
}

/// Answers `alive` as long as the process serves requests.
#[utoipa::path(get, path = "/healthz", operation_id = "isAlive", tag = "health", responses((status = 200, body = String, content_type = "text/plain")))]
async fn alive() -> &'static str {
    "alive\n"
}

/// Whether the aggregator stores events.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
struct Readiness {
    /// `true` if batches are stored and acknowledged.
    ready: bool,
    /// Reason why events are not stored; null when they are.
    reason: Option<String>,
}

/// Whether the aggregator stores events. The answer is JSON if the request accepts `application/json`, else text.
#[utoipa::path(get, path = "/readyz", operation_id = "isReady", tag = "health", responses(
    (status = 200, description = "batches are stored and acknowledged", content((String = "text/plain"), (Readiness = "application/json"))),
    (status = 503, description = "batches are not acknowledged and agents keep their events; the answer gives the reason", content((String = "text/plain"), (Readiness = "application/json"))),
))]
async fn ready(State(app): State<App>, headers: HeaderMap) -> Response {
    let reason = match app.aggregator.current_readiness() {
        AggregatorReadiness::Ready => None,
        AggregatorReadiness::NotStoring(reason) => Some(reason),
    };
    let answer = if accepts_json(&headers) {
        Json(Readiness { ready: reason.is_none(), reason: reason.clone() }).into_response()
    } else {
        let text = reason.as_ref().map_or_else(|| "ready\n".to_owned(), |why| format!("not ready: {why}\n"));
        text.into_response()
    };
    match reason {
        None => answer,
        Some(_) => {
            (StatusCode::SERVICE_UNAVAILABLE, AppendHeaders([(RETRY_AFTER, "2")]), answer).into_response()
        }
    }
}

/// Returns whether an `Accept` header names `application/json` with a quality above zero.
fn accepts_json(headers: &HeaderMap) -> bool {
    let values = headers.get_all(ACCEPT).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|kind| {
        let mut parts = kind.split(';').map(str::trim);
        parts.next().is_some_and(|kind| kind.eq_ignore_ascii_case("application/json"))
            && !parts.any(|parameter| matches!(parameter, "q=0" | "q=0.0" | "q=0.00" | "q=0.000"))
    })
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    #[test]
    fn json_is_sent_only_if_accept_names_it() {
        let accepts = |accept: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(ACCEPT, HeaderValue::from_static(accept));
            accepts_json(&headers)
        };
        for accept in
            ["application/json", "text/html, Application/JSON;q=0.5", "application/json; charset=utf-8"]
        {
            assert!(accepts(accept), "{accept}");
        }
        for accept in ["*/*", "text/plain", "application/json;q=0", "application/jsonx"] {
            assert!(!accepts(accept), "{accept}");
        }
        assert!(!accepts_json(&HeaderMap::new()));
    }
}
