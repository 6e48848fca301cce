//! Sends partial answers from the cloud.

use std::sync::{Arc, Weak};
use std::time::Duration;

use peernet_clock::MonoTime;
use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

use super::cloud::ListenerState;
use super::incoming::RequestKey;
use super::request_control::{RequestCancelled, RequestControl};
use crate::transport::SendFailure;

/// Time after which a partial answer, or the answer that follows partial answers, is handed to a full send queue again.
// A transport does not report that a full queue has room again. The acknowledgements of partial answers do not show it
// either: a few large partial answers fill the queue before the edge acknowledges any of them.
pub(super) const FULL_QUEUE_RETRY: Duration = Duration::from_millis(5);

/// Reason why a partial answer was not sent. This is an error, because the edge would miss a part of the sequence if
/// later partial answers were sent.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PartialAnswerError {
    /// The edge does not wait for the answer any more.
    #[error(transparent)]
    Cancelled(#[from] RequestCancelled),
    /// The partial answer is larger than the edge accepts.
    #[error(
        "a partial answer has {bytes} bytes, more than the edge's max_message_bytes, {max_bytes}: raise max_message_bytes on the \
         edge (peernet --client: --max-message-bytes), or send smaller partial answers"
    )]
    TooLarge {
        /// Payload of the partial answer. Bytes.
        bytes: u64,
        /// Largest message that the edge accepts. Bytes.
        max_bytes: u64,
    },
    /// The partial answer cannot be encoded, or the network did not accept it.
    #[error("a partial answer cannot be sent: {0}")]
    Unsendable(String),
}

/// Sends partial answers to one request, from any thread. Reports whether the edge still waits for the answer.
#[derive(Clone, Debug)]
pub struct PartialAnswerSender {
    key: RequestKey,
    received: MonoTime,
    control: Arc<RequestControl>,
    shared: Weak<ListenerState>,
}

impl PartialAnswerSender {
    pub(super) const fn new(
        key: RequestKey,
        received: MonoTime,
        control: Arc<RequestControl>,
        shared: Weak<ListenerState>,
    ) -> Self {
        Self { key, received, control, shared }
    }

    /// Sends a partial answer. Waits while the edge has 64 unread partial answers or 256 KiB of them, and while the
    /// network's send queue is full. Does nothing if the version of the session has no partial answers.
    ///
    /// # Errors
    /// If the edge does not wait for the answer any more, or the partial answer cannot be sent.
    pub fn send(&self, partial_answer: &Sample) -> Result<(), PartialAnswerError> {
        // The route is looked up before the partial answer gets a number. A number occupies a place in the window of
        // unread partial answers until the edge acknowledges it, and an edge that gets no partial answers acknowledges
        // none.
        let Some(route) = self.listener()?.route_of_partial_answers(self.key.session) else {
            return if self.is_cancelled() { Err(RequestCancelled.into()) } else { Ok(()) };
        };
        let (bytes, max_bytes) = (partial_answer.payload_bytes(), route.max_message_bytes);
        if bytes > max_bytes {
            return Err(PartialAnswerError::TooLarge { bytes, max_bytes });
        }
        let number = self.control.next_partial_answer_number(bytes)?;
        loop {
            // The listener is not kept during the wait below, so that the port can be closed meanwhile.
            let listener = self.listener()?;
            // The route is looked up again after each wait, because the edge may have moved to another address.
            let route = listener.route_of_partial_answers(self.key.session).ok_or(RequestCancelled)?;
            match listener.send_partial_answer(&route, self.key, (number, self.received), partial_answer) {
                Ok(()) => return Ok(()),
                Err(SendFailure::Gone(reason)) => return Err(PartialAnswerError::Unsendable(reason)),
                Err(SendFailure::Full) => drop(listener),
            }
            self.control.wait(FULL_QUEUE_RETRY)?;
        }
    }

    /// Returns the listener of the session. Fails after the port was closed.
    fn listener(&self) -> Result<Arc<ListenerState>, RequestCancelled> {
        self.shared.upgrade().ok_or(RequestCancelled)
    }

    /// Returns whether the edge does not wait for the answer any more: the request's timeout has passed,
    /// the request was dropped, or the session ended.
    pub fn is_cancelled(&self) -> bool {
        self.control.is_cancelled()
    }

    /// Returns the token that is cancelled when the edge does not wait for the answer any more.
    pub fn cancellation(&self) -> CancellationToken {
        self.control.cancellation()
    }

    /// Waits for `duration`.
    ///
    /// # Errors
    /// If the request is cancelled. The function then returns at once.
    pub fn wait(&self, duration: Duration) -> Result<(), RequestCancelled> {
        self.control.wait(duration)
    }
}
