//! All routes, and the middleware layers around them.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::header::{
    ALLOW, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderName, REFERRER_POLICY, RETRY_AFTER,
    X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{DefaultPredicate, NotForContentType, Predicate};
use tower_http::set_header::SetResponseHeaderLayer;
use tower_http::trace::TraceLayer;

use crate::error::{ProblemDetails, WebError};
use crate::state::App;
use crate::{access, api, assets, pages};

/// Content security policy: no inline script, no inline style, nothing from other sites.
const SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; font-src 'self'; \
                      connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// Maximum time until the first byte of an answer. A stream may last longer.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(30);

/// Path prefixes of answers for programs: the API, metrics and health checks. Errors below them are problem+json.
const MACHINE_PATHS: [&str; 4] = ["/api", "/metrics", "/healthz", "/readyz"];

/// Returns the routes with all layers.
pub(crate) fn build_router(app: App) -> Router {
    let header = |name: HeaderName, value| {
        SetResponseHeaderLayer::if_not_present(name, HeaderValue::from_static(value))
    };
    // The fonts are compressed already.
    let compress_predicate = DefaultPredicate::new().and(NotForContentType::const_new("font/"));
    // Each layer encloses the layers above it: `render_error` sees the errors of all layers above, and the
    // headers are in every answer.
    Router::new()
        .merge(pages::routes())
        .merge(api::routes())
        .route("/static/{version}/{name}", get(assets::serve))
        .fallback(not_found)
        .layer(middleware::from_fn(limit_response_time))
        .layer(CatchPanicLayer::custom(respond_to_panic))
        .layer(middleware::from_fn(access::reject_cross_site_changes))
        .layer(middleware::from_fn_with_state(app.clone(), access::reject_unknown_host_names))
        .layer(middleware::from_fn_with_state(app.clone(), render_error))
        .layer(CompressionLayer::new().compress_when(compress_predicate))
        .layer(header(CONTENT_SECURITY_POLICY, SECURITY_POLICY))
        .layer(header(X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(header(X_FRAME_OPTIONS, "DENY"))
        .layer(header(REFERRER_POLICY, "same-origin"))
        .layer(header(HeaderName::from_static("cross-origin-opener-policy"), "same-origin"))
        // This layer logs no failures. `WebError` logs them, and an answer of 503 is not always a failure: /readyz
        // returns it while events are not being stored.
        .layer(TraceLayer::new_for_http().on_failure(()))
        .with_state(app)
}

/// Answers 503 if no answer began within [`RESPONSE_TIMEOUT`].
async fn limit_response_time(request: Request, next: Next) -> Response {
    match tokio::time::timeout(RESPONSE_TIMEOUT, next.run(request)).await {
        Ok(response) => response,
        Err(_) => WebError::TookTooLong(RESPONSE_TIMEOUT.as_secs()).into_response(),
    }
}

#[expect(clippy::needless_pass_by_value, reason = "`CatchPanicLayer` prescribes the signature")]
fn respond_to_panic(panic: Box<dyn std::any::Any + Send>) -> Response {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no panic message");
    WebError::Panicked(text.to_owned()).into_response()
}

/// Returns whether the answers of a path are for programs and not for browsers.
fn is_machine_path(path: &str) -> bool {
    MACHINE_PATHS
        .iter()
        .any(|root| path.strip_prefix(root).is_some_and(|rest| rest.is_empty() || rest.starts_with('/')))
}

/// Renders an error as problem+json below [`MACHINE_PATHS`] and as a page elsewhere. This includes errors of the router itself, such as
/// an unsupported method.
async fn render_error(State(app): State<App>, request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    let mut response = next.run(request).await;
    let status = response.status();
    let problem = match response.extensions_mut().remove::<Arc<WebError>>() {
        Some(error) => error.to_problem(&app),
        None if status == StatusCode::METHOD_NOT_ALLOWED => {
            let allowed = response.headers().get(ALLOW).and_then(|methods| methods.to_str().ok());
            let text = format!("this address supports only {}", allowed.unwrap_or("other methods"));
            ProblemDetails::new(status, text, None)
        }
        None => return response,
    };
    let (content_type, body) = if is_machine_path(&path) {
        let body = serde_json::to_string(&problem).unwrap_or_default();
        ("application/problem+json", body)
    } else {
        ("text/html; charset=utf-8", pages::render_problem(&app, &problem))
    };
    let mut rendered = (status, [(CONTENT_TYPE, content_type)], body).into_response();
    if let Some(allowed) = response.headers().get(ALLOW) {
        rendered.headers_mut().insert(ALLOW, allowed.clone());
    }
    if status == StatusCode::SERVICE_UNAVAILABLE {
        rendered.headers_mut().insert(RETRY_AFTER, HeaderValue::from_static("2"));
    }
    rendered
}

/// Returns the error for a path without a route.
async fn not_found(request: Request) -> WebError {
    let path = request.uri().path();
    // Users may try /links/EDGE/CLOUD, but the name of a link is one path segment.
    let link = path
        .strip_prefix("/api/v1")
        .unwrap_or(path)
        .strip_prefix("/links/")
        .and_then(|rest| rest.split_once('/'));
    let hint = link.map_or_else(String::new, |(edge, rest)| {
        let cloud = rest.split('/').next().unwrap_or_default();
        format!("; a link is named EDGE~CLOUD, so try {edge}~{cloud}")
    });
    WebError::NotFound(format!("no page or resource has the path {path}{hint}"))
}
