//! Detection of blockages. In a blockage, all workers of a model still compute cancelled requests, while other requests
//! wait.

use std::sync::{Arc, Mutex, PoisonError};

use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_logger::Slug;
use tokio_util::sync::CancellationToken;

use crate::Job;

/// Time within which workers should notice that their requests are cancelled. A longer blockage is logged.
const GRACE_PERIOD: Span = Span::from_millis(1000);

/// The computation of one worker, shared with the pool.
#[derive(Debug, Default)]
pub(crate) struct CurrentComputation(Mutex<Option<Computation>>);

#[derive(Debug)]
struct Computation {
    started_at: MonoTime,
    requests: Vec<CancellationToken>,
}

impl CurrentComputation {
    /// Sets the requests that the worker computes from now on.
    pub(crate) fn begin(&self, jobs: &[Job], started_at: MonoTime) {
        let requests = jobs.iter().map(|job| job.requester.cancellation()).collect();
        self.set(Some(Computation { started_at, requests }));
    }

    /// Records that the worker computes nothing.
    pub(crate) fn end(&self) {
        self.set(None);
    }

    fn set(&self, computation: Option<Computation>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = computation;
    }

    /// Returns the start of the computation if all of its requests were cancelled.
    fn cancelled_start(&self) -> Option<MonoTime> {
        let computation = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let computation = computation.as_ref()?;
        computation.requests.iter().all(CancellationToken::is_cancelled).then_some(computation.started_at)
    }
}

/// Watches all workers of a pool, and detects when each of them computes only cancelled requests.
#[derive(Debug)]
pub(crate) struct BlockageDetector {
    computations: Vec<Arc<CurrentComputation>>,
    clock: SharedClock,
    /// The current blockage; if there is none, the previous one.
    latest: Mutex<Option<Blockage>>,
}

/// A period in which all workers compute only cancelled requests.
#[derive(Debug)]
struct Blockage {
    /// Start of the oldest computation.
    started_at: MonoTime,
    noticed_at: MonoTime,
    is_logged: bool,
}

impl BlockageDetector {
    pub(crate) const fn new(computations: Vec<Arc<CurrentComputation>>, clock: SharedClock) -> Self {
        Self { computations, clock, latest: Mutex::new(None) }
    }

    /// Returns the time since the start of the oldest computation if every worker computes only cancelled requests.
    pub(crate) fn duration(&self) -> Option<Span> {
        self.started_at().map(|started_at| self.clock.mono() - started_at)
    }

    fn started_at(&self) -> Option<MonoTime> {
        let starts: Option<Vec<_>> =
            self.computations.iter().map(|computation| computation.cancelled_start()).collect();
        starts?.into_iter().min()
    }

    /// Logs a blockage that was noticed at least [`GRACE_PERIOD`] ago; each blockage is logged once. The pool calls
    /// this for each request. Returns whether it logged.
    pub(crate) fn check(&self, model: &Slug) -> bool {
        let Some(started_at) = self.started_at() else { return false };
        let now = self.clock.mono();
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        match &mut *latest {
            Some(blockage) if blockage.started_at == started_at => {
                // The oldest computation has not ended since the last check, so this is still the same blockage.
                if blockage.is_logged || now - blockage.noticed_at < GRACE_PERIOD {
                    return false;
                }
                blockage.is_logged = true;
            }
            latest => {
                *latest = Some(Blockage { started_at, noticed_at: now, is_logged: false });
                return false;
            }
        }
        let computing_s = (now - started_at).seconds();
        tracing::warn!(
            %model, computing_s,
            "every worker of the model still computes a cancelled request, so that further requests wait: the model cannot interrupt a \
             computation; make samples smaller, or raise workers"
        );
        true
    }
}
