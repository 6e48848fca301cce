//! Sends parts of an answer from the cloud.

use std::sync::{Arc, Weak};
use std::time::Duration;

use peernet_clock::MonoTime;
use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

use super::cloud::ListenerState;
use super::incoming::RequestKey;
use super::request_control::{RequestCancelled, RequestControl};

/// Sends parts of the answer to one request, from any thread. Reports whether the edge still waits for the answer.
#[derive(Clone, Debug)]
pub struct PartSender {
    key: RequestKey,
    received: MonoTime,
    control: Arc<RequestControl>,
    shared: Weak<ListenerState>,
}

impl PartSender {
    pub(super) const fn new(
        key: RequestKey,
        received: MonoTime,
        control: Arc<RequestControl>,
        shared: Weak<ListenerState>,
    ) -> Self {
        Self { key, received, control, shared }
    }

    /// Sends a part of the answer. Waits while the edge has 64 unread parts. Does nothing if the edge does not know
    /// partial replies, or if the part is larger than the edge accepts: the complete answer contains it.
    ///
    /// # Errors
    /// If the edge does not wait for the answer any more.
    pub fn send(&self, part: &Sample) -> Result<(), RequestCancelled> {
        // Asked before the part gets a number: an edge without partial replies acknowledges none.
        let Some(shared) = self.shared.upgrade() else { return Err(RequestCancelled) };
        let Some(route) = shared.route_of_parts(self.key.session) else {
            return if self.is_cancelled() { Err(RequestCancelled) } else { Ok(()) };
        };
        let number = self.control.next_part()?;
        shared.send_part(&route, self.key, (number, self.received), part);
        Ok(())
    }

    /// Returns whether the edge does not wait for the answer any more: the request's time is over, or the session
    /// ended.
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
    /// If the request is cancelled; returns at once then.
    pub fn wait(&self, duration: Duration) -> Result<(), RequestCancelled> {
        self.control.wait(duration)
    }
}
