//! The move of the spool to a new stream.

use peernet_clock::{MonoTime, Span};

use super::Action;
use super::job::Job;
use super::spooler::EventSpooler;
use crate::StreamId;
use crate::totals::NewestSendableBatch;

/// Move of the spool to a new stream, and the newest batches that earlier processes may have sent in the current
/// stream.
#[derive(Clone, Debug)]
pub(super) struct StreamRenewal {
    /// New stream, if the move is requested. Nothing is sent until the spool belongs to the new stream.
    requested: Option<StreamId>,
    job: Job<StreamId>,
    /// For each earlier process, the newest batch that it may have sent in the current stream.
    newest_sendable_of_earlier_processes: Vec<NewestSendableBatch>,
}

impl StreamRenewal {
    pub(super) fn new(newest_sendable_of_earlier_processes: Vec<NewestSendableBatch>) -> Self {
        Self { requested: None, job: Job::default(), newest_sendable_of_earlier_processes }
    }

    /// Returns whether the current stream is to be left.
    pub(super) const fn is_requested(&self) -> bool {
        self.requested.is_some()
    }

    /// Requests the move from the current stream to a new stream.
    pub(super) fn request(&mut self) {
        self.requested = Some(StreamId::random());
    }

    /// Returns, for each earlier process, the newest batch that it may have sent in the current stream.
    pub(super) fn newest_sendable_of_earlier_processes(&self) -> &[NewestSendableBatch] {
        &self.newest_sendable_of_earlier_processes
    }

    /// Returns the next action.
    pub(super) fn next(&mut self, spooler: &EventSpooler, now: MonoTime) -> Option<Action> {
        let stream = self.requested?;
        if !spooler.may_renew() || !self.job.may_start(now) {
            return None;
        }
        self.job.start(stream);
        Some(Action::Renew {
            stream,
            previous_stream: spooler.backlog.origin.stream,
            first: spooler.backlog.oldest(),
            events_before_first: spooler.backlog.stored_events(),
        })
    }

    /// Returns the time of the next attempt after a failure.
    pub(super) const fn retry_at(&self) -> Option<MonoTime> {
        self.job.retry_at()
    }

    /// Ends the move successfully, and returns the new stream, in which no earlier process has sent. `None` if no move
    /// was requested.
    pub(super) fn finish(&mut self) -> Option<StreamId> {
        let stream = self.job.end()?;
        (self.requested, self.newest_sendable_of_earlier_processes) = (None, Vec::new());
        Some(stream)
    }

    /// Ends the move as failed; `None` if no move was requested.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        self.job.is_in_progress().then(|| self.job.fail(now, pause))
    }
}
