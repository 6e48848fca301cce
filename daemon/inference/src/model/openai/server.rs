//! HTTP requests to a server with the OpenAI API.

use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Full};
use hyper::client::conn::http1::SendRequest;
use hyper::header::{
    ACCEPT, ACCEPT_ENCODING, AUTHORIZATION, CONTENT_TYPE, HOST, HeaderValue, InvalidHeaderValue, USER_AGENT,
};
use hyper::{Method, Request, StatusCode, Uri};
use hyper_util::rt::TokioIo;
use peernet_clock::SharedClock;
use tokio::time::timeout;

use super::answer::StreamedAnswer;
use super::connection::{Connection, Connector};
use super::error::RequestError;
use super::status_error::{content_encoding, status_error};
use super::time_limits::{AnswerDeadlines, TimeLimits};

/// Time limit for receiving the body of an answer with an error status.
const ERROR_TIMEOUT: Duration = Duration::from_secs(5);
/// Upper bound of the time limit for the check whether the server can be reached.
const CHECK_TIMEOUT: Duration = Duration::from_secs(10);

/// Address of a server, with the API key.
pub(super) struct Server {
    connector: Connector,
    /// Value of the header `Host`.
    authority: HeaderValue,
    /// Path of the API without a trailing slash, such as `/v1`.
    path: String,
    key: Option<ApiKey>,
}

/// API key, with which the server identifies the account.
pub(super) struct ApiKey {
    text: String,
    authorization: HeaderValue,
}

impl ApiKey {
    /// Creates a key.
    ///
    /// # Errors
    /// If the key has characters that a header cannot have.
    pub(super) fn new(text: String) -> Result<Self, InvalidHeaderValue> {
        let mut authorization = HeaderValue::try_from(format!("Bearer {text}"))?;
        // The libraries never print a sensitive value.
        authorization.set_sensitive(true);
        Ok(Self { text, authorization })
    }
}

impl Server {
    /// Creates a server from its URL, such as `http://127.0.0.1:8080/v1` or `https://gpu.example/v1`.
    ///
    /// # Errors
    /// Returns a description of the defect if the URL is invalid or, for `https://`, if the certificates of trusted
    /// authorities cannot be read.
    pub(super) fn new(url: &str, key: Option<ApiKey>) -> Result<Self, String> {
        let uri: Uri = url.parse().map_err(|error| format!("{url:?} is not a URL: {error}"))?;
        // A user name or a query may contain a secret, and the URL is published with the results.
        if uri.authority().is_some_and(|authority| authority.as_str().contains('@')) || uri.query().is_some()
        {
            return Err(
                "a URL with a user name or a query may contain a secret; name the key with api_key_env"
                    .to_owned(),
            );
        }
        let is_tls = match uri.scheme_str() {
            Some("http") => false,
            Some("https") => true,
            _ => return Err(format!("{url:?} does not begin with http:// or https://")),
        };
        let authority = uri.authority().ok_or_else(|| format!("{url:?} names no host"))?;
        let host = authority.host().trim_start_matches('[').trim_end_matches(']').to_owned();
        let header_value =
            HeaderValue::try_from(authority.as_str()).map_err(|error| format!("{url:?}: {error}"))?;
        let path = uri.path().trim_end_matches('/').to_owned();
        // The library accepts any text as a port. With the default port in its place, requests and the key would go to
        // another server.
        let port = match authority.as_str()[authority.host().len()..].trim_start_matches(':') {
            "" if is_tls => 443,
            "" => 80,
            text => text.parse().map_err(|_| format!("{url:?}: {text:?} is no port, 0 to 65535"))?,
        };
        let connector = if is_tls { Connector::tls(host, port)? } else { Connector::plain(host, port) };
        Ok(Self { connector, authority: header_value, path, key })
    }

    /// Returns the key, which must be removed from texts.
    pub(super) fn secret(&self) -> Option<&str> {
        self.key.as_ref().map(|key| key.text.as_str())
    }

    /// Checks that the server can be reached and accepts the key, by requesting the list of its models. A server that
    /// does not offer this list passes the check. The check ends within `limit`, and at the latest after ten seconds.
    ///
    /// # Errors
    /// If the server cannot be reached, does not answer, or refuses the key.
    pub(super) async fn check(&self, limit: Duration) -> Result<(), RequestError> {
        let limit = limit.min(CHECK_TIMEOUT);
        let request = self.request(Method::GET, "/models", Bytes::new())?;
        let mut is_connected = false;
        let check = async {
            let stream = self.connector.connect().await?;
            is_connected = true;
            exchange(stream, async |mut sender: SendRequest<Full<Bytes>>| {
                let response =
                    sender.send_request(request).await.map_err(|error| connection_error(0, &error))?;
                match response.status() {
                    StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => {
                        // Half of the limit remains, so that the error with the status is returned before the check
                        // itself times out.
                        Err(status_error(response, ERROR_TIMEOUT.min(limit / 2)).await)
                    }
                    // Any other status shows that the server can be reached; some servers have no list of models.
                    _ => Ok(()),
                }
            })
            .await
        };
        let result = timeout(limit, check).await;
        match result {
            Ok(result) => result,
            Err(_) if is_connected => {
                Err(RequestError::NoAnswer { path: format!("{}/models", self.path), limit })
            }
            Err(_) => Err(RequestError::Connect(format!(
                "no {} within {} ms",
                self.connector.connection_text(),
                limit.as_millis()
            ))),
        }
    }

    /// Sends a request for a chat completion and receives the streamed answer. Passes the text of the answer to
    /// `receive_text` as the text arrives.
    ///
    /// Each request opens a connection, so that no request fails because the server has closed an idle connection. The
    /// time that opening the connection takes, including the TLS handshake, is recorded.
    ///
    /// # Errors
    /// If the answer is incomplete. The text and the times that have arrived are in `answer`.
    pub(super) async fn complete(
        &self,
        body: Bytes,
        limits: &TimeLimits,
        clock: &SharedClock,
        answer: &mut StreamedAnswer,
        mut receive_text: impl FnMut(&str),
    ) -> Result<(), RequestError> {
        let request = self.request(Method::POST, "/chat/completions", body)?;
        let mut deadlines = AnswerDeadlines::new(limits, clock, answer.started_at);
        let stream = deadlines.within(answer, self.connector.connect()).await??;
        answer.connected_at = Some(clock.mono());
        exchange(stream, async |mut sender: SendRequest<Full<Bytes>>| {
            let response = deadlines.within(answer, sender.send_request(request)).await?;
            let mut response = response.map_err(|error| connection_error(0, &error))?;
            if response.status() != StatusCode::OK {
                let limit = deadlines.remaining(answer).0.min(ERROR_TIMEOUT);
                return Err(status_error(response, limit).await);
            }
            if let Some(encoding) = content_encoding(&response) {
                return Err(RequestError::Encoded(encoding));
            }
            let media = response.headers().get(CONTENT_TYPE).map_or(&b""[..], HeaderValue::as_bytes);
            if !media.to_ascii_lowercase().starts_with(b"text/event-stream") {
                let media = String::from_utf8_lossy(media);
                let media = if media.is_empty() { "no media type" } else { &media };
                return Err(RequestError::NotStreamed(media.to_owned()));
            }
            while !answer.is_done() {
                let frame = deadlines.within(answer, response.body_mut().frame()).await?;
                // The time of arrival is taken before the bytes are parsed.
                let arrived_at = clock.mono();
                match frame {
                    None => return Ok(answer.check_complete()?),
                    Some(Ok(frame)) => {
                        if let Some(bytes) = frame.data_ref() {
                            let chunks_before = answer.chunk_count();
                            answer.receive(arrived_at, bytes, &mut receive_text)?;
                            // `receive_text` may have waited for the requester. The time of this wait does not count
                            // against the server's limit.
                            if answer.chunk_count() > chunks_before {
                                deadlines.waiting_since = clock.mono();
                            }
                        }
                    }
                    // Some servers close the connection without ending the HTTP body.
                    Some(Err(_)) if answer.check_complete().is_ok() => return Ok(()),
                    Some(Err(error)) => return Err(connection_error(answer.chunk_count(), &error)),
                }
            }
            Ok(answer.check_complete()?)
        })
        .await
    }

    fn request(&self, method: Method, path: &str, body: Bytes) -> Result<Request<Full<Bytes>>, RequestError> {
        let mut request = Request::builder()
            .method(method)
            .uri(format!("{}{path}", self.path))
            .header(HOST, &self.authority)
            .header(USER_AGENT, concat!("peernet/", env!("CARGO_PKG_VERSION")))
            .header(ACCEPT, "text/event-stream, application/json")
            .header(ACCEPT_ENCODING, "identity")
            .header(CONTENT_TYPE, "application/json");
        if let Some(key) = &self.key {
            request = request.header(AUTHORIZATION, &key.authorization);
        }
        request
            .body(Full::new(body))
            .map_err(|error| RequestError::Connection { chunk_count: 0, reason: error.to_string() })
    }
}

/// Runs `send_requests`, which sends requests over a connection.
async fn exchange<R: AsyncFnOnce(SendRequest<Full<Bytes>>) -> Result<(), RequestError>>(
    stream: Box<dyn Connection>,
    send_requests: R,
) -> Result<(), RequestError> {
    let handshake = hyper::client::conn::http1::handshake(TokioIo::new(stream)).await;
    let (sender, connection) = handshake.map_err(|error| connection_error(0, &error))?;
    let requests = send_requests(sender);
    tokio::pin!(requests, connection);
    tokio::select! {
        result = &mut requests => result,
        // After the server has closed the connection, the rest of its answer may still have to be read.
        _ = &mut connection => requests.await,
    }
}

fn connection_error(chunk_count: u64, error: &hyper::Error) -> RequestError {
    // The library's text only says that the body could not be read. The source of the error says why.
    let cause = std::error::Error::source(error);
    let reason = cause.map_or_else(|| error.to_string(), |cause| format!("{error}: {cause}"));
    RequestError::Connection { chunk_count, reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn url_is_split_or_refused_with_reason() {
        for (url, expected) in
            [("http://[::1]:8080/v1/", ("[::1]:8080", "/v1")), ("http://gpu.local", ("gpu.local:80", ""))]
        {
            let server = Server::new(url, None).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!((&*server.connector.to_string(), &*server.path), expected);
        }
        for (url, reason) in [
            ("127.0.0.1:8080", "does not begin with http:// or https://"),
            ("http://me:hidden@gpu/v1", "api_key_env"),
            ("https://gpu/v1?key=hidden", "api_key_env"),
            ("https://a_b../v1", "is no host name"),
            ("http://a b", "is not a URL"),
            ("http://gpu:80800/v1", "\"80800\" is no port"),
            ("https://[::1]:8o80/v1", "\"8o80\" is no port"),
        ] {
            let error = Server::new(url, None).err().expect(reason);
            assert!(error.contains(reason) && !error.contains("hidden"), "{error}");
        }
    }
}
