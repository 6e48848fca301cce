//! Opens a session: connects to the cloud, sends a hello and waits for the cloud's answer.

use peernet_clock::SharedClock;
use peernet_stream::VersionMismatch;
use tokio::time::{Instant, timeout_at};

use super::client::{HelloOutcome, classify_hello_answer};
use super::completed_request::MessageSizes;
use crate::message::{Accepted, Header, Open, SessionHello};
use crate::statistics::Counters;
use crate::transport::{DialContext, DialFailure, EdgeConnection, EdgeEvent, SendOptions};
use crate::{Address, SessionSettings};

/// Reason why a session could not be opened.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// Nothing answers at the address.
    #[error("cannot reach a cloud at {address}: {reason}{}", advice(.reason))]
    Unreachable {
        /// Address of the cloud.
        address: Address,
        /// Cause.
        reason: String,
    },
    /// A program accepted the connection, and did not answer in time or closed the connection without an answer. The
    /// program may be something else than a cloud.
    #[error(
        "something listens at {address} but does not answer like an agent's [serve]; is this the port of an aggregator or of something else?{}",
        Self::LOADING_HINT
    )]
    TimedOut {
        /// Address of the cloud.
        address: Address,
        /// Time limit for the answer. Milliseconds.
        waited_ms: u64,
    },
    /// The other end identified itself as a cloud and closed the connection instead of answering.
    #[error(
        "the cloud at {address} closed the connection before it answered the request for a session ({reason}); it may have been stopped, or killed while it loaded the model, for example because its memory was full; its log says why, and this edge tries again"
    )]
    Ended {
        /// Address of the cloud.
        address: Address,
        /// Reason why the connection ended.
        reason: String,
    },
    /// The other end identified itself as a cloud and did not answer in time.
    #[error(
        "the cloud at {address} did not answer the request for a session: {reason}; does its log say why?{}",
        Self::LOADING_HINT
    )]
    Unanswered {
        /// Address of the cloud.
        address: Address,
        /// Text that says how long the edge waited.
        reason: String,
    },
    /// The cloud does not serve the requested model or device, or has reached a limit of sessions.
    #[error("the cloud at {address} refused the session: {reason}")]
    Refused {
        /// Address of the cloud.
        address: Address,
        /// Reason, in the cloud's words.
        reason: String,
    },
    /// The cloud speaks no version of the protocol that this program speaks.
    #[error("{}", describe_incompatibility(.address, .mismatch))]
    Incompatible {
        /// Address of the cloud.
        address: Address,
        /// Versions of both ends.
        mismatch: VersionMismatch,
    },
}

fn describe_incompatibility(address: &Address, mismatch: &VersionMismatch) -> String {
    mismatch.describe("the session protocol", "this program", &format!("the cloud at {address}"))
}

/// Returns the advice for a cloud that cannot be reached. It is empty if the reason already contains advice, as for a
/// missing ROS master.
fn advice(reason: &str) -> &'static str {
    // In error texts, a semicolon separates the advice from the problem.
    if reason.contains("; ") { "" } else { "; is it running, and is the address right?" }
}

impl OpenError {
    /// Last words of the texts of [`Self::TimedOut`] and [`Self::Unanswered`]. Commands that have no configuration
    /// file, or whose model needs no loading, remove these words.
    pub const LOADING_HINT: &str = " or does its model take longer to load than open_timeout_ms allows?";
}

/// A connection with an accepted session.
pub(crate) struct OpenedSession {
    pub(crate) connection: EdgeConnection,
    pub(crate) accepted: Accepted,
    /// Remarks that the transport made while the session was opened.
    pub(crate) remarks: Vec<String>,
}

/// Connects and opens the session, within the time that the settings allow.
pub(crate) async fn handshake(
    address: &Address,
    hello: SessionHello,
    settings: &SessionSettings,
    clock: &SharedClock,
    counters: &Counters,
) -> Result<OpenedSession, OpenError> {
    let unreachable = |reason: String| OpenError::Unreachable { address: address.clone(), reason };
    let waited_ms = settings.open_timeout_ms;
    let deadline = Instant::now() + settings.open_timeout();
    let context = DialContext { hello: &hello, clock };
    let connection = timeout_at(deadline, address.network().dial(address, settings, &context)).await;
    let mut connection =
        connection.unwrap_or(Err(DialFailure::TimedOut)).map_err(|failure| match failure {
            DialFailure::Unreachable(reason) => unreachable(reason),
            DialFailure::Refused(reason) => OpenError::Refused { address: address.clone(), reason },
            // The text has no duration, because the transport may have waited for less time than the settings allow.
            DialFailure::TimedOut => unreachable("nothing answered".to_owned()),
        })?;
    let open = Header::Open(Box::new(Open { hello, max_message_bytes: settings.max_message_bytes }));
    let open = open.encode().map_err(|error| unreachable(error.to_string()))?;
    let bytes = open.len() as u64;
    connection
        .sender
        .send(vec![open], SendOptions::default())
        .map_err(|error| unreachable(error.to_string()))?;
    counters.count_sent(bytes);
    let mut remarks = Vec::new();
    loop {
        let frames = timeout_at(deadline, connection.receiver.receive()).await;
        let error = match frames {
            Ok(Ok(EdgeEvent::Message(frames))) => {
                counters.count_received(MessageSizes::from_frames(&frames).total());
                // An unreadable message is not the answer. The answer may still come, and the deadline ends the wait.
                let Some(Ok(header)) = frames.first().map(|frame| Header::decode(frame)) else { continue };
                match classify_hello_answer(header) {
                    HelloOutcome::Accepted(accepted) => {
                        return Ok(OpenedSession { connection, accepted: *accepted, remarks });
                    }
                    HelloOutcome::Refused(reason) => {
                        return Err(OpenError::Refused { address: address.clone(), reason });
                    }
                    HelloOutcome::Incompatible(mismatch) => {
                        return Err(OpenError::Incompatible { address: address.clone(), mismatch });
                    }
                    // Some other message; the answer may still come.
                    HelloOutcome::Unrelated => continue,
                }
            }
            Ok(Ok(EdgeEvent::Remark(text))) => {
                remarks.push(text);
                continue;
            }
            // Nothing to do: the transport repeats a lost message that opens a session.
            Ok(Ok(EdgeEvent::IncomingLost(_) | EdgeEvent::OutgoingLost(_))) => continue,
            Ok(Ok(EdgeEvent::InvalidData(_))) => {
                counters.count_malformed();
                continue;
            }
            // The other end has not identified itself as a cloud, so it may be another program, such as an aggregator.
            // A closed connection does not show which program it is: an aggregator closes a connection without an
            // answer, and so does a cloud while too many connections wait for a session.
            _ if !connection.peer_is_cloud => OpenError::TimedOut { address: address.clone(), waited_ms },
            Ok(Err(disconnected)) => {
                OpenError::Ended { address: address.clone(), reason: disconnected.to_string() }
            }
            Err(_) => {
                let reason = format!("no answer arrived within {waited_ms} ms");
                OpenError::Unanswered { address: address.clone(), reason }
            }
        };
        return Err(error);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unreachable_reason_with_advice_gets_no_further_advice() {
        let error_text = |reason: &str| {
            let address = "tcp://a:1".parse().expect("an address");
            OpenError::Unreachable { address, reason: reason.to_owned() }.to_string()
        };
        let missing_master =
            "no ROS master answers at http://a:11311: refused; start roscore there, or set ROS_MASTER_URI";
        assert_eq!(
            error_text(missing_master),
            format!("cannot reach a cloud at tcp://a:1: {missing_master}")
        );
        assert!(
            error_text("connection refused")
                .ends_with("connection refused; is it running, and is the address right?")
        );
    }
}
