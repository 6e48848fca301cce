//! Termination of a run of ONNX Runtime whose requests are all cancelled.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Wake, Waker};

use ort::session::RunOptions;
use tokio_util::sync::{CancellationToken, WaitForCancellationFutureOwned};

/// Options of one run, which is terminated as soon as all of its requests are cancelled, or the host stops.
// A thread that still computes must not keep the process from stopping in time. Opening a session cannot be terminated; `LibraryUse` is for
// that.
pub(super) struct TerminableRun {
    conditions: Arc<Conditions>,
    /// Futures that were polled once, so that each token wakes `conditions` when it is cancelled.
    _subscriptions: Vec<Pin<Box<WaitForCancellationFutureOwned>>>,
}

/// Conditions under which a run is terminated.
struct Conditions {
    options: RunOptions,
    /// Cancellations of the requests; without requests only a stop terminates the run.
    requests: Vec<CancellationToken>,
    stop: CancellationToken,
}

impl TerminableRun {
    /// Creates the options of a run for these requests; `stop` is cancelled when the host stops.
    pub(super) fn new(requests: Vec<CancellationToken>, stop: &CancellationToken) -> ort::Result<Self> {
        let conditions = Arc::new(Conditions { options: RunOptions::new()?, requests, stop: stop.clone() });
        let waker = Waker::from(Arc::clone(&conditions));
        let subscribe = |token: &CancellationToken| {
            let mut cancelled = Box::pin(token.clone().cancelled_owned());
            if cancelled.as_mut().poll(&mut Context::from_waker(&waker)).is_ready() {
                conditions.terminate_if_unneeded();
            }
            cancelled
        };
        let subscriptions = conditions.requests.iter().chain([stop]).map(subscribe).collect();
        Ok(Self { conditions, _subscriptions: subscriptions })
    }

    /// Returns the options to run with.
    pub(super) fn options(&self) -> &RunOptions {
        &self.conditions.options
    }

    /// Returns whether the run was or will be terminated, so that its error has no other cause.
    pub(super) fn is_terminated(&self) -> bool {
        self.conditions.are_met()
    }
}

impl Conditions {
    fn are_met(&self) -> bool {
        let is_unneeded =
            !self.requests.is_empty() && self.requests.iter().all(CancellationToken::is_cancelled);
        is_unneeded || self.stop.is_cancelled()
    }

    fn terminate_if_unneeded(&self) {
        if self.are_met()
            && let Err(error) = self.options.terminate()
        {
            tracing::warn!(%error, "cannot terminate a run of ONNX Runtime that nobody waits for; it goes on");
        }
    }
}

impl Wake for Conditions {
    fn wake(self: Arc<Self>) {
        self.terminate_if_unneeded();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.terminate_if_unneeded();
    }
}
