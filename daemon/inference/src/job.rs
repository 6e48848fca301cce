//! Jobs of a pool and their results.

use std::fmt;
use std::sync::Arc;

use peernet_clock::MonoTime;
use peernet_logger::Recorder;
use peernet_sample::Sample;

use crate::{InferenceError, Requester, UncancelledRequester};

/// Sample for which a model computes an answer, with its recorder and its callback.
pub struct Job {
    /// The input.
    pub sample: Sample,
    /// Recorder of the stages; it is returned in [`FinishedJob`].
    pub recorder: Recorder,
    /// Time at which this host received the sample: the start of the stage `queue`.
    pub received_at: MonoTime,
    /// Receiver of partial answers, which may cancel the request.
    pub requester: Arc<dyn Requester>,
    /// Callback for the result. The pool calls it once, on any thread; it must not block.
    pub reply: Reply,
}

impl Job {
    /// Returns a job whose requester takes no partial answers and never cancels.
    pub fn for_whole_answer(sample: Sample, recorder: Recorder, received_at: MonoTime, reply: Reply) -> Self {
        Self { sample, recorder, received_at, requester: Arc::new(UncancelledRequester), reply }
    }
}

/// Callback for the result of a job.
pub type Reply = Box<dyn FnOnce(FinishedJob) + Send>;

/// Finished job.
pub struct FinishedJob {
    /// The recorder of the job, with the stages of the model.
    pub recorder: Recorder,
    /// The answer, or the error.
    pub result: Result<Sample, InferenceError>,
}

/// Job that a pool did not accept; its `reply` was not called.
pub struct RefusedJob {
    /// The job as it was submitted.
    pub job: Box<Job>,
    /// [`InferenceError::QueueFull`] or [`InferenceError::Stopped`].
    pub reason: InferenceError,
}

impl fmt::Debug for Job {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Job").field("source", &self.sample.source).finish_non_exhaustive()
    }
}

impl fmt::Debug for RefusedJob {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RefusedJob").field("reason", &self.reason).finish_non_exhaustive()
    }
}
