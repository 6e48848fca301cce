//! Losses that no gap reports yet, of this process and of those before it.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Stamp};
use peernet_logger::{RunId, Slug};

use super::losses::Losses;
use crate::unresolved::Resolved;
use crate::{Gap, Unresolved};

/// Losses that are still to be reported: those of earlier processes first.
#[derive(Clone, Debug)]
pub(super) struct UnreportedLosses {
    losses: Losses,
    /// Losses of earlier processes, to be reported before all others.
    owed: VecDeque<Gap>,
    /// Events that a process before this one dropped and did not tell of otherwise.
    untold: u64,
    /// No loss is reported before it is known what became of the end of an earlier process.
    is_unresolved: bool,
}

impl UnreportedLosses {
    pub(super) fn new(owed: Vec<Gap>, untold: u64, is_unresolved: bool) -> Self {
        Self { losses: Losses::default(), owed: owed.into(), untold, is_unresolved }
    }

    /// Adds events that were lost now.
    pub(super) fn add(
        &mut self,
        (pipeline, run): (Option<Slug>, Option<RunId>),
        count: u64,
        reason: String,
        now: Stamp,
    ) {
        self.losses.add(pipeline, run, now, count, reason);
    }

    /// Adds events that were dropped elsewhere.
    pub(super) fn add_gap(&mut self, gap: Gap, now: Stamp) {
        self.losses.add_gap(gap, now);
    }

    /// Adds what was dropped before the start, once, as soon as anything happens after it.
    pub(super) fn add_untold(&mut self, now: Stamp) {
        if self.is_unresolved {
            return;
        }
        let count = std::mem::take(&mut self.untold);
        if count > 0 {
            let reason = "dropped before the agent last ended, for want of room in its spool";
            self.losses.add(None, None, now, count, reason.to_owned());
        }
    }

    /// Whether losses may be reported.
    pub(super) const fn may_report(&self) -> bool {
        !self.is_unresolved
    }

    /// Number of gaps that there are to report, now or later.
    pub(super) fn len(&self) -> usize {
        self.losses.len() + self.owed.len()
    }

    /// When there is something to report.
    pub(super) fn due(&self) -> Option<MonoTime> {
        match self.owed.is_empty() {
            true => self.losses.due(),
            false => Some(MonoTime::default()),
        }
    }

    /// The next gap that is due; it then counts as reported.
    pub(super) fn take_due(&mut self, now: MonoTime) -> Option<Gap> {
        self.owed.pop_front().or_else(|| self.losses.take_due(now))
    }

    /// The next gap of losses that end now: those of a run, or all.
    pub(super) fn take_ended(&mut self, run: Option<RunId>, now: MonoTime) -> Option<Gap> {
        // What earlier processes lost goes first: by the number of events told the spool knows which of it is reported.
        self.owed.pop_front().or_else(|| self.losses.take_ended(run, now))
    }

    /// It is known what became of the end of an earlier process. Returns the losses of all earlier ones that no gap reports.
    pub(super) fn resolve(&mut self, unresolved: &Unresolved, resolved: &Resolved) -> Vec<Gap> {
        unresolved.unreported(resolved, &mut self.owed, &mut self.untold);
        self.owed.iter().cloned().collect()
    }

    /// The spool has what [`resolve`](Self::resolve) returned.
    pub(super) const fn resolution_written(&mut self) {
        self.is_unresolved = false;
    }

    /// Whether nothing is to be reported, now or later.
    #[cfg(test)]
    pub(super) fn is_empty(&self) -> bool {
        self.len() == 0 && self.untold == 0
    }
}
