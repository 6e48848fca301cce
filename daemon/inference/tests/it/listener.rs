//! A requester that keeps the parts of an answer.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use peernet_inference::{Cancelled, FinishedJob, InferenceError, Job, Pool, Requester};
use peernet_logger::{HostId, Recorder};
use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

use super::clock;

/// Requester that keeps parts and cancels after some of them, or when its token is cancelled.
struct Listener {
    parts: Mutex<Vec<Sample>>,
    limit: usize,
    cancellation: CancellationToken,
}

impl Requester for Listener {
    fn send_part(&self, part: Sample) -> Result<(), Cancelled> {
        let mut parts = self.parts.lock().expect("is not poisoned");
        parts.push(part);
        if parts.len() < self.limit { Ok(()) } else { Err(Cancelled) }
    }

    fn cancellation(&self) -> CancellationToken {
        self.cancellation.clone()
    }

    fn wait(&self, _duration: Duration) -> Result<(), Cancelled> {
        Ok(())
    }
}

/// Submits a sample, and cancels its request with the part of this number. Returns the result and the parts.
pub(super) fn run_in_parts(
    pool: &Pool,
    sample: Sample,
    limit: usize,
) -> (Result<Sample, InferenceError>, Vec<Sample>) {
    let (finished, listener) = run_until(pool, sample, limit, |_| ());
    let parts = std::mem::take(&mut *listener.parts.lock().expect("is not poisoned"));
    (finished, parts)
}

/// Submits a sample, and cancels its request when `event` returns. Returns the result.
pub(super) fn run_cancelled_by(
    pool: &Pool,
    sample: Sample,
    event: impl FnOnce(),
) -> Result<Sample, InferenceError> {
    let cancel = |cancellation: &CancellationToken| {
        event();
        cancellation.cancel();
    };
    run_until(pool, sample, usize::MAX, cancel).0
}

fn run_until(
    pool: &Pool,
    sample: Sample,
    limit: usize,
    when_submitted: impl FnOnce(&CancellationToken),
) -> (Result<Sample, InferenceError>, Arc<Listener>) {
    let clock = clock();
    let listener =
        Arc::new(Listener { parts: Mutex::default(), limit, cancellation: CancellationToken::new() });
    let (sender, receiver) = sync_channel(1);
    let job = Job {
        sample,
        recorder: Recorder::new(Arc::clone(&clock), HostId::random()),
        received: clock.mono(),
        requester: Arc::clone(&listener) as Arc<dyn Requester>,
        reply: Box::new(move |done: FinishedJob| sender.send(done.result).expect("is awaited")),
    };
    pool.submit(job).expect("the queue has room");
    when_submitted(&listener.cancellation);
    (receiver.recv().expect("is answered"), listener)
}
