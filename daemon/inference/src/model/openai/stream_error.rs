//! Reasons why a stream is not a complete answer.

use peernet_statistics::number::counted;

use super::event_stream::EventTooLong;

/// Reason why a stream is not a complete answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum StreamError {
    /// The data of an event is not JSON, or not of the expected form.
    #[error("event {number} of its answer cannot be read: {reason}")]
    Event { number: u64, reason: String },
    /// An event is too long.
    #[error("its server sent an event longer than 1 MiB; check that url is the server's chat API")]
    EventTooLong,
    /// The server reported an error in the stream. In this and the other variants, `chunk_count` is the number of
    /// chunks that had arrived.
    #[error("its server ended the answer after {}: {text}", counted(*.chunk_count, "chunk"))]
    Server { chunk_count: u64, text: String },
    /// An event has the whole text of an answer instead of a `delta`.
    #[error(
        "event {number} of its answer has text in `{field}` and no `delta`: the server does not stream its answer as chat"
    )]
    NoDelta { number: u64, field: &'static str },
    /// All text belongs to choices with another index than 0.
    #[error(
        "its answer has text only in a choice with the index {0}, and PEERNet reads the choice with the index 0"
    )]
    OtherChoice(String),
    /// The stream has ended without any text, reasoning or finish reason.
    #[error("its server ended the answer without text")]
    WithoutText,
    /// The bytes are not a stream of events.
    #[error("its answer of {0} bytes is no event stream")]
    NoEvents(usize),
    /// The connection was closed before the answer had ended.
    #[error("its server closed the connection after {} without ending the answer", counted(*.0, "chunk"))]
    EndedEarly(u64),
    /// The answer is too long.
    #[error("its answer is longer than {0}; set max_tokens in parameters")]
    TooLong(&'static str),
}

impl From<EventTooLong> for StreamError {
    fn from(_: EventTooLong) -> Self {
        Self::EventTooLong
    }
}
