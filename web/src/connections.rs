//! The accept loop: what a connection may cost while it asks for nothing, and how all of them end.
//!
//! At most [`Limits::connections`] are open at a time; further ones wait in the kernel's queue until one closes.
//! A connection that does not complete the header of its first or next request within [`Limits::silence`] is
//! closed, whether it is idle or sends byte by byte.

use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

/// Most bytes read or written ahead on one connection; a longer header is refused.
const BUFFER: usize = 64 << 10;
/// Pause after an accept that failed for want of file descriptors or memory.
const SHORTAGE: Duration = Duration::from_secs(1);

/// What connections may cost.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Connections open at a time.
    pub connections: usize,
    /// Longest time without a complete header while no request is in progress.
    pub silence: Duration,
    /// How long requests in progress may go on after the server was asked to stop.
    pub grace: Duration,
}

impl Limits {
    /// Those of a running server. The grace fits into the time that the whole process has for stopping.
    pub(crate) const SERVER: Self =
        Self { connections: 1_024, silence: Duration::from_secs(10), grace: Duration::from_millis(1_500) };
}

/// Serves until `stop` is cancelled and every connection is closed, at the latest [`Limits::grace`] after it.
pub(crate) async fn accept(listener: TcpListener, router: Router, stop: CancellationToken, limits: Limits) {
    let places = Arc::new(Semaphore::new(limits.connections));
    let open = TaskTracker::new();
    let cut = CancellationToken::new();
    let mut full = false;
    while let Some((stream, place)) = stop.run_until_cancelled(next(&listener, &places, &mut full)).await {
        let served = serve(stream, router.clone(), stop.clone(), limits.silence);
        let cut = cut.clone();
        open.spawn(async move {
            cut.run_until_cancelled(served).await;
            drop(place);
        });
    }
    drop(listener);
    open.close();
    if tokio::time::timeout(limits.grace, open.wait()).await.is_err() {
        let requests = open.len();
        tracing::warn!(requests, grace = ?limits.grace, "requests were still open after the web server was asked to stop");
        cut.cancel();
        open.wait().await;
    }
}

/// The next connection and its place among those that may be open. `full` remembers that none was free, so that
/// it is told once and not for every connection.
async fn next(
    listener: &TcpListener,
    places: &Arc<Semaphore>,
    full: &mut bool,
) -> (TcpStream, OwnedSemaphorePermit) {
    let was_full = std::mem::replace(full, places.available_permits() == 0);
    if *full && !was_full {
        tracing::warn!("as many connections as allowed are open; further ones wait until one closes");
    }
    let place = Arc::clone(places).acquire_owned().await.expect("the semaphore is never closed");
    loop {
        match listener.accept().await {
            Ok((stream, _)) => return (stream, place),
            Err(error) if gone(&error) => {}
            Err(error) => {
                tracing::error!(%error, "cannot accept a connection; trying again");
                tokio::time::sleep(SHORTAGE).await;
            }
        }
    }
}

/// Whether the other side gave up before it was accepted.
fn gone(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

async fn serve(stream: TcpStream, router: Router, stop: CancellationToken, silence: Duration) {
    let asked = AtomicBool::new(false);
    let service = service_fn(|request: Request<Incoming>| {
        asked.store(true, Ordering::Relaxed);
        router.clone().oneshot(request)
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(silence)
        .max_buf_size(BUFFER)
        .serve_connection(TokioIo::new(stream), service);
    let mut connection = pin!(connection);
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = stop.cancelled() => {
            // A connection that is idle closes when told so; one in the middle of its first header would wait for
            // the rest of it.
            if !asked.load(Ordering::Relaxed) {
                return;
            }
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "a connection ended early");
    }
}

#[cfg(test)]
#[path = "connections_tests.rs"]
mod tests;
