//! The change of the spool to a new stream.

use peernet_clock::{MonoTime, Span};

use super::Action;
use super::job::Job;
use super::spooler::EventSpooler;
use crate::StreamId;
use crate::totals::Reached;

/// Which stream the spool is to belong to, and who sent in the one at hand.
#[derive(Clone, Debug)]
pub(super) struct StreamRenewal {
    /// The stream that is to be gone on in; nothing is sent until the spool belongs to it.
    wanted: Option<StreamId>,
    job: Job<StreamId>,
    /// How far the processes before this one came in the stream at hand.
    reached_before: Vec<Reached>,
}

impl StreamRenewal {
    pub(super) fn new(reached_before: Vec<Reached>) -> Self {
        Self { wanted: None, job: Job::default(), reached_before }
    }

    /// Whether the stream at hand is to be left.
    pub(super) const fn is_wanted(&self) -> bool {
        self.wanted.is_some()
    }

    /// The stream at hand is to be left for a new one.
    pub(super) fn want(&mut self) {
        self.wanted = Some(StreamId::random());
    }

    /// How far the processes before this one came in the stream at hand.
    pub(super) fn reached_before(&self) -> &[Reached] {
        &self.reached_before
    }

    /// What is to be done now.
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

    /// When it may be tried again after a failure.
    pub(super) const fn again(&self) -> Option<MonoTime> {
        self.job.again()
    }

    /// The spool belongs to the new stream, in which nobody else ever sent; `None` when nothing was asked for.
    pub(super) fn end(&mut self) -> Option<StreamId> {
        let stream = self.job.end()?;
        (self.wanted, self.reached_before) = (None, Vec::new());
        Some(stream)
    }

    /// It does not; `None` when nothing was asked for.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        self.job.end()?;
        self.job.fail(now, pause);
        Some(())
    }
}
