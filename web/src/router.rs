//! All routes, and what surrounds them.

use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use axum::http::HeaderValue;
use axum::http::header::{
    CONTENT_SECURITY_POLICY, HeaderName, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{DefaultPredicate, NotForContentType, Predicate};
use tower_http::set_header::SetResponseHeaderLayer;
use tower_http::trace::TraceLayer;

use crate::error::{self, WebError};
use crate::state::App;
use crate::{access, api, assets, pages};

/// No inline script, no inline style, nothing from elsewhere.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; font-src 'self'; \
                      connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// Longest time until an answer begins. A stream may then go on for ever.
const PATIENCE: Duration = Duration::from_secs(30);

/// The whole server.
pub(crate) fn build(app: App) -> Router {
    let header = |name: HeaderName, value| {
        SetResponseHeaderLayer::if_not_present(name, HeaderValue::from_static(value))
    };
    let compressed = DefaultPredicate::new().and(NotForContentType::const_new("font/"));
    Router::new()
        .merge(pages::routes())
        .merge(api::routes())
        .route("/static/{version}/{name}", get(assets::serve))
        .fallback(error::no_such_page)
        .layer(middleware::from_fn(patience))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(middleware::from_fn(access::own_site))
        .layer(middleware::from_fn_with_state(app.clone(), access::guard))
        .layer(middleware::from_fn_with_state(app.clone(), error::dress))
        .layer(CompressionLayer::new().compress_when(compressed))
        .layer(header(CONTENT_SECURITY_POLICY, POLICY))
        .layer(header(X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(header(X_FRAME_OPTIONS, "DENY"))
        .layer(header(REFERRER_POLICY, "same-origin"))
        .layer(header(HeaderName::from_static("cross-origin-opener-policy"), "same-origin"))
        // Failures are logged by `WebError`, and an answer of 503 is not one: /readyz says so for as long as nothing is stored.
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
