//! The last batches of an earlier process. Only the aggregator knows which of these batches are stored.

use super::super::unresolved::ResolvedBatches;
use super::super::{Gap, SentUnspooled, Totals, UnresolvedBatches};

/// The last batches of an earlier process, until the spool records which of these batches are stored. The aggregator's
/// first welcome states which are stored. The result is then written to the spool. Losses are reported only after this
/// write, so that each loss is reported once even if a process is killed in between.
#[derive(Clone, Debug)]
pub(super) struct EarlierProcess {
    unresolved: Option<UnresolvedBatches>,
    /// Counts that are added to the counts of this process when the spool's totals are written.
    resolved: ResolvedBatches,
    /// Gaps that must still be written to the spool.
    unwritten: Option<Vec<Gap>>,
}

impl EarlierProcess {
    pub(super) fn new(unresolved: Option<UnresolvedBatches>) -> Self {
        Self { unresolved, resolved: ResolvedBatches::default(), unwritten: None }
    }

    pub(super) const fn resolved(&self) -> &ResolvedBatches {
        &self.resolved
    }

    /// Returns the gaps that must still be written to the spool.
    pub(super) const fn unwritten_gaps(&self) -> Option<&Vec<Gap>> {
        self.unwritten.as_ref()
    }

    /// Returns the number of produced events and the number of dropped events ([`Totals`]), including events of the
    /// earlier process.
    pub(super) const fn produced_and_dropped(&self, totals: &Totals) -> (u64, u64) {
        let ResolvedBatches { stored, lost, .. } = self.resolved;
        (totals.produced + stored + lost, totals.dropped + lost)
    }

    /// Returns the counts of a sent batch, including the events of the earlier process.
    pub(super) const fn with_earlier_events(&self, sent: SentUnspooled) -> SentUnspooled {
        SentUnspooled {
            reported_drops: sent.reported_drops + self.resolved.reported_drops,
            events: sent.events + self.resolved.stored,
            ..sent
        }
    }

    /// Resolves the batches of the earlier process. The aggregator has stored all batches up to batch `number`, which
    /// `process` sent. Returns the unresolved batches and the result.
    pub(super) fn resolve(
        &mut self,
        number: u64,
        process: Option<u64>,
    ) -> Option<(UnresolvedBatches, ResolvedBatches)> {
        let unresolved = self.unresolved.take()?;
        let resolved = unresolved.resolve(number, process);
        Some((unresolved, resolved))
    }

    /// Sets the result that must be written to the spool, with the losses that no gap reports.
    pub(super) fn set_result(&mut self, resolved: ResolvedBatches, unreported: Vec<Gap>) {
        (self.resolved, self.unwritten) = (resolved, Some(unreported));
    }

    /// Records that the result was written to the spool.
    pub(super) fn record_written(&mut self) {
        self.unwritten = None;
    }
}
