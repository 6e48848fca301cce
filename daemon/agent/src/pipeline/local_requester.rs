//! A pipeline of this host as the requester of an answer.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use peernet_inference::{Cancelled, PartialAnswerError, Requester};
use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

/// Requester on this host. It ignores partial answers, because actuators act on complete answers.
#[derive(Debug, Default)]
pub(super) struct LocalRequester {
    is_cancelled: Mutex<bool>,
    // `wait` blocks a thread of the model, which cannot await `cancellation`.
    cancelled: Condvar,
    cancellation: CancellationToken,
}

/// Cancels the request when this guard is dropped: after the timeout, or when the pipeline stops waiting. After the
/// answer, the drop has no effect.
#[derive(Debug)]
pub(super) struct CancelOnDrop(pub(super) Arc<LocalRequester>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        *self.0.is_cancelled.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.0.cancelled.notify_all();
        self.0.cancellation.cancel();
    }
}

impl Requester for LocalRequester {
    fn send_partial_answer(&self, _partial_answer: Sample) -> Result<(), PartialAnswerError> {
        if self.cancellation.is_cancelled() { Err(Cancelled.into()) } else { Ok(()) }
    }

    fn cancellation(&self) -> CancellationToken {
        self.cancellation.clone()
    }

    fn wait(&self, duration: Duration) -> Result<(), Cancelled> {
        let state = self.is_cancelled.lock().unwrap_or_else(PoisonError::into_inner);
        let (state, _) = self
            .cancelled
            .wait_timeout_while(state, duration, |is_cancelled| !*is_cancelled)
            .unwrap_or_else(PoisonError::into_inner);
        if *state { Err(Cancelled) } else { Ok(()) }
    }
}
