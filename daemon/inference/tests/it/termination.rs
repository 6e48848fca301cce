//! Tests of computations that do not end by themselves.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;

use peernet_inference::{Cancelled, FinishedJob, InferenceError, Job, PartialAnswerError, Pool, Requester};
use peernet_logger::{HostId, Recorder};
use peernet_sample::{ElementType, Sample};
use tokio_util::sync::CancellationToken;

use super::graphs::{array, model};
use super::{clock, loaded, slug};

/// Number of runs of a loop that do not end within the time of a test.
const ENDLESS: i64 = 1 << 60;
/// Time within which a terminated computation must have ended, also on a busy machine.
const END_TIMEOUT: Duration = Duration::from_secs(60);

/// Requester with a token that the test cancels.
#[derive(Default)]
pub(super) struct CancellableRequester(pub(super) CancellationToken);

impl Requester for CancellableRequester {
    fn send_partial_answer(&self, _partial_answer: Sample) -> Result<(), PartialAnswerError> {
        Ok(())
    }

    fn cancellation(&self) -> CancellationToken {
        self.0.clone()
    }

    fn wait(&self, _duration: Duration) -> Result<(), Cancelled> {
        Ok(())
    }
}

/// Submits a request for `runs` runs of a loop. Returns the receiver of the result.
fn submit(pool: &Pool, runs: i64, token: &CancellationToken) -> std::sync::mpsc::Receiver<FinishedJob> {
    let (sender, receiver) = sync_channel(1);
    let clock = clock();
    let part = array(ElementType::I64, &[1], runs.to_le_bytes().to_vec());
    let job = Job {
        sample: Sample { parts: vec![part], source: String::new(), label: None },
        recorder: Recorder::new(Arc::clone(&clock), HostId::random()),
        received_at: clock.mono(),
        requester: Arc::new(CancellableRequester(token.clone())),
        // If the test has failed, the receiver no longer exists.
        reply: Box::new(move |done| drop(sender.send(done))),
    };
    pool.submit(job).expect("the queue has room");
    receiver
}

#[test]
fn cancelled_request_ends_its_computation() {
    let bank = model("counter");
    let pool = loaded(&bank, "counter");
    let token = CancellationToken::new();
    let endless = submit(&pool, ENDLESS, &token);
    let next = submit(&pool, 3, &CancellationToken::new());
    token.cancel();
    let done = endless.recv_timeout(END_TIMEOUT).expect("is terminated");
    assert_eq!(done.result, Err(InferenceError::Cancelled { model: "counter".to_owned() }));
    let answer = next.recv_timeout(END_TIMEOUT).expect("the worker is free again").result.expect("computes");
    assert_eq!(answer.parts[0].bytes[..], 3_i64.to_le_bytes());
}

#[test]
fn shutdown_ends_running_computation() {
    let bank = model("counter");
    let pool = loaded(&bank, "counter");
    assert!(peernet_inference::is_library_in_use(), "the library is in use while the model is loaded");
    let endless = submit(&pool, ENDLESS, &CancellationToken::new());
    assert_eq!(bank.shutdown_within(END_TIMEOUT), [] as [peernet_logger::Slug; 0]);
    let stopped = Err(InferenceError::Stopped { model: "counter".to_owned() });
    assert_eq!(endless.recv_timeout(END_TIMEOUT).expect("is answered").result, stopped);
}

#[test]
fn shutdown_ends_inference_during_load() {
    // Loading runs the model once.
    let bank = model("endless");
    let loading = std::thread::scope(|scope| {
        let loading = scope.spawn(|| bank.load(&slug("endless"), None).map(drop));
        assert_eq!(bank.shutdown_within(END_TIMEOUT), [] as [peernet_logger::Slug; 0]);
        loading.join().expect("does not panic")
    });
    assert!(loading.is_err(), "the inference during the load was terminated");
}
