//! One thread of a pool.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use peernet_clock::SharedClock;
use peernet_logger::{Recorder, Slug, stage};
use peernet_sample::Sample;

use crate::job::Reply;
use crate::queue::Queue;
use crate::{FinishedJob, InferenceError, Job, Model, Requester, Worker};

/// A worker with the objects that it needs to answer jobs; used by one thread at a time.
pub(crate) struct WorkerSlot {
    pub(crate) name: Slug,
    pub(crate) model: Arc<dyn Model>,
    pub(crate) clock: SharedClock,
    /// The worker; `None` after a panic, until it is rebuilt.
    pub(crate) worker: Option<Box<dyn Worker>>,
}

impl WorkerSlot {
    /// Serves jobs until the queue is closed.
    pub(crate) fn serve(&mut self, queue: &Queue<Job>) {
        while let Some(job) = queue.pop() {
            let (reply, done) = self.compute(job);
            deliver(&self.name, reply, done);
        }
    }

    /// Computes one job; the caller passes the result to [`deliver`]. Never panics.
    pub(crate) fn compute(&mut self, job: Job) -> (Reply, FinishedJob) {
        let Job { sample, mut recorder, received, requester, reply } = job;
        recorder.record_timer(stage::QUEUE, received, self.clock.mono());
        let result = self.infer(&sample, &mut recorder, &*requester);
        (reply, FinishedJob { recorder, result })
    }

    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        // A request that was cancelled in the queue costs no computation.
        if requester.cancellation().is_cancelled() {
            return Err(InferenceError::Cancelled { model: self.name.to_string() });
        }
        let mut worker = match self.worker.take() {
            Some(worker) => worker,
            None => {
                let restarted_at = self.clock.mono();
                let worker = self.model.create_worker().map_err(|error| InferenceError::Failed {
                    model: self.name.to_string(),
                    reason: format!("its worker could not be rebuilt after a panic: {error}"),
                })?;
                recorder.record_timer(stage::RESTART, restarted_at, self.clock.mono());
                worker
            }
        };
        // The panic closes the recorder's open nodes as it unwinds, so that the recorder stays usable. The worker is
        // discarded.
        match catch_unwind(AssertUnwindSafe(|| worker.infer(sample, recorder, requester))) {
            Ok(result) => {
                self.worker = Some(worker);
                result
            }
            Err(panic) => {
                let message = panic_message(panic.as_ref()).to_owned();
                Err(InferenceError::Panicked { model: self.name.to_string(), message })
            }
        }
    }
}

/// Calls a job's reply and catches its panics, so that a faulty receiver does not end a thread of the pool.
pub(crate) fn deliver(model: &Slug, reply: Reply, done: FinishedJob) {
    if let Err(panic) = catch_unwind(AssertUnwindSafe(|| reply(done))) {
        tracing::error!(%model, panic = panic_message(panic.as_ref()), "the receiver of a model's answer panicked");
    }
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a message")
}
