//! Opening a session: connect, say hello, wait for the answer.

use super::client::{Opened, opened};
use crate::message::{Accepted, Header, Open, SessionHello};
use crate::transport::{DialFailure, Dialled};
use crate::{Address, NetworkKind, SessionSettings};

/// Why a session could not be opened.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// Nobody answers at the address.
    #[error("cannot reach a cloud at {address}: {reason}; is it running, and is the address right?")]
    Unreachable {
        /// Where the session was to be opened.
        address: Address,
        /// What went wrong.
        reason: String,
    },
    /// The cloud did not answer in time.
    #[error(
        "no session with {address} within {waited_ms} ms; raise open_timeout_ms if its model takes longer to load"
    )]
    TimedOut {
        /// Where the session was to be opened.
        address: Address,
        /// How long it was waited for. Milliseconds.
        waited_ms: u64,
    },
    /// The cloud does not serve what was asked for.
    #[error("the cloud at {address} refused the session: {reason}")]
    Refused {
        /// Where the session was to be opened.
        address: Address,
        /// The cloud's words.
        reason: String,
    },
    /// The cloud speaks another version of the protocol.
    #[error(
        "the cloud at {address} speaks protocol {theirs}, this program {ours}: run the same release on both hosts"
    )]
    Incompatible {
        /// Where the session was to be opened.
        address: Address,
        /// The protocol version of the hello.
        ours: u16,
        /// The cloud's.
        theirs: u16,
    },
}

/// Connects and shakes hands, however long it takes.
pub(crate) async fn handshake(
    kind: NetworkKind,
    address: &Address,
    hello: SessionHello,
    settings: &SessionSettings,
) -> Result<(Dialled, Accepted), OpenError> {
    let unreachable = |reason: String| OpenError::Unreachable { address: address.clone(), reason };
    let ours = hello.protocol;
    let mut dialled = kind.dial(address, settings).await.map_err(|failure| match failure {
        DialFailure::Unreachable(reason) => unreachable(reason),
        DialFailure::TimedOut => {
            OpenError::TimedOut { address: address.clone(), waited_ms: settings.open_timeout_ms }
        }
    })?;
    let open = Header::Open(Box::new(Open { hello, max_message_bytes: settings.max_message_bytes }));
    let open = open.encode().map_err(|error| unreachable(error.to_string()))?;
    dialled.sender.send(vec![open]).map_err(|error| unreachable(error.to_string()))?;
    loop {
        let frames = dialled.receiver.receive().await.map_err(unreachable)?;
        let Some(Ok(header)) = frames.first().map(|frame| Header::decode(frame)) else { continue };
        match opened(header) {
            Opened::Accepted(accepted) => return Ok((dialled, *accepted)),
            Opened::Refused(reason) => return Err(OpenError::Refused { address: address.clone(), reason }),
            Opened::Incompatible(theirs) => {
                return Err(OpenError::Incompatible { address: address.clone(), ours, theirs });
            }
            Opened::Nonsense => {}
        }
    }
}
