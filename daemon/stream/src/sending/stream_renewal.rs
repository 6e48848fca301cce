//! The move of the spool to a new stream.

use peernet_clock::{MonoTime, Span};

use super::Action;
use super::job::Job;
use super::spooler::EventSpooler;
use crate::StreamId;
use crate::totals::NewestSentBatch;

/// Stream that the spool is moved to, and the processes that sent in the current one.
#[derive(Clone, Debug)]
pub(super) struct StreamRenewal {
    /// Stream to continue in. Nothing is sent until the spool belongs to it.
    wanted: Option<StreamId>,
    job: Job<StreamId>,
    /// Batches that earlier processes may have sent in the current stream.
    reached_before: Vec<NewestSentBatch>,
}

impl StreamRenewal {
    pub(super) fn new(reached_before: Vec<NewestSentBatch>) -> Self {
        Self { wanted: None, job: Job::default(), reached_before }
    }

    /// Returns whether the current stream is to be left.
    pub(super) const fn is_wanted(&self) -> bool {
        self.wanted.is_some()
    }

    /// Requests the move from the current stream to a new one.
    pub(super) fn want(&mut self) {
        self.wanted = Some(StreamId::random());
    }

    /// Returns the batches that earlier processes may have sent in the current stream.
    pub(super) fn reached_before(&self) -> &[NewestSentBatch] {
        &self.reached_before
    }

    /// Returns the next action.
    pub(super) fn next(&mut self, spooler: &EventSpooler, now: MonoTime) -> Option<Action> {
        let stream = self.wanted?;
        if !spooler.may_renew() || !self.job.is_free(now) {
            return None;
        }
        self.job.begin(stream);
        Some(Action::Renew {
            stream,
            previous: spooler.backlog.origin.stream,
            first: spooler.backlog.oldest(),
            events_before_first: spooler.backlog.stored(),
        })
    }

    /// Returns the time of the next attempt after a failure.
    pub(super) const fn again(&self) -> Option<MonoTime> {
        self.job.again()
    }

    /// Ends the move successfully: no other process has sent in the new stream. `None` if none was requested.
    pub(super) fn end(&mut self) -> Option<StreamId> {
        let stream = self.job.end()?;
        (self.wanted, self.reached_before) = (None, Vec::new());
        Some(stream)
    }

    /// Ends the move as failed; `None` if none was requested.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        self.job.end()?;
        self.job.fail(now, pause);
        Some(())
    }
}
