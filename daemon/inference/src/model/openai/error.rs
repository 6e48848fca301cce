//! Errors of a request to a server.

use std::time::Duration;

use super::answer::{StreamError, chunks};

/// Reason why a request has no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum RequestError {
    /// No connection can be opened.
    #[error("cannot connect to its server: {0}; start the server, or correct url")]
    Connect(String),
    /// The TLS handshake failed.
    #[error("cannot open a TLS connection to its server {server}: {reason}; {remedy}")]
    Tls { server: String, reason: String, remedy: String },
    /// The connection broke.
    #[error("the connection to its server broke after {}: {reason}", chunks(*.after))]
    Connection { after: u64, reason: String },
    /// The first token did not arrive in time.
    #[error("its server sent no token within {} ms; raise first_token_timeout_ms if it needs longer", .0.as_millis())]
    FirstToken(Duration),
    /// A further token, or the end, did not arrive in time.
    #[error(
        "its server sent nothing for {} ms after {}; raise token_timeout_ms if it needs longer",
        .limit.as_millis(), chunks(*.after)
    )]
    Token { limit: Duration, after: u64 },
    /// The answer took too long.
    #[error(
        "its answer is not complete within {} ms, after {}; raise timeout_ms, or set max_tokens in parameters",
        .limit.as_millis(), chunks(*.after)
    )]
    Total { limit: Duration, after: u64 },
    /// The server refused the request.
    #[error("its server answered with HTTP status {status}{}{}", colon(.text), retry(.retry_after))]
    Status {
        status: hyper::StatusCode,
        text: String,
        /// Value of the header `Retry-After`.
        retry_after: Option<String>,
    },
    /// The answer is not streamed.
    #[error(
        "its server answered with {0} instead of text/event-stream; it must support \"stream\": true, and url must end \
         before /chat/completions"
    )]
    NotStreamed(String),
    /// The stream is no complete answer.
    #[error(transparent)]
    Stream(#[from] StreamError),
}

impl RequestError {
    /// Replaces a secret in the texts of the server by asterisks.
    // A server may repeat the key that it refuses.
    pub(super) fn without_secret(mut self, secret: Option<&str>) -> Self {
        let Some(secret) = secret.filter(|secret| !secret.is_empty()) else { return self };
        if let Self::Status { text, .. } | Self::Stream(StreamError::Server { text, .. }) = &mut self {
            *text = text.replace(secret, "***");
        }
        self
    }
}

fn colon(text: &str) -> String {
    if text.is_empty() { String::new() } else { format!(": {text}") }
}

fn retry(after: &Option<String>) -> String {
    match after {
        Some(after) if after.bytes().all(|byte| byte.is_ascii_digit()) => {
            format!("; it asks to wait {after} s: lower the rate of the pipeline, or the number of workers")
        }
        Some(after) => format!(
            "; it asks to wait until {after}: lower the rate of the pipeline, or the number of workers"
        ),
        None => String::new(),
    }
}
