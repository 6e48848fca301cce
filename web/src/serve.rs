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
use crate::config::{ConfigProblem, WebConfig};
use crate::connections::{self, Limits};
use crate::state::AppState;

/// Reason why the server did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A value of the configuration is invalid.
    #[error("cannot serve the dashboard")]
    Configuration(#[from] ConfigProblem),
    /// The operating system refused the address: the port is in use, or the address does not belong to this machine.
    #[error(
        "cannot listen on {address} for the dashboard: another program may use the port; choose another address with `listen` in the table [web]"
    )]
    Listen {
        /// The configured address.
        address: SocketAddr,
        /// The operating system's error.
        source: io::Error,
    },
}

/// Reason why a running server failed.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The task of the server panicked.
    #[error("the web server's task failed; restart peernetd and report this as a bug")]
    Panicked(#[from] JoinError),
}

/// Handle of a running server.
#[derive(Debug)]
pub struct RunningServer {
    address: SocketAddr,
    task: JoinHandle<()>,
}

impl RunningServer {
    /// Returns the address that the server listens on, with the port that was assigned if the configuration has port 0.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Waits until the server has stopped, because the stop token was cancelled or the server failed.
    ///
    /// # Errors
    /// Returns an error when the server failed.
    pub async fn join(self) -> Result<(), ServerError> {
        Ok(self.task.await?)
    }
}

/// Returns the routes of [`serve`] without a socket, for tests. Live streams end when `stop` is cancelled.
pub fn router(
    config: &WebConfig,
    aggregator: Aggregator,
    clock: SharedClock,
    stop: CancellationToken,
) -> Router {
    crate::router::build_router(AppState::new(config, aggregator, clock, stop))
}

/// Serves the dashboard and the REST API of `aggregator` until `stop` is cancelled. Live streams end then, and other requests get 1.5
/// seconds to finish.
///
/// At most `connections` connections are open at a time, and client addresses share them equally. A connection that completes no request
/// header within 10 seconds is closed.
///
/// # Errors
/// Returns an error when the configuration is invalid or the server cannot listen on the address.
pub async fn serve(
    config: WebConfig,
    aggregator: Aggregator,
    clock: SharedClock,
    stop: CancellationToken,
    connections: usize,
) -> Result<RunningServer, StartError> {
    let address = config.listen_address()?;
    let listen_error = |source| StartError::Listen { address, source };
    let listener = TcpListener::bind(address).await.map_err(listen_error)?;
    let address = listener.local_addr().map_err(listen_error)?;
    tokio::task::spawn_blocking(assets::compress_all);

    let router = router(&config, aggregator, clock.clone(), stop.clone());
    let limits = Limits::server(connections);
    let task = tokio::spawn(connections::accept(listener, router, clock, stop, limits));
    Ok(RunningServer { address, task })
}
