//! Starting and stopping.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use axum::Router;
use peernet_aggregator::Aggregator;
use peernet_clock::SharedClock;
use tokio::net::TcpListener;
use tokio::task::{JoinError, JoinHandle};
use tokio_util::sync::CancellationToken;

use crate::config::{Problem, WebConfig};
use crate::state::AppState;
use crate::{access, assets};

/// How long open requests may go on after the server was asked to stop.
const GRACE: Duration = Duration::from_secs(5);

/// Why the server did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A value of the configuration cannot work.
    #[error("cannot serve the dashboard: {0}")]
    Configuration(#[from] Problem),
    /// The port is taken or the address is not this machine's.
    #[error(
        "cannot serve the dashboard on {address}: {source}; is another one running there? choose another address with `listen` in the table [web]"
    )]
    Listen {
        /// The configured address.
        address: SocketAddr,
        /// The system's own words.
        source: io::Error,
    },
}

/// Why the server ended without being asked to.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Its task panicked.
    #[error("the web server died: {0}")]
    Died(#[from] JoinError),
    /// The listening socket broke.
    #[error("the web server stopped accepting: {0}")]
    Accept(#[from] io::Error),
    /// It ended early.
    #[error("the web server ended before it was asked to")]
    Ended,
}

/// A running server.
#[derive(Debug)]
pub struct Running {
    address: SocketAddr,
    task: JoinHandle<Result<(), Failure>>,
}

impl Running {
    /// Where it listens, with the port really taken.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Waits until the server has ended: after `stop` was cancelled, or because it died.
    ///
    /// # Errors
    /// When it died or ended without being asked to.
    pub async fn join(self) -> Result<(), Failure> {
        self.task.await?
    }
}

/// Everything that [`serve`] answers, without a socket. Streams end when `stop` is cancelled.
pub fn router(
    config: &WebConfig,
    aggregator: Aggregator,
    clock: SharedClock,
    stop: CancellationToken,
) -> Router {
    crate::router::build(AppState::new(config, aggregator, clock, stop))
}

/// Serves the dashboard and the REST API of `aggregator` until `stop` is cancelled; open streams are then
/// ended, other requests get five seconds to finish.
///
/// # Errors
/// When the configuration is refused or the address cannot be listened on.
pub async fn serve(
    config: WebConfig,
    aggregator: Aggregator,
    clock: SharedClock,
    stop: CancellationToken,
) -> Result<Running, StartError> {
    let address = access::listen_address(&config)?;
    let listening = |source| StartError::Listen { address, source };
    let listener = TcpListener::bind(address).await.map_err(listening)?;
    let address = listener.local_addr().map_err(listening)?;
    tokio::task::spawn_blocking(assets::prepare);

    let service = axum::serve(listener, router(&config, aggregator, clock, stop.clone()))
        .with_graceful_shutdown(stop.clone().cancelled_owned());
    let task = tokio::spawn(async move {
        let deadline = async {
            stop.cancelled().await;
            tokio::time::sleep(GRACE).await;
        };
        tokio::select! {
            ended = service.into_future() => {
                ended?;
                if stop.is_cancelled() { Ok(()) } else { Err(Failure::Ended) }
            }
            () = deadline => {
                tracing::warn!("requests were still open {} s after the web server was asked to stop", GRACE.as_secs());
                Ok(())
            }
        }
    });
    Ok(Running { address, task })
}
