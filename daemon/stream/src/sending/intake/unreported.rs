//! Losses of this process and of earlier processes that no gap reports yet.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Stamp};
use peernet_logger::{RunId, Slug};

use super::losses::Losses;
use crate::unresolved::ResolvedBatches;
use crate::{Gap, UnresolvedBatches};

/// Losses to be reported. Losses of earlier processes are reported first.
#[derive(Clone, Debug)]
pub(super) struct UnreportedLosses {
    losses: Losses,
    /// Losses of earlier processes, to be reported before all other losses.
    earlier_gaps: VecDeque<Gap>,
    /// Number of events that an earlier process dropped and did not report.
    earlier_drops: u64,
    /// `true` until the spool records which batches of an earlier process the aggregator stored. No loss is reported
    /// before that.
    is_unresolved: bool,
}

impl UnreportedLosses {
    pub(super) fn new(earlier_gaps: Vec<Gap>, earlier_drops: u64, is_unresolved: bool) -> Self {
        Self { losses: Losses::default(), earlier_gaps: earlier_gaps.into(), earlier_drops, is_unresolved }
    }

    /// Adds events that are lost now.
    pub(super) fn add(
        &mut self,
        (pipeline, run): (Option<Slug>, Option<RunId>),
        count: u64,
        reason: String,
        now: Stamp,
    ) {
        self.losses.add(pipeline, run, now, count, reason);
    }

    /// Adds the events of `gap`. Another component dropped these events and reported no gap.
    pub(super) fn add_gap(&mut self, gap: Gap, now: Stamp) {
        self.losses.add_gap(gap, now);
    }

    /// Adds the events that earlier processes dropped and did not report, as soon as losses may be reported. Later
    /// calls add nothing.
    pub(super) fn add_earlier_drops(&mut self, now: Stamp) {
        if self.is_unresolved {
            return;
        }
        let count = std::mem::take(&mut self.earlier_drops);
        if count > 0 {
            // The spool has the number of these events only. They may have been dropped for any reason.
            let reason = "dropped before the agent last stopped; the reason was not stored";
            self.losses.add(None, None, now, count, reason.to_owned());
        }
    }

    /// Returns whether losses may be reported.
    pub(super) const fn may_report(&self) -> bool {
        !self.is_unresolved
    }

    /// Returns the number of gaps to be reported, now or later.
    pub(super) fn len(&self) -> usize {
        self.losses.len() + self.earlier_gaps.len()
    }

    /// Returns the time of the next report.
    pub(super) fn next_report_at(&self) -> Option<MonoTime> {
        match self.earlier_gaps.is_empty() {
            true => self.losses.next_report_at(),
            // Gaps of earlier processes are due at once.
            false => Some(MonoTime::default()),
        }
    }

    /// Returns the next due gap, and records it as reported.
    pub(super) fn take_due(&mut self, now: MonoTime) -> Option<Gap> {
        self.earlier_gaps.pop_front().or_else(|| self.losses.take_due(now))
    }

    /// Returns the next gap of the losses that end now: the losses of `run`, or all losses if `run` is `None`. Records
    /// the gap as reported.
    pub(super) fn take_ended(&mut self, run: Option<RunId>, now: MonoTime) -> Option<Gap> {
        // The spool stores only the number of reported events. The order of reports is therefore fixed: losses of
        // earlier processes are reported first.
        self.earlier_gaps.pop_front().or_else(|| self.losses.take_ended(run, now))
    }

    /// Records which batches of an earlier process the aggregator stored. Returns the losses of all earlier processes
    /// that no gap reports.
    pub(super) fn resolve(&mut self, unresolved: &UnresolvedBatches, resolved: &ResolvedBatches) -> Vec<Gap> {
        unresolved.update_unreported(resolved, &mut self.earlier_gaps, &mut self.earlier_drops);
        self.earlier_gaps.iter().cloned().collect()
    }

    /// Records that the spool contains the gaps that [`resolve`](Self::resolve) returned.
    pub(super) const fn record_resolution_written(&mut self) {
        self.is_unresolved = false;
    }

    /// Returns whether no loss is to be reported, now or later.
    #[cfg(test)]
    pub(super) fn is_empty(&self) -> bool {
        self.len() == 0 && self.earlier_drops == 0
    }
}
