//! The accept loop: what a connection may cost while it asks for nothing, and how all of them end.
//!
//! At most [`Limits::connections`] are open at a time; further ones wait in the kernel's queue until one closes. Of one
//! address at most [`Limits::per_address`] are open; further ones are closed at once.
//! Of the streams that go on for ever, at most [`Limits::streams`] are open and [`Limits::streams_per_address`] of one
//! address, so that they leave connections to all other requests; further ones are answered with 503.
//! A connection that does not complete the header of its first or next request within [`Limits::silence`] is
//! closed, whether it is idle or sends byte by byte.

use std::collections::HashMap;
use std::io;
use std::net::{IpAddr, Ipv6Addr};
use std::pin::pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use peernet_aggregator::LogThrottle;
use peernet_clock::SharedClock;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

use crate::error::WebError;

/// Most bytes read or written ahead on one connection.
const BUFFER: usize = 64 << 10;
/// Most bytes of a request's first line and headers together.
const HEADER: usize = 64 << 10;
/// Pause after an accept that failed for want of file descriptors or memory.
const SHORTAGE: Duration = Duration::from_secs(1);
/// Most streams of one address.
const STREAMS: usize = 32;

/// What connections may cost.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Connections open at a time.
    pub connections: usize,
    /// Of them those of one address, so that no single host can take all.
    pub per_address: usize,
    /// Streams open at a time.
    pub streams: usize,
    /// Of them those of one address.
    pub streams_per_address: usize,
    /// Longest time without a complete header while no request is in progress.
    pub silence: Duration,
    /// How long requests in progress may go on after the server was asked to stop.
    pub grace: Duration,
}

impl Limits {
    /// Those of a running server. The grace fits into the time that the whole process has for stopping.
    pub(crate) fn server(connections: usize) -> Self {
        let streams = (connections / 4).max(1);
        Self {
            connections,
            per_address: (connections / 4).max(1),
            streams,
            streams_per_address: (streams / 2).clamp(1, STREAMS),
            silence: Duration::from_secs(10),
            grace: Duration::from_millis(1_500),
        }
    }
}

/// Serves until `stop` is cancelled and every connection is closed, at the latest [`Limits::grace`] after it.
pub(crate) async fn accept(
    listener: TcpListener,
    router: Router,
    clock: SharedClock,
    stop: CancellationToken,
    limits: Limits,
) {
    let mut places = Places::new(limits, clock);
    let streams = Streams::new(limits);
    let open = TaskTracker::new();
    let cut = CancellationToken::new();
    while let Some((stream, place)) = stop.run_until_cancelled(places.next(&listener)).await {
        let streams = Streams { address: place.count.address, ..streams.clone() };
        let served = serve(stream, router.clone(), streams, stop.clone(), limits.silence);
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

/// What is open of each address, and how much may be.
#[derive(Clone, Debug)]
struct ByAddress {
    open: Arc<Mutex<HashMap<IpAddr, usize>>>,
    most: usize,
}

/// One that is counted under an address until it is dropped.
#[derive(Debug)]
struct Count {
    address: IpAddr,
    open: Arc<Mutex<HashMap<IpAddr, usize>>>,
}

impl ByAddress {
    fn new(most: usize) -> Self {
        Self { open: Arc::default(), most }
    }

    /// Counts one more of an address; `None` when that one has too many.
    fn take(&self, address: IpAddr) -> Option<Count> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let count = open.entry(address).or_default();
        if *count >= self.most {
            return None;
        }
        *count += 1;
        Some(Count { address, open: Arc::clone(&self.open) })
    }
}

impl Drop for Count {
    fn drop(&mut self) {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = open.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                open.remove(&self.address);
            }
        }
    }
}

/// The streams that may be open, in all and by address, as the requests of one connection find them.
#[derive(Clone, Debug)]
pub(crate) struct Streams {
    free: Arc<Semaphore>,
    most: usize,
    open: ByAddress,
    address: IpAddr,
}

/// The place of one open connection or stream; free again when dropped.
#[derive(Debug)]
pub(crate) struct Place {
    count: Count,
    _permit: OwnedSemaphorePermit,
}

impl Streams {
    fn new(limits: Limits) -> Self {
        Self {
            free: Arc::new(Semaphore::new(limits.streams)),
            most: limits.streams,
            open: ByAddress::new(limits.streams_per_address),
            address: Ipv6Addr::UNSPECIFIED.into(),
        }
    }

    /// The place of one more stream.
    pub(crate) fn take(&self) -> Result<Place, WebError> {
        let count = self.open.take(self.address).ok_or_else(|| {
            let most = self.open.most;
            WebError::TooManyStreams(format!(
                "{most} live streams are open from this address, as many as one may have; close one and try again"
            ))
        })?;
        let permit = Arc::clone(&self.free).try_acquire_owned().map_err(|_| {
            let most = self.most;
            WebError::TooManyStreams(format!(
                "{most} live streams are open, as many as there may be; try again when one has been closed"
            ))
        })?;
        Ok(Place { count, _permit: permit })
    }
}

/// The connections that may be open: in all and by address.
struct Places {
    free: Arc<Semaphore>,
    open: ByAddress,
    clock: SharedClock,
    log: LogThrottle,
}

impl Places {
    fn new(limits: Limits, clock: SharedClock) -> Self {
        let free = Arc::new(Semaphore::new(limits.connections));
        Self { free, open: ByAddress::new(limits.per_address), clock, log: LogThrottle::default() }
    }

    /// The next connection and its place, once there is one.
    async fn next(&mut self, listener: &TcpListener) -> (TcpStream, Place) {
        let now = self.clock.mono();
        if self.free.available_permits() == 0
            && let Some(times) = self.log.count("full", None, now)
        {
            tracing::warn!(
                times,
                "as many connections as allowed are open; further ones wait until one closes"
            );
        }
        let permit = Arc::clone(&self.free).acquire_owned().await.expect("the semaphore is never closed");
        loop {
            match listener.accept().await {
                Ok((stream, peer)) => match self.open.take(counted(peer.ip())) {
                    Some(count) => return (stream, Place { count, _permit: permit }),
                    None => self.refused(peer.ip()),
                },
                Err(error) if gone(&error) => {}
                Err(error) => {
                    if let Some(times) = self.log.count(&error.to_string(), None, self.clock.mono()) {
                        tracing::error!(times, %error, "cannot accept a connection; trying again");
                    }
                    tokio::time::sleep(SHORTAGE).await;
                }
            }
        }
    }

    fn refused(&mut self, peer: IpAddr) {
        if let Some(times) = self.log.count("address", Some(counted(peer)), self.clock.mono()) {
            let limit = self.open.most;
            tracing::warn!(times, %peer, limit, "closed a connection: its address has as many open as one may have");
        }
    }
}

/// The address under which a peer's connections are counted: of IPv6 the network, which is given to one host as a whole.
fn counted(peer: IpAddr) -> IpAddr {
    match peer.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() >> 64 << 64)),
        address @ IpAddr::V4(_) => address,
    }
}

/// Whether the other side gave up before it was accepted.
fn gone(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

async fn serve(
    stream: TcpStream,
    router: Router,
    streams: Streams,
    stop: CancellationToken,
    silence: Duration,
) {
    let asked = AtomicBool::new(false);
    let service = service_fn(|mut request: Request<Incoming>| {
        request.extensions_mut().insert(streams.clone());
        asked.store(true, Ordering::Relaxed);
        router.clone().oneshot(request)
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(silence)
        .max_buf_size(BUFFER)
        .max_header_size(HEADER)
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
