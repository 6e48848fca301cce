//! All routes, and the layers around them.

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
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; font-src 'self'; \
                      connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// Longest time until an answer begins. A stream may last longer.
const PATIENCE: Duration = Duration::from_secs(30);

/// Paths, with all below them, that programs read: the API, Prometheus and supervisors.
const FOR_PROGRAMS: [&str; 4] = ["/api", "/metrics", "/healthz", "/readyz"];

/// Returns the whole server.
pub(crate) fn build(app: App) -> Router {
    let header = |name: HeaderName, value| {
        SetResponseHeaderLayer::if_not_present(name, HeaderValue::from_static(value))
    };
    let compressed = DefaultPredicate::new().and(NotForContentType::const_new("font/"));
    Router::new()
        .merge(pages::routes())
        .merge(api::routes())
        .route("/static/{version}/{name}", get(assets::serve))
        .fallback(no_such_page)
        .layer(middleware::from_fn(patience))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(middleware::from_fn(access::own_site))
        .layer(middleware::from_fn_with_state(app.clone(), access::guard))
        .layer(middleware::from_fn_with_state(app.clone(), render_error))
        .layer(CompressionLayer::new().compress_when(compressed))
        .layer(header(CONTENT_SECURITY_POLICY, POLICY))
        .layer(header(X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(header(X_FRAME_OPTIONS, "DENY"))
        .layer(header(REFERRER_POLICY, "same-origin"))
        .layer(header(HeaderName::from_static("cross-origin-opener-policy"), "same-origin"))
        // `WebError` logs failures. An answer of 503 is not a failure: /readyz returns it for as long as nothing is stored.
        .layer(TraceLayer::new_for_http().on_failure(()))
        .with_state(app)
}

async fn patience(request: Request, next: Next) -> Response {
    match tokio::time::timeout(PATIENCE, next.run(request)).await {
        Ok(response) => response,
        Err(_) => WebError::TookTooLong(PATIENCE.as_secs()).into_response(),
    }
}

#[expect(clippy::needless_pass_by_value, reason = "the signature is the layer's")]
fn panicked(panic: Box<dyn std::any::Any + Send>) -> Response {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without words");
    WebError::Panicked(text.to_owned()).into_response()
}

/// Returns whether the answers of a path are for programs and not for browsers.
fn is_for_programs(path: &str) -> bool {
    FOR_PROGRAMS
        .iter()
        .any(|root| path.strip_prefix(root).is_some_and(|rest| rest.is_empty() || rest.starts_with('/')))
}

/// Renders an error by its path, as problem+json where programs read and as a page elsewhere, including errors of the router itself.
async fn render_error(State(app): State<App>, request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    let mut response = next.run(request).await;
    let status = response.status();
    let problem = match response.extensions_mut().remove::<Arc<WebError>>() {
        Some(error) => error.to_problem(&app),
        None if status == StatusCode::METHOD_NOT_ALLOWED => {
            let allowed = response.headers().get(ALLOW).and_then(|methods| methods.to_str().ok());
            let text =
                format!("this address answers {} and nothing else", allowed.unwrap_or("other methods"));
            ProblemDetails::new(status, text, None)
        }
        None => return response,
    };
    let (form, body) = if is_for_programs(&path) {
        let body = serde_json::to_string(&problem).unwrap_or_default();
        ("application/problem+json", body)
    } else {
        ("text/html; charset=utf-8", pages::render_problem(&app, &problem))
    };
    let mut rendered = (status, [(CONTENT_TYPE, form)], body).into_response();
    if let Some(allowed) = response.headers().get(ALLOW) {
        rendered.headers_mut().insert(ALLOW, allowed.clone());
    }
    if status == StatusCode::SERVICE_UNAVAILABLE {
        rendered.headers_mut().insert(RETRY_AFTER, HeaderValue::from_static("2"));
    }
    rendered
}

/// Returns the answer for an address that is not there.
async fn no_such_page(request: Request) -> WebError {
    let path = request.uri().path();
    // A user may write edge and cloud as a folder and a file.
    let link = path
        .strip_prefix("/api/v1")
        .unwrap_or(path)
        .strip_prefix("/links/")
        .and_then(|it| it.split_once('/'));
    let hint = link.map_or_else(String::new, |(edge, rest)| {
        let cloud = rest.split('/').next().unwrap_or_default();
        format!("; a link is named EDGE~CLOUD, {edge}~{cloud} perhaps")
    });
    WebError::NotFound(format!("there is nothing at {path}{hint}"))
}
