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

/// Longest duration of a call, with connecting.
pub(super) const CALL_TIMEOUT: Duration = Duration::from_secs(3);

/// Longest answer that is read: the system state of a large robot is some hundred kilobytes.
const MAX_RESPONSE_BYTES: usize = 16 * 1024 * 1024;

/// Longest call that is read: the list of a topic's publishers is the longest.
const MAX_CALL_BYTES: usize = 256 * 1024;

/// Connections to the server at a time. More wait to be accepted.
const MAX_CONNECTIONS: usize = 64;

/// Longest silence of a connection before and between calls, and longest duration in which a call may arrive.
const IDLE_TIMEOUT: Duration = Duration::from_secs(30);

/// A call without a result.
#[derive(Debug, Error)]
pub enum RpcError {
    /// The connection is refused, or it breaks.
    #[error("{reason}")]
    Connection {
        /// Reason.
        reason: String,
    },
    /// It takes too long.
    #[error("no answer within {} s", CALL_TIMEOUT.as_secs())]
    TimedOut,
    /// An HTTP status other than 200.
    #[error("HTTP status {status}")]
    Status {
        /// The status.
        status: StatusCode,
    },
    /// The answer is no XML-RPC.
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
    #[expect(clippy::needless_pass_by_value, reason = "what map_err calls takes a value")]
    fn connection(error: impl ToString) -> Self {
        Self::Connection { reason: error.to_string() }
    }
}

/// Calls a method and returns its result.
///
/// Each call opens a connection: a node makes few calls, and a kept connection would break with the peer.
///
/// # Errors
/// The peer is not there, takes too long, or answers with a fault.
pub(super) async fn call(uri: &RpcUri, method: &str, params: Vec<Value>) -> Result<Value, RpcError> {
    let xml = write_call(&Call { method: method.to_owned(), params });
    let body = timeout(CALL_TIMEOUT, exchange(uri, xml.into())).await.map_err(|_| RpcError::TimedOut)??;
    match parse_response(&body)? {
        Response::Success(value) => Ok(value),
        Response::Fault { code, text } => Err(RpcError::Fault { code, text }),
    }
}

async fn exchange(uri: &RpcUri, xml: Bytes) -> Result<Bytes, RpcError> {
    let stream = TcpStream::connect((uri.host(), uri.port())).await.map_err(RpcError::connection)?;
    stream.set_nodelay(true).map_err(RpcError::connection)?;
    let (mut sender, connection) =
        hyper::client::conn::http1::handshake(TokioIo::new(stream)).await.map_err(RpcError::connection)?;
    let request = Request::builder()
        .method(Method::POST)
        .uri(uri.path())
        .header(HOST, format!("{}:{}", uri_host(uri.host()), uri.port()))
        .header(USER_AGENT, concat!("peernet/", env!("CARGO_PKG_VERSION")))
        .header(CONTENT_TYPE, "text/xml")
        .body(Full::new(xml))
        .map_err(RpcError::connection)?;
    let exchange = async move {
        let response = sender.send_request(request).await.map_err(RpcError::connection)?;
        let status = response.status();
        if status != StatusCode::OK {
            return Err(RpcError::Status { status });
        }
        let body = Limited::new(response.into_body(), MAX_RESPONSE_BYTES).collect().await;
        Ok(body.map_err(RpcError::connection)?.to_bytes())
    };
    tokio::pin!(exchange, connection);
    tokio::select! {
        result = &mut exchange => result,
        // The peer closes after its answer, which may not have been taken yet.
        _ = &mut connection => exchange.await,
    }
}

/// Serves calls until `stop` is cancelled. `answer` must not block.
pub(super) async fn serve(
    listener: TcpListener,
    answer: impl Fn(&Call) -> Response + Send + Sync + 'static,
    stop: CancellationToken,
) {
    let answer = Arc::new(answer);
    let places = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else { return };
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stop.cancelled() => return,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection to the ROS node's XML-RPC server");
                // Out of descriptors, for example: it would fail again at once.
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let (answer, stop) = (Arc::clone(&answer), stop.clone());
        tokio::spawn(async move {
            let _place = place;
            // A failure shows in latency only.
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

async fn respond(
    request: Request<Incoming>,
    answer: &(dyn Fn(&Call) -> Response + Send + Sync),
) -> Result<hyper::Response<Full<Bytes>>, Infallible> {
    let body = Limited::new(request.into_body(), MAX_CALL_BYTES).collect();
    let call = match timeout(IDLE_TIMEOUT, body).await {
        Ok(Ok(body)) => parse_call(&body.to_bytes()).map_err(|error| error.to_string()),
        Ok(Err(error)) => Err(error.to_string()),
        Err(_) => Err("the call took too long to arrive".to_owned()),
    };
    let response = match call {
        Ok(call) => answer(&call),
        Err(text) => Response::Fault { code: -1, text },
    };
    let mut response = hyper::Response::new(Full::new(write_response(&response).into()));
    response.headers_mut().insert(CONTENT_TYPE, hyper::header::HeaderValue::from_static("text/xml"));
    Ok(response)
}
