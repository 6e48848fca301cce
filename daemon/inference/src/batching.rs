//! Limits and requests of a batch.

use std::time::Duration;

use peernet_logger::Recorder;
use peernet_sample::Sample;

use crate::{Job, Requester};

/// Limits of a batch, the requests that a worker computes together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Batching {
    /// Maximum number of requests.
    pub max_size: usize,
    /// Longest time for which the first request of a batch waits for further requests.
    pub max_wait: Duration,
}

impl Batching {
    /// No batches: each request is computed alone.
    pub const OFF: Self = Self { max_size: 1, max_wait: Duration::ZERO };

    /// Returns whether several requests may be computed together.
    pub const fn is_on(self) -> bool {
        self.max_size > 1
    }
}

/// One request of a batch.
pub struct Request<'a> {
    /// The input.
    pub sample: &'a Sample,
    /// Recorder of the stages.
    pub recorder: &'a mut Recorder,
    /// Receiver of partial answers.
    pub requester: &'a dyn Requester,
}

impl<'a> From<&'a mut Job> for Request<'a> {
    fn from(job: &'a mut Job) -> Self {
        Self { sample: &job.sample, recorder: &mut job.recorder, requester: &*job.requester }
    }
}
