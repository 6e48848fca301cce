//! The requester of an answer, as a model sees it.

use std::time::Duration;

use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

/// Receiver of one answer. A model may send it partial answers before the answer is complete, and stops computing
/// when the request is cancelled.
pub trait Requester: Send + Sync {
    /// Sends a partial answer. Waits while too many earlier ones are unread.
    ///
    /// The complete answer repeats the content of the partial ones. The content of a lost partial answer therefore only arrives later.
    ///
    /// # Errors
    /// If the request was cancelled.
    fn send_part(&self, part: Sample) -> Result<(), Cancelled>;

    /// Returns the token that is cancelled when the time limit of the request passes or the other end is gone.
    fn cancellation(&self) -> CancellationToken;

    /// Waits for `duration`.
    ///
    /// # Errors
    /// If the request is cancelled; returns at once then.
    fn wait(&self, duration: Duration) -> Result<(), Cancelled>;
}

/// Error: the request was cancelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("nobody waits for the answer any more: its time limit passed, or the other end is gone")]
pub struct Cancelled;

/// Requester that ignores partial answers and never cancels.
#[derive(Clone, Copy, Debug, Default)]
pub struct UncancelledRequester;

impl Requester for UncancelledRequester {
    fn send_part(&self, _part: Sample) -> Result<(), Cancelled> {
        Ok(())
    }

    fn cancellation(&self) -> CancellationToken {
        CancellationToken::new()
    }

    fn wait(&self, duration: Duration) -> Result<(), Cancelled> {
        std::thread::sleep(duration);
        Ok(())
    }
}
