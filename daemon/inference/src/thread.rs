//! One thread of a pool.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use peernet_clock::{MonoTime, SharedClock};
use peernet_logger::{Slug, stage};
use peernet_sample::Sample;

use crate::blockage_detector::CurrentComputation;
use crate::job::Reply;
use crate::queue::Queue;
use crate::{FinishedJob, InferenceError, Job, Model, Request, Worker};

/// A worker, with what is needed to answer jobs and to rebuild the worker; used by one thread at a time.
pub(crate) struct WorkerSlot {
    pub(crate) name: Slug,
    pub(crate) model: Arc<dyn Model>,
    pub(crate) clock: SharedClock,
    /// The worker; `None` after a panic, until the next job rebuilds the worker.
    pub(crate) worker: Option<Box<dyn Worker>>,
    pub(crate) current_computation: Arc<CurrentComputation>,
}

impl WorkerSlot {
    /// Serves jobs until the queue is closed.
    pub(crate) fn serve(&mut self, queue: &Queue<Job>) {
        let batching = self.model.batching();
        while let Some(job) = queue.pop() {
            let taken_at = self.clock.mono();
            let mut jobs = vec![job];
            if batching.is_on() {
                queue.pop_more(&mut jobs, batching.max_size, batching.max_wait);
            }
            let finished = self.compute(jobs, taken_at);
            queue.finish(finished.len());
            for (reply, finished_job) in finished {
                deliver(&self.name, reply, finished_job);
            }
        }
    }

    /// Computes jobs that were taken from the queue at `taken_at` or later; the caller passes the results to
    /// [`deliver`]. Never panics.
    pub(crate) fn compute(&mut self, mut jobs: Vec<Job>, taken_at: MonoTime) -> Vec<(Reply, FinishedJob)> {
        let started_at = self.clock.mono();
        let is_batching = self.model.batching().is_on();
        for job in &mut jobs {
            // A request that arrives while its batch is collected spends no time in the queue.
            let left_queue_at = if is_batching { taken_at.max(job.received_at) } else { started_at };
            job.recorder.record_timer(stage::QUEUE, job.received_at, left_queue_at);
            if is_batching {
                job.recorder.record_timer(stage::BATCH_WAIT, left_queue_at, started_at);
            }
        }
        // A request that was cancelled in the queue costs no computation.
        let (cancelled, mut to_compute): (Vec<_>, Vec<_>) =
            jobs.into_iter().partition(|job| job.requester.cancellation().is_cancelled());
        let results = if to_compute.is_empty() { Vec::new() } else { self.infer(&mut to_compute) };
        let cancellation = || Err(InferenceError::Cancelled { model: self.name.to_string() });
        let cancelled = cancelled.into_iter().map(|job| (job, cancellation()));
        let finished = |(job, result): (Job, _)| (job.reply, FinishedJob { recorder: job.recorder, result });
        to_compute.into_iter().zip(results).chain(cancelled).map(finished).collect()
    }

    /// Returns one result per job, in their order.
    fn infer(&mut self, jobs: &mut [Job]) -> Vec<Result<Sample, InferenceError>> {
        let mut worker = match self.worker.take() {
            Some(worker) => worker,
            None => {
                let restart_began_at = self.clock.mono();
                let created = self.model.create_worker();
                let ready_at = self.clock.mono();
                match created {
                    Ok(worker) => {
                        for job in jobs.iter_mut() {
                            job.recorder.record_timer(stage::RESTART, restart_began_at, ready_at);
                        }
                        worker
                    }
                    Err(error) => {
                        let reason = format!("its worker could not be rebuilt after a panic: {error}");
                        let model = self.name.to_string();
                        return vec![Err(InferenceError::Failed { model, reason }); jobs.len()];
                    }
                }
            }
        };
        let job_count = jobs.len();
        self.current_computation.begin(jobs, self.clock.mono());
        // As a panic unwinds, it closes the open nodes of the recorders, which therefore stay usable. The worker is
        // discarded.
        let outcome = catch_unwind(AssertUnwindSafe(|| match jobs {
            [Job { sample, recorder, requester, .. }] => vec![worker.infer(sample, recorder, &**requester)],
            jobs => {
                let mut requests: Vec<_> = jobs.iter_mut().map(Request::from).collect();
                worker.infer_batch(&mut requests)
            }
        }));
        self.current_computation.end();
        match outcome {
            Ok(results) => {
                self.worker = Some(worker);
                results
            }
            Err(panic) => {
                let message = panic_message(panic.as_ref()).to_owned();
                vec![Err(InferenceError::Panicked { model: self.name.to_string(), message }); job_count]
            }
        }
    }
}

/// Calls a job's reply and catches its panics, so that a faulty receiver does not end a thread of the pool.
pub(crate) fn deliver(model: &Slug, reply: Reply, finished_job: FinishedJob) {
    if let Err(panic) = catch_unwind(AssertUnwindSafe(|| reply(finished_job))) {
        tracing::error!(%model, panic = panic_message(panic.as_ref()), "the receiver of a model's answer panicked");
    }
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a message")
}
