//! What goes into a pool and what comes out.

use std::fmt;

use peernet_clock::MonoTime;
use peernet_logger::Recorder;
use peernet_sample::Sample;

use crate::InferenceError;

/// One sample to compute on.
pub struct Job {
    /// The input.
    pub sample: Sample,
    /// Where the stages are recorded; it comes back in [`Done`].
    pub log: Recorder,
    /// When the sample was received here: the stage `queue` begins at this moment.
    pub received: MonoTime,
    /// Called once with the result, on the thread that computed it: it must not block.
    pub reply: Reply,
}

/// What is called with a result.
pub(crate) type Reply = Box<dyn FnOnce(Done) + Send>;

/// A finished job.
pub struct Done {
    /// The recorder of the job, with the stages of the model.
    pub log: Recorder,
    /// The answer, or why there is none.
    pub result: Result<Sample, InferenceError>,
}

/// A job that a pool did not take; its `reply` was not called.
pub struct Refused {
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

impl fmt::Debug for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Refused").field("reason", &self.reason).finish_non_exhaustive()
    }
}
