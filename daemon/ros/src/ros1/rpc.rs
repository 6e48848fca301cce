//! XML-RPC over HTTP: the client and the server of a node.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::Incoming;
use hyper::header::{CONTENT_TYPE, HOST, USER_AGENT};
use hyper::service::service_fn;
use hyper::{Method, Request, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use thiserror::Error;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::environment::{RpcUri, uri_host};
use super::xmlrpc::{
    Call, ParseError, Response, Value, parse_call, parse_response, write_call, write_response,
};

/// Time limit for a call, including connecting.
pub(super) const CALL_TIMEOUT: Duration = Duration::from_secs(3);

/// Longest accepted answer, bytes. The system state of a large robot has some hundred kilobytes.
const MAX_RESPONSE_BYTES: usize = 16 * 1024 * 1024;

/// Longest accepted call, bytes. The longest call contains the list of a topic's publishers.
const MAX_CALL_BYTES: usize = 256 * 1024;

/// Maximum number of connections to the server. Further connections wait to be accepted.
const MAX_CONNECTIONS: usize = 64;

/// Longest silence of a connection before and between calls, and time limit for the arrival of a call.
const IDLE_TIMEOUT: Duration = Duration::from_secs(30);

/// Error: a call has no result.
#[derive(Debug, Error)]
pub enum RpcError {
    /// The connection was refused or broke.
    #[error("{reason}")]
    Connection {
        /// Reason.
        reason: String,
    },
    /// The call was not answered in time.
    #[error("no answer within {} s", CALL_TIMEOUT.as_secs())]
    TimedOut,
    /// The HTTP status is not 200.
    #[error("HTTP status {status}")]
    Status {
        /// The status.
        status: StatusCode,
    },
    /// The answer is not XML-RPC.
    #[error("the answer is not XML-RPC: {0}")]
    Parse(#[from] ParseError),
    /// The method failed.
    #[error("fault {code}: {text}")]
    Fault {
        /// Number of the fault.
        code: i64,
        /// Reason.
        text: String,
    },
}

impl RpcError {
    #[expect(clippy::needless_pass_by_value, reason = "map_err passes the error by value")]
    fn connection(error: impl ToString) -> Self {
        Self::Connection { reason: error.to_string() }
    }
}

/// Calls a method and returns its result.
///
/// Each call opens a connection. A node makes few calls, and an open connection would break when the peer ends.
///
/// # Errors
/// If the peer is not reachable, does not answer in time, or answers with a fault.
pub(super) async fn call(uri: &RpcUri, method: &str, params: Vec<Value>) -> Result<Value, RpcError> {
    let xml = write_call(&Call { method: method.to_owned(), params });
    let body = timeout(CALL_TIMEOUT, post_call(uri, xml.into())).await.map_err(|_| RpcError::TimedOut)??;
    match parse_response(&body)? {
        Response::Success(value) => Ok(value),
        Response::Fault { code, text } => Err(RpcError::Fault { code, text }),
    }
}

/// Sends a call over a new connection. Returns the body of the answer.
async fn post_call(uri: &RpcUri, xml: Bytes) -> Result<Bytes, RpcError> {
    let stream = TcpStream::connect((uri.host(), uri.port())).await.map_err(RpcError::connection)?;
    stream.set_nodelay(true).map_err(RpcError::connection)?;
    let (mut sender, connection) =
        hyper::client::conn::http1::handshake(TokioIo::new(stream)).await.map_err(RpcError::connection)?;
    let request = Request::builder()
        .method(Method::POST)
        .uri(uri.path())
        // HTTP/1.1 requires this header (RFC 9112, section 3.2), and hyper's low-level client does not add it.
        .header(HOST, format!("{}:{}", uri_host(uri.host()), uri.port()))
        .header(USER_AGENT, concat!("peernet/", env!("CARGO_PKG_VERSION")))
        .header(CONTENT_TYPE, "text/xml")
        .body(Full::new(xml))
        .map_err(RpcError::connection)?;
    let receive_body = async move {
        let response = sender.send_request(request).await.map_err(RpcError::connection)?;
        let status = response.status();
        if status != StatusCode::OK {
            return Err(RpcError::Status { status });
        }
        let body = Limited::new(response.into_body(), MAX_RESPONSE_BYTES).collect().await;
        Ok(body.map_err(RpcError::connection)?.to_bytes())
    };
    tokio::pin!(receive_body, connection);
    tokio::select! {
        result = &mut receive_body => result,
        // The peer may close the connection before its answer has been read.
        _ = &mut connection => receive_body.await,
    }
}

/// Serves calls until `stop` is cancelled. `answer` must not block.
pub(super) async fn serve(
    listener: TcpListener,
    answer: impl Fn(&Call) -> Response + Send + Sync + 'static,
    stop: CancellationToken,
) {
    let answer = Arc::new(answer);
    let permits = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok(permit) = Arc::clone(&permits).acquire_owned().await else { return };
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stop.cancelled() => return,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection to the ROS node's XML-RPC server");
                // The process may be out of descriptors, and accepting would fail again at once.
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let (answer, stop) = (Arc::clone(&answer), stop.clone());
        tokio::spawn(async move {
            let _permit = permit;
            // If this fails, only the latency increases.
            let _ = stream.set_nodelay(true);
            let service = service_fn(|request| respond(request, &*answer));
            let connection = hyper::server::conn::http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(IDLE_TIMEOUT)
                .serve_connection(TokioIo::new(stream), service);
            tokio::select! {
                result = connection => if let Err(error) = result {
                    tracing::debug!(%error, "a connection to the ROS node's XML-RPC server failed");
                },
                () = stop.cancelled() => {}
            }
        });
    }
}

/// Reads a call, and returns the HTTP response with its answer.
async fn respond(
    request: Request<Incoming>,
    answer: &(dyn Fn(&Call) -> Response + Send + Sync),
) -> Result<hyper::Response<Full<Bytes>>, Infallible> {
    let body = Limited::new(request.into_body(), MAX_CALL_BYTES).collect();
    let call = match timeout(IDLE_TIMEOUT, body).await {
        Ok(Ok(body)) => parse_call(&body.to_bytes()).map_err(|error| error.to_string()),
        Ok(Err(error)) => Err(error.to_string()),
        Err(_) => Err(format!("the call did not arrive within {} s", IDLE_TIMEOUT.as_secs())),
    };
    let response = match call {
        Ok(call) => answer(&call),
        Err(text) => Response::Fault { code: -1, text },
    };
    let mut response = hyper::Response::new(Full::new(write_response(&response).into()));
    response.headers_mut().insert(CONTENT_TYPE, hyper::header::HeaderValue::from_static("text/xml"));
    Ok(response)
}
