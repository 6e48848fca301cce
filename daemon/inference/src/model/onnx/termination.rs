//! Termination of a run of ONNX Runtime: after requests are cancelled, and at shutdown.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Wake, Waker};

use ort::session::RunOptions;
use peernet_clock::{MonoTime, SharedClock};
use tokio_util::sync::{CancellationToken, WaitForCancellationFutureOwned};

/// Options of one run, which is terminated under each of three conditions: all of its requests are cancelled; one of
/// them is cancelled and the run is overdue; the bank of models shuts down. The conditions are checked when a token is
/// cancelled, and at the start for a token that is already cancelled. No timer checks them.
// A thread that still computes must not delay the end of the process. Opening a session cannot be terminated;
// `LibraryUse` makes it safe that the process ends while a session is opened.
pub(super) struct TerminableRun {
    conditions: Arc<Conditions>,
    /// One future for each token. Each future was polled once, so that its token wakes `conditions` when the token is
    /// cancelled.
    _subscriptions: Vec<Pin<Box<WaitForCancellationFutureOwned>>>,
}

/// Conditions under which a run is terminated.
struct Conditions {
    options: RunOptions,
    /// Cancellation tokens of the requests.
    requests: Vec<CancellationToken>,
    /// Cancelled when the model is to stop. Without requests, this alone terminates the run.
    stop: CancellationToken,
    clock: SharedClock,
    /// Time from which on the cancellation of one request terminates the run of all requests.
    // Before this time, the run probably ends soon. Waiting for its end takes less time than computing the other
    // requests again.
    overdue_at: MonoTime,
}

impl TerminableRun {
    /// Creates the options of a run for these requests; `stop` is cancelled when the bank of models shuts down. From
    /// `overdue_at` on, the cancellation of one request terminates the run.
    pub(super) fn new(
        requests: Vec<CancellationToken>,
        stop: &CancellationToken,
        clock: &SharedClock,
        overdue_at: MonoTime,
    ) -> ort::Result<Self> {
        let (options, stop_token, clock) = (RunOptions::new()?, stop.clone(), Arc::clone(clock));
        let conditions = Arc::new(Conditions { options, requests, stop: stop_token, clock, overdue_at });
        let waker = Waker::from(Arc::clone(&conditions));
        let subscribe = |token: &CancellationToken| {
            let mut cancelled = Box::pin(token.clone().cancelled_owned());
            if cancelled.as_mut().poll(&mut Context::from_waker(&waker)).is_ready() {
                conditions.terminate_if_met();
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

    /// Returns whether all requests of the run are cancelled.
    pub(super) fn is_unneeded(&self) -> bool {
        self.conditions.is_unneeded()
    }
}

impl Conditions {
    fn is_unneeded(&self) -> bool {
        !self.requests.is_empty() && self.requests.iter().all(CancellationToken::is_cancelled)
    }

    /// Returns whether a request is cancelled and the run should have ended by now. The sample of this request may be
    /// the reason why the run does not end.
    fn is_overdue(&self) -> bool {
        self.requests.iter().any(CancellationToken::is_cancelled) && self.clock.mono() >= self.overdue_at
    }

    fn terminate_if_met(&self) {
        if (self.is_unneeded() || self.is_overdue() || self.stop.is_cancelled())
            && let Err(error) = self.options.terminate()
        {
            tracing::warn!(%error, "cannot terminate a run of ONNX Runtime, which continues although its answer is not needed");
        }
    }
}

impl Wake for Conditions {
    fn wake(self: Arc<Self>) {
        self.terminate_if_met();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.terminate_if_met();
    }
}
