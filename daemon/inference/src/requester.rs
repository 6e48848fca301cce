//! The requester of an answer, as a model sees it.

use std::time::Duration;

use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

use crate::InferenceError;

/// Receiver of one answer. A model may send it partial answers before the answer is complete, and stops computing
/// when the request is cancelled.
pub trait Requester: Send + Sync {
    /// Sends a partial answer. Waits while too many earlier partial answers are unread or not yet sent.
    ///
    /// # Errors
    /// If the request was cancelled, or the partial answer cannot be sent. The model then stops computing.
    fn send_partial_answer(&self, partial_answer: Sample) -> Result<(), PartialAnswerError>;

    /// Returns the token that is cancelled when the time limit of the request passes or the requester is gone.
    fn cancellation(&self) -> CancellationToken;

    /// Waits for `duration`.
    ///
    /// # Errors
    /// If the request is cancelled. The function then returns at once.
    fn wait(&self, duration: Duration) -> Result<(), Cancelled>;
}

/// Error: the request was cancelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("nobody waits for the answer any more: its time limit passed, or the requester is gone")]
pub struct Cancelled;

/// Reason why a partial answer was not sent.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PartialAnswerError {
    /// The request was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The partial answer cannot be sent to the requester, for the contained reason.
    #[error("{0}")]
    Refused(String),
}

impl PartialAnswerError {
    /// Converts this error into the error with which `model` fails the request.
    pub(crate) fn into_inference_error(self, model: &str) -> InferenceError {
        let model = model.to_owned();
        match self {
            Self::Cancelled(Cancelled) => InferenceError::Cancelled { model },
            Self::Refused(reason) => InferenceError::Failed { model, reason },
        }
    }
}

/// Requester that ignores partial answers and never cancels.
#[derive(Clone, Copy, Debug, Default)]
pub struct UncancelledRequester;

impl Requester for UncancelledRequester {
    fn send_partial_answer(&self, _partial_answer: Sample) -> Result<(), PartialAnswerError> {
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
