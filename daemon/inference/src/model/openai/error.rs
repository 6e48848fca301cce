//! Errors of a request to a server.

use std::time::Duration;

use peernet_sample::printable_line;
use peernet_statistics::number::counted;

use super::stream_error::StreamError;

/// Maximum length of a text of the server in a message, characters.
const MAX_TEXT_CHARS: usize = 500;

/// Reason why a request has no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum RequestError {
    /// No connection can be opened.
    #[error("cannot connect to its server: {0}; start the server, or correct url")]
    Connect(String),
    /// The server accepts connections, but does not answer.
    #[error(
        "its server accepts connections and did not answer GET {path} within {} ms; restart it, or correct url", .limit.as_millis()
    )]
    NoAnswer { path: String, limit: Duration },
    /// The TLS handshake failed.
    #[error("cannot open a TLS connection to its server {server}: {reason}; {remedy}")]
    Tls { server: String, reason: String, remedy: String },
    /// The connection broke. In this and the other variants, `chunk_count` is the number of chunks that had arrived.
    #[error(
        "the connection to its server broke after {}: {reason}; the server's log says why; the next request connects again",
        counted(*.chunk_count, "chunk")
    )]
    Connection { chunk_count: u64, reason: String },
    /// The first token did not arrive in time.
    #[error("its server sent no token within {} ms; raise first_token_timeout_ms if it needs longer", .0.as_millis())]
    FirstToken(Duration),
    /// A further token, or the end, did not arrive in time.
    #[error(
        "its server sent nothing for {} ms after {}; raise token_timeout_ms if it needs longer",
        .limit.as_millis(), counted(*.chunk_count, "chunk")
    )]
    Token { limit: Duration, chunk_count: u64 },
    /// The answer took too long.
    #[error(
        "its answer is not complete within {} ms, after {}; raise timeout_ms, or set max_tokens in parameters",
        .limit.as_millis(), counted(*.chunk_count, "chunk")
    )]
    Total { limit: Duration, chunk_count: u64 },
    /// The server refused the request.
    #[error("its server answered with HTTP status {status}{}; {}", after_colon(.text), status_remedy(*.status, .hint.as_deref()))]
    Status {
        status: hyper::StatusCode,
        text: String,
        /// Value of the header `Location` of a redirect, or `Retry-After` of any other answer.
        hint: Option<String>,
    },
    /// The answer is not streamed.
    #[error(
        "its server answered with {0} instead of text/event-stream; it must support \"stream\": true, and url must end \
         before /chat/completions"
    )]
    NotStreamed(String),
    /// The answer is compressed.
    #[error(
        "its server answered with Content-Encoding: {0}, although the request allows none; switch compression off in the server or its \
         proxy"
    )]
    Encoded(String),
    /// The stream is no complete answer.
    #[error("{}{}", .0, stream_remedy(.0))]
    Stream(#[from] StreamError),
}

impl RequestError {
    /// Returns whether the same request may succeed later without a change of the configuration: the server is not
    /// running, is still loading, or is overloaded.
    pub(super) fn is_transient(&self) -> bool {
        match self {
            Self::Connect(_)
            | Self::NoAnswer { .. }
            | Self::Connection { .. }
            | Self::FirstToken(_)
            | Self::Token { .. } => true,
            Self::Status { status, .. } => {
                status.is_server_error() || *status == hyper::StatusCode::TOO_MANY_REQUESTS
            }
            Self::Stream(
                StreamError::Server { .. } | StreamError::EndedEarly(_) | StreamError::WithoutText,
            ) => true,
            Self::Tls { .. }
            | Self::Total { .. }
            | Self::NotStreamed(_)
            | Self::Encoded(_)
            | Self::Stream(
                StreamError::Event { .. }
                | StreamError::NoDelta { .. }
                | StreamError::OtherChoice(_)
                | StreamError::NoEvents(_)
                | StreamError::EventTooLong
                | StreamError::TooLong(_),
            ) => false,
        }
    }

    /// Returns the message. Asterisks replace the secret, and the texts of the server are shortened.
    // A server may repeat the key that it refuses in any of these texts. The key is removed before a text is shortened,
    // because a shortened text could end within the key.
    pub(super) fn message(mut self, secret: Option<&str>) -> String {
        let secret = secret.filter(|secret| !secret.is_empty());
        let clean = |text: &mut String| {
            *text = shorten(&secret.map_or_else(|| text.clone(), |secret| text.replace(secret, "***")));
        };
        match &mut self {
            Self::Status { text, hint, .. } => {
                clean(text);
                hint.iter_mut().for_each(clean);
            }
            Self::Connect(text)
            | Self::NotStreamed(text)
            | Self::Encoded(text)
            | Self::Tls { reason: text, .. }
            | Self::Connection { reason: text, .. }
            | Self::Stream(
                StreamError::Server { text, .. }
                | StreamError::Event { reason: text, .. }
                | StreamError::OtherChoice(text),
            ) => {
                clean(text);
            }
            Self::FirstToken(_)
            | Self::NoAnswer { .. }
            | Self::Token { .. }
            | Self::Total { .. }
            | Self::Stream(
                StreamError::EndedEarly(_)
                | StreamError::WithoutText
                | StreamError::NoDelta { .. }
                | StreamError::NoEvents(_)
                | StreamError::EventTooLong
                | StreamError::TooLong(_),
            ) => {}
        }
        self.to_string()
    }
}

/// Returns a text in one line: line ends and control characters become spaces. A text of more than [`MAX_TEXT_CHARS`]
/// characters is cut off.
fn shorten(text: &str) -> String {
    let line = printable_line(text);
    match line.char_indices().nth(MAX_TEXT_CHARS) {
        Some((end, _)) => format!("{}…", &line[..end]),
        None => line.into_owned(),
    }
}

/// Returns a text after a colon; nothing for an empty text.
fn after_colon(text: &str) -> String {
    if text.is_empty() { String::new() } else { format!(": {text}") }
}

/// Returns what to do about an answer with this status. `hint` is the value of the header `Location` or `Retry-After`.
fn status_remedy(status: hyper::StatusCode, hint: Option<&str>) -> String {
    let lower_load = "lower the rate of the pipeline, or the number of workers";
    match (hint, status.as_u16()) {
        (Some(location), 300..=399) => {
            format!(
                "it redirects to {location}, and redirects are not followed: write the address of the API into url"
            )
        }
        (None, 300..=399) => "redirects are not followed: write the address of the API into url".to_owned(),
        (_, ..=299) => "a chat API answers with 200 and an event stream: check url".to_owned(),
        (Some(retry_after), _) if retry_after.bytes().all(|byte| byte.is_ascii_digit()) => {
            format!("the server asks to wait {retry_after} s; {lower_load}")
        }
        (Some(retry_after), _) => format!("the server asks to wait until {retry_after}; {lower_load}"),
        (None, 401 | 403) => "check the key in the environment variable that api_key_env names".to_owned(),
        (None, 404) => "check url and model".to_owned(),
        (None, 429) => lower_load.to_owned(),
        (None, 503) => "it may still be loading its model, or be overloaded; its log says why".to_owned(),
        (None, 500..) => "its log says why".to_owned(),
        (None, _) => "check parameters, and that the model accepts such samples".to_owned(),
    }
}

/// Returns what to do about a stream that is not a complete answer; empty if the error itself says what to do.
const fn stream_remedy(error: &StreamError) -> &'static str {
    match error {
        StreamError::Server { .. } | StreamError::EndedEarly(_) | StreamError::WithoutText => {
            "; the server's log says why"
        }
        StreamError::Event { .. }
        | StreamError::NoDelta { .. }
        | StreamError::OtherChoice(_)
        | StreamError::NoEvents(_) => "; url must name a server with the OpenAI API",
        StreamError::EventTooLong | StreamError::TooLong(_) => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "sk-abcdef123456";

    #[test]
    fn no_message_contains_secret() {
        let text = || format!("Bearer {KEY}");
        let errors = [
            RequestError::Connect(text()),
            RequestError::Tls { server: "gpu".to_owned(), reason: text(), remedy: String::new() },
            RequestError::Connection { chunk_count: 1, reason: text() },
            RequestError::Status {
                status: hyper::StatusCode::UNAUTHORIZED,
                text: text(),
                hint: Some(text()),
            },
            RequestError::NotStreamed(text()),
            RequestError::Encoded(text()),
            RequestError::Stream(StreamError::Server { chunk_count: 1, text: text() }),
            RequestError::Stream(StreamError::Event { number: 1, reason: text() }),
        ];
        for error in errors {
            let message = error.message(Some(KEY));
            assert!(message.contains("Bearer ***") && !message.contains("sk-"), "{message}");
        }
    }

    #[test]
    fn message_of_each_status_has_remedy() {
        let message = |status: u16, hint: Option<&str>| {
            let status = hyper::StatusCode::from_u16(status).expect("a status");
            let hint = hint.map(str::to_owned);
            RequestError::Status { status, text: String::new(), hint }.message(None)
        };
        for (status, remedy) in [
            (204, "; a chat API answers with 200"),
            (304, "; redirects are not followed"),
            (400, "; check parameters"),
            (401, "api_key_env"),
            (404, "; check url and model"),
            (429, "; lower the rate"),
            (500, "; its log says why"),
            (503, "; it may still be loading"),
        ] {
            assert!(message(status, None).contains(remedy), "{}", message(status, None));
        }
        assert!(message(429, Some("7")).ends_with(
            "; the server asks to wait 7 s; lower the rate of the pipeline, or the number of workers"
        ));
        assert!(message(503, Some("Wed")).contains("the server asks to wait until Wed; "));
    }

    #[test]
    fn secret_at_end_of_shortened_text_is_removed() {
        let text = format!("{}{KEY}", "ä".repeat(MAX_TEXT_CHARS - 5));
        let error = RequestError::Connection { chunk_count: 0, reason: text };
        let message = error.message(Some(KEY));
        assert!(message.contains("ä***; ") && !message.contains("sk-"), "{message}");
        let long = RequestError::NotStreamed("ä".repeat(600)).message(None);
        assert_eq!(long.matches('ä').count(), MAX_TEXT_CHARS);
    }
}
