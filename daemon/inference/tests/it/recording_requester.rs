//! A requester that keeps partial answers.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use peernet_inference::{Cancelled, FinishedJob, InferenceError, Job, PartialAnswerError, Pool, Requester};
use peernet_logger::{HostId, Recorder};
use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

use super::clock;

/// Beginning of a partial answer that the requester refuses.
pub(super) const REFUSED: &str = "refused";

/// Requester that keeps partial answers. Its request is cancelled when partial answer number `limit` arrives, or when
/// the test cancels the token.
struct RecordingRequester {
    partial_answers: Mutex<Vec<Sample>>,
    /// Number of the partial answer that cancels the request, counted from 1.
    limit: usize,
    cancellation: CancellationToken,
}

impl Requester for RecordingRequester {
    fn send_partial_answer(&self, partial_answer: Sample) -> Result<(), PartialAnswerError> {
        if partial_answer.parts[0].bytes.starts_with(REFUSED.as_bytes()) {
            return Err(PartialAnswerError::Refused("it is too large".to_owned()));
        }
        let mut partial_answers = self.partial_answers.lock().expect("is not poisoned");
        partial_answers.push(partial_answer);
        if partial_answers.len() < self.limit { Ok(()) } else { Err(Cancelled.into()) }
    }

    fn cancellation(&self) -> CancellationToken {
        self.cancellation.clone()
    }

    fn wait(&self, _duration: Duration) -> Result<(), Cancelled> {
        Ok(())
    }
}

/// Submits a sample, and cancels its request when partial answer number `limit` arrives, counted from 1. Returns the
/// result and the partial answers.
pub(super) fn run_until_partial_answer(
    pool: &Pool,
    sample: Sample,
    limit: usize,
) -> (Result<Sample, InferenceError>, Vec<Sample>) {
    let (finished, requester) = run_until(pool, sample, limit, |_| ());
    let partial_answers = std::mem::take(&mut *requester.partial_answers.lock().expect("is not poisoned"));
    (finished, partial_answers)
}

/// Submits a sample, calls `wait_for_event` and then cancels the request. Returns the result.
pub(super) fn run_cancelled_by(
    pool: &Pool,
    sample: Sample,
    wait_for_event: impl FnOnce(),
) -> Result<Sample, InferenceError> {
    let cancel = |cancellation: &CancellationToken| {
        wait_for_event();
        cancellation.cancel();
    };
    run_until(pool, sample, usize::MAX, cancel).0
}

fn run_until(
    pool: &Pool,
    sample: Sample,
    limit: usize,
    when_submitted: impl FnOnce(&CancellationToken),
) -> (Result<Sample, InferenceError>, Arc<RecordingRequester>) {
    let clock = clock();
    let requester = Arc::new(RecordingRequester {
        partial_answers: Mutex::default(),
        limit,
        cancellation: CancellationToken::new(),
    });
    let (sender, receiver) = sync_channel(1);
    let job = Job {
        sample,
        recorder: Recorder::new(Arc::clone(&clock), HostId::random()),
        received_at: clock.mono(),
        requester: Arc::clone(&requester) as Arc<dyn Requester>,
        reply: Box::new(move |done: FinishedJob| {
            sender.send(done.result).expect("the test waits for the result");
        }),
    };
    pool.submit(job).expect("the queue has room");
    when_submitted(&requester.cancellation);
    (receiver.recv().expect("is answered"), requester)
}
