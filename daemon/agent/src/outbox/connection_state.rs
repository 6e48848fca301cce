//! State of the connection to the aggregator: connecting or open.

use std::fmt;
use std::time::Duration;

use bytes::Bytes;
use futures::FutureExt;
use futures::future::BoxFuture;
use peernet_networks::Address;

use super::connection::{Connection, ConnectionError};

/// State of the connection.
pub(super) enum ConnectionState {
    /// Waiting for the next attempt, or connecting.
    Connecting(BoxFuture<'static, Result<Connection, ConnectionError>>),
    /// A connection is open.
    Open(Connection),
}

impl fmt::Debug for ConnectionState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if matches!(self, Self::Open(_)) { "Open" } else { "Connecting" })
    }
}

/// Event of the connection.
pub(super) enum ConnectionEvent {
    Connected(Connection),
    /// The attempt to connect failed.
    Failed(ConnectionError),
    /// The open connection was lost.
    Lost(ConnectionError),
    /// A frame was received.
    Message(Bytes),
    /// The socket can take frames again.
    SendReady,
}

impl ConnectionState {
    /// Starts a connection attempt after a pause.
    pub(super) fn start_connecting(address: &Address, pause: Duration) -> Self {
        let address = address.clone();
        let connecting = async move {
            tokio::time::sleep(pause).await;
            Connection::open(&address).await
        };
        Self::Connecting(connecting.boxed())
    }

    /// Waits for the next event. [`ConnectionEvent::SendReady`] is returned only if `is_blocked`. Cancel-safe.
    pub(super) async fn next(&mut self, is_blocked: bool) -> ConnectionEvent {
        match self {
            Self::Connecting(connecting) => match connecting.await {
                Ok(connection) => ConnectionEvent::Connected(connection),
                Err(reason) => ConnectionEvent::Failed(reason),
            },
            Self::Open(connection) => match connection.receive(is_blocked).await {
                // A message that is not a single frame is invalid; decoding reports it.
                Ok(Some(message)) => ConnectionEvent::Message(message.part_bytes(0).unwrap_or_default()),
                Ok(None) => ConnectionEvent::SendReady,
                Err(reason) => ConnectionEvent::Lost(reason),
            },
        }
    }
}
