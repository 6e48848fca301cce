//! The way to the aggregator: dialled, open, and dialled again.

use std::fmt;
use std::time::Duration;

use bytes::Bytes;
use futures::FutureExt;
use futures::future::BoxFuture;
use peernet_networks::Address;

use super::connection::{Connection, ConnectionError};

/// The state of the connection.
pub(super) enum Line {
    /// Waiting for the next try, or trying.
    Dialling(BoxFuture<'static, Result<Connection, ConnectionError>>),
    /// There is one.
    Open(Connection),
}

impl fmt::Debug for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if matches!(self, Self::Open(_)) { "Open" } else { "Dialling" })
    }
}

/// What happened on the line.
pub(super) enum Happened {
    Connected(Connection),
    Failed(ConnectionError),
    Gone(ConnectionError),
    Message(Bytes),
    /// There is room on it again.
    Room,
}

impl Line {
    /// Tries after a pause.
    pub(super) fn dial(address: &Address, pause: Duration) -> Self {
        let address = address.clone();
        let dialling = async move {
            tokio::time::sleep(pause).await;
            Connection::open(&address).await
        };
        Self::Dialling(dialling.boxed())
    }

    /// Waits for something to happen; for room as well when it is `blocked`. Dropping the future loses nothing.
    pub(super) async fn next(&mut self, blocked: bool) -> Happened {
        match self {
            Self::Dialling(dialling) => match dialling.await {
                Ok(connection) => Happened::Connected(connection),
                Err(reason) => Happened::Failed(reason),
            },
            Self::Open(connection) => match connection.receive(blocked).await {
                // What is not one frame is no message of ours; decoding says so.
                Ok(Some(message)) => Happened::Message(message.part_bytes(0).unwrap_or_default()),
                Ok(None) => Happened::Room,
                Err(reason) => Happened::Gone(reason),
            },
        }
    }
}
