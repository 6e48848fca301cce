//! The error type of all handlers, and the problem details (RFC 9457) that clients receive.
//!
//! Details of an internal error are logged under an id and never sent, since they may name files and other internals.

use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use peernet_store::StoreError;
use serde::Serialize;
use utoipa::ToSchema;

use crate::state::AppState;

/// Reason why a request fails.
#[derive(Debug, thiserror::Error)]
pub(crate) enum WebError {
    /// A parameter of the query or path is invalid; the text names it.
    #[error("{0}")]
    BadRequest(String),
    /// The requested item does not exist; the text names it.
    #[error("{0}")]
    NotFound(String),
    /// The Host header names a host that is not this server.
    #[error(
        "this server is not configured for the host name {0:?}: open it by its IP address, or add the name to server_names in the table [web]"
    )]
    OtherHost(String),
    /// The requested item was deleted; the text gives the reason.
    #[error("{0}")]
    Gone(String),
    /// A page of another site requests a change.
    #[error(
        "a page of {0} must not change data of this dashboard: only the dashboard's own pages and programs may change data; a reverse proxy must forward the Host header"
    )]
    OtherSite(String),
    /// The store returned an error.
    #[error("the query of the store failed")]
    Store(#[from] StoreError),
    /// A template could not be rendered.
    #[error("cannot render a page")]
    Render(#[from] askama::Error),
    /// An answer could not be written as JSON.
    #[error("cannot write an answer as JSON")]
    Json(#[from] serde_json::Error),
    /// An answer could not be written as text.
    #[error("cannot write an answer as text")]
    Text(#[from] fmt::Error),
    /// The limit of live streams is reached; the text names the limit.
    #[error("{0}")]
    TooManyStreams(String),
    /// No answer began within the response timeout of this many seconds.
    #[error("the request was not answered within {0} s")]
    TookTooLong(u64),
    /// A handler panicked.
    #[error("a handler panicked: {0}")]
    Panicked(String),
}

impl WebError {
    /// Returns the error for a run that is not stored.
    pub(crate) fn no_run(number: i64) -> Self {
        Self::NotFound(format!("no run {number} is stored"))
    }
}

/// A problem as programs receive it (RFC 9457).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct ProblemDetails {
    /// Always `about:blank`: the status gives the type of the problem.
    #[serde(rename = "type")]
    kind: &'static str,
    /// The reason phrase of the status.
    title: String,
    /// The HTTP status code.
    status: u16,
    /// Description of the problem with this request, and of what to do about it.
    detail: String,
    /// Identifier of the cause in the server's log, for problems of the server.
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<String>,
}

impl ProblemDetails {
    pub(crate) fn new(status: StatusCode, detail: String, id: Option<String>) -> Self {
        let title = status.canonical_reason().unwrap_or("Unknown").to_owned();
        Self { kind: "about:blank", title, status: status.as_u16(), detail, id }
    }
}

impl WebError {
    fn status(&self) -> StatusCode {
        match self {
            Self::BadRequest(_) => StatusCode::BAD_REQUEST,
            Self::NotFound(_) => StatusCode::NOT_FOUND,
            Self::Gone(_) => StatusCode::GONE,
            Self::OtherSite(_) => StatusCode::FORBIDDEN,
            Self::OtherHost(_) => StatusCode::MISDIRECTED_REQUEST,
            Self::TookTooLong(_)
            | Self::TooManyStreams(_)
            | Self::Store(StoreError::TooLong { .. } | StoreError::Busy { .. } | StoreError::Closed { .. }) => {
                StatusCode::SERVICE_UNAVAILABLE
            }
            Self::Store(_) | Self::Render(_) | Self::Json(_) | Self::Text(_) | Self::Panicked(_) => {
                StatusCode::INTERNAL_SERVER_ERROR
            }
        }
    }

    /// Converts the error to the answer for the client. Logs the details that the answer omits; a repeated failure is logged once a
    /// minute, with a count.
    pub(crate) fn to_problem(&self, app: &AppState) -> ProblemDetails {
        let status = self.status();
        if !status.is_server_error() {
            return ProblemDetails::new(status, self.to_string(), None);
        }
        // The texts of the next two kinds of error contain the whole cause. They go to the client, so the client needs no id to find the
        // cause in the log.
        if let Self::TooManyStreams(text) = self {
            if let Some(times) = app.count_failure(text) {
                tracing::warn!(times, error = text, "refused a live stream");
            }
            return ProblemDetails::new(status, text.clone(), None);
        }
        if let Self::Store(
            error @ (StoreError::TooLong { .. } | StoreError::Busy { .. } | StoreError::Closed { .. }),
        ) = self
        {
            let text = error.to_string();
            if let Some(times) = app.count_failure(&text) {
                tracing::warn!(times, error = text, "a query of the store was not answered");
            }
            return ProblemDetails::new(status, text, None);
        }
        let text = ErrorChain(self).to_string();
        // The same failure always has the same id. The id is therefore in the log even if this occurrence is not logged.
        let id = text_id(&text);
        if let Some(times) = app.count_failure(&text) {
            if matches!(self, Self::TookTooLong(_)) {
                tracing::warn!(id, times, error = text, "a request timed out");
            } else {
                tracing::error!(id, times, error = text, "a request failed");
            }
        }
        let detail = match self {
            // The text of this error names no internals, so clients may see it. /readyz shows the same text.
            Self::Store(error @ StoreError::Damaged { .. }) => &error.to_string(),
            Self::Store(_) => &format!(
                "the stored data could not be read; the aggregator's log has the cause under the id {id}"
            ),
            Self::TookTooLong(_) => "the answer took too long; try again, or request less data",
            _ => &format!("an internal error occurred; the aggregator's log has the cause under the id {id}"),
        };
        ProblemDetails::new(status, detail.to_owned(), Some(id))
    }
}

/// Returns twelve hexadecimal digits that identify a text.
fn text_id(text: &str) -> String {
    // `DefaultHasher::new()` has no random key, so a restart of the same program keeps the ids.
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    format!("{:012x}", hasher.finish() >> 16)
}

/// An error with its causes, for the log.
struct ErrorChain<'a>(&'a dyn std::error::Error);

impl fmt::Display for ErrorChain<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)?;
        let mut cause = self.0.source();
        while let Some(error) = cause {
            write!(f, ": {error}")?;
            cause = error.source();
        }
        Ok(())
    }
}

impl IntoResponse for WebError {
    /// Converts the error to a response without a body. The router adds the body in the form that suits the path.
    fn into_response(self) -> Response {
        let mut response = self.status().into_response();
        response.extensions_mut().insert(Arc::new(self));
        response
    }
}

impl ProblemDetails {
    pub(crate) fn status(&self) -> u16 {
        self.status
    }
    pub(crate) fn title(&self) -> &str {
        &self.title
    }
    pub(crate) fn detail(&self) -> &str {
        &self.detail
    }
    pub(crate) fn id(&self) -> Option<&str> {
        self.id.as_deref()
    }
}
