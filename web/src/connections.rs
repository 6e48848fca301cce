//! The accept loop, the limits of a connection that sends no request, and the shutdown of all connections.
//!
//! At most [`Limits::connections`] are open at a time, and addresses share them ([`FairPlaces`]): a further connection closes the oldest
//! one of the address that has most, or is closed itself.
//! Streams never end: at most [`Limits::streams`] are open, shared in the same way, and [`Limits::streams_per_address`] of
//! one address, so that connections and processor time remain for all other requests; further streams are answered with 503.
//! A connection that does not complete the header of its first or next request within [`Limits::silence`] is closed, whether it is idle
//! or sends byte by byte. A connection whose peer reads nothing for [`Limits::unread`] is closed as well.

use std::io;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use peernet_clock::{LogThrottle, SharedClock};
use peernet_networks::AddressGroup;
use socket2::SockRef;
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

use crate::error::WebError;
use crate::fair_places::{FairPlaces, NoPlace, Place};

/// Largest number of bytes read or written ahead on one connection.
const BUFFER: usize = 64 << 10;
/// Largest size of a request's first line and headers together, bytes.
const HEADER: usize = 64 << 10;
/// Pause after an accept that failed because file descriptors or memory were exhausted.
const SHORTAGE: Duration = Duration::from_secs(1);
/// Largest number of streams of one address. Each makes the server compute an update four times a second.
const STREAMS: usize = 32;

/// Limits of connections.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Connections open at a time.
    pub connections: usize,
    /// Streams open at a time.
    pub streams: usize,
    /// Streams open at a time from one address.
    pub streams_per_address: usize,
    /// Longest time without a complete header while no request is in progress.
    pub silence: Duration,
    /// Longest time that a peer may leave sent data unread (`TCP_USER_TIMEOUT`).
    pub unread: Duration,
    /// Longest time that requests in progress may take after the server was asked to stop.
    pub grace: Duration,
}

impl Limits {
    /// Limits of a running server. The grace is shorter than the time that the whole process has for stopping.
    pub(crate) fn server(connections: usize) -> Self {
        Self {
            connections,
            streams: connections / 4,
            streams_per_address: STREAMS,
            silence: Duration::from_secs(10),
            unread: Duration::from_secs(30),
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
    let places = FairPlaces::new(limits.connections, usize::MAX);
    let streams = FairPlaces::new(limits.streams, limits.streams_per_address);
    let open = TaskTracker::new();
    let cut = CancellationToken::new();
    let mut acceptor = Acceptor { places, cut: cut.clone(), clock, log: LogThrottle::default() };
    while let Some(accepted) = stop.run_until_cancelled(acceptor.next(&listener)).await {
        let Accepted { stream, address, leave, place } = accepted;
        let streams = Streams { places: streams.clone(), address, leave: leave.clone() };
        let served = serve(stream, router.clone(), streams, stop.clone(), limits);
        open.spawn(async move {
            leave.run_until_cancelled(served).await;
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

/// The places of live streams, as available to the requests of one connection.
#[derive(Clone, Debug)]
pub(crate) struct Streams {
    places: FairPlaces,
    address: AddressGroup,
    /// Ends the connection: a stream ends with the connection that carries it, also while its listener reads nothing.
    leave: CancellationToken,
}

impl Streams {
    /// Returns the place of one more stream.
    pub(crate) async fn take(&self) -> Result<Place, WebError> {
        self.places.take(self.address, self.leave.clone()).await.map_err(|refused| {
            WebError::TooManyStreams(match refused {
                NoPlace::AddressIsFull(count) => format!(
                    "{count} live streams are open from this address, as many as one may have; close one and try again"
                ),
                NoPlace::AllTaken(count) => format!(
                    "{count} live streams are open, as many as there may be; try again when one has been closed"
                ),
            })
        })
    }
}

/// An accepted connection.
struct Accepted {
    stream: TcpStream,
    address: AddressGroup,
    /// Cancelled when another address needs the place.
    leave: CancellationToken,
    place: Place,
}

/// Accepts connections within the limits.
struct Acceptor {
    places: FairPlaces,
    /// Ends all connections.
    cut: CancellationToken,
    clock: SharedClock,
    log: LogThrottle,
}

impl Acceptor {
    /// Accepts connections until one gets a place, and returns it.
    async fn next(&mut self, listener: &TcpListener) -> Accepted {
        loop {
            match listener.accept().await {
                Ok((stream, peer)) => {
                    let (address, leave) = (AddressGroup::of(peer), self.cut.child_token());
                    match self.places.take(address, leave.clone()).await {
                        Ok(place) => return Accepted { stream, address, leave, place },
                        Err(_) => self.refused(peer),
                    }
                }
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

    fn refused(&mut self, peer: SocketAddr) {
        if let Some(times) = self.log.count("full", None, self.clock.mono()) {
            tracing::warn!(times, %peer, "closed a connection: as many as allowed are open, and no address has more of them");
        }
    }
}

/// Returns whether the other side gave up before it was accepted.
fn gone(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

async fn serve(stream: TcpStream, router: Router, streams: Streams, stop: CancellationToken, limits: Limits) {
    if let Err(error) = SockRef::from(&stream).set_tcp_user_timeout(Some(limits.unread)) {
        // The peer has usually closed the connection already.
        tracing::debug!(%error, "a connection cannot be given a time limit");
        return;
    }
    let asked = AtomicBool::new(false);
    let service = service_fn(|mut request: Request<Incoming>| {
        request.extensions_mut().insert(streams.clone());
        asked.store(true, Ordering::Relaxed);
        router.clone().oneshot(request)
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.silence)
        .max_buf_size(BUFFER)
        .max_header_size(HEADER)
        .serve_connection(TokioIo::new(stream), service);
    let mut connection = pin!(connection);
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = stop.cancelled() => {
            // An idle connection closes on this request; one in the middle of its first header would wait for the rest of it.
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
