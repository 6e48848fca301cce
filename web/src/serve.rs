//! Start and stop of the server.

use std::io;
use std::net::SocketAddr;

use axum::Router;
use peernet_aggregator::Aggregator;
use peernet_clock::SharedClock;
use tokio::net::TcpListener;
use tokio::task::{JoinError, JoinHandle};
use tokio_util::sync::CancellationToken;

use crate::assets;
use crate::config::{Problem, WebConfig};
use crate::connections::{self, Limits};
use crate::state::AppState;

/// Reason why the server did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A value of the configuration is invalid.
    #[error("cannot serve the dashboard")]
    Configuration(#[from] Problem),
    /// The port is taken or the address is not this machine's.
    #[error(
        "cannot serve the dashboard on {address}, which another program may hold; choose another address with `listen` in the table [web]"
    )]
    Listen {
        /// The configured address.
        address: SocketAddr,
        /// The operating system's error.
        source: io::Error,
    },
}

/// Reason why the server ended without a request to stop.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The task of the server panicked.
    #[error("the web server died")]
    Died(#[from] JoinError),
}

/// A running server.
#[derive(Debug)]
pub struct Running {
    address: SocketAddr,
    task: JoinHandle<()>,
}

impl Running {
    /// Returns the address that the server listens on, with the actual port.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Waits until the server has ended: after `stop` was cancelled, or after a failure.
    ///
    /// # Errors
    /// Returns an error when the server failed.
    pub async fn join(self) -> Result<(), Failure> {
        Ok(self.task.await?)
    }
}

/// Returns all routes that [`serve`] serves, without a socket. Streams end when `stop` is cancelled.
pub fn router(
    config: &WebConfig,
    aggregator: Aggregator,
    clock: SharedClock,
    stop: CancellationToken,
) -> Router {
    crate::router::build(AppState::new(config, aggregator, clock, stop))
}

/// Serves the dashboard and the REST API of `aggregator` until `stop` is cancelled; open streams are then ended, other requests get 1.5
/// seconds to finish. At most `connections` are open at a time, a quarter of them from one address; a connection that completes no
/// request header within 10 seconds is closed.
///
/// # Errors
/// Returns an error when the configuration is refused or the server cannot listen on the address.
pub async fn serve(
    config: WebConfig,
    aggregator: Aggregator,
    clock: SharedClock,
    stop: CancellationToken,
    connections: usize,
) -> Result<Running, StartError> {
    let address = config.listen_address()?;
    let listening = |source| StartError::Listen { address, source };
    let listener = TcpListener::bind(address).await.map_err(listening)?;
    let address = listener.local_addr().map_err(listening)?;
    tokio::task::spawn_blocking(assets::prepare);

    let router = router(&config, aggregator, clock.clone(), stop.clone());
    let limits = Limits::server(connections);
    let task = tokio::spawn(connections::accept(listener, router, clock, stop, limits));
    Ok(Running { address, task })
}
