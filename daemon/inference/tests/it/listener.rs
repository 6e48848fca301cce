//! A requester that keeps the parts of an answer.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use peernet_inference::{Cancelled, FinishedJob, InferenceError, Job, Pool, Requester};
use peernet_logger::{HostId, Recorder};
use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

use super::clock;

/// Requester that keeps parts and cancels after some of them.
struct Listener {
    parts: Mutex<Vec<Sample>>,
    limit: usize,
}

impl Requester for Listener {
    fn send_part(&self, part: Sample) -> Result<(), Cancelled> {
        let mut parts = self.parts.lock().expect("is not poisoned");
        parts.push(part);
        if parts.len() < self.limit { Ok(()) } else { Err(Cancelled) }
    }

    fn cancellation(&self) -> CancellationToken {
        CancellationToken::new()
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
    let clock = clock();
    let listener = Arc::new(Listener { parts: Mutex::default(), limit });
    let (sender, receiver) = sync_channel(1);
    let job = Job {
        sample,
        recorder: Recorder::new(Arc::clone(&clock), HostId::random()),
        received: clock.mono(),
        requester: Arc::clone(&listener) as Arc<dyn Requester>,
        reply: Box::new(move |done: FinishedJob| sender.send(done.result).expect("is awaited")),
    };
    pool.submit(job).expect("the queue has room");
    let result = receiver.recv().expect("is answered");
    let parts = std::mem::take(&mut *listener.parts.lock().expect("is not poisoned"));
    (result, parts)
}
