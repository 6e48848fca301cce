//! The end of an earlier process of which only the aggregator knows what is stored.

use super::super::unresolved::Resolved;
use super::super::{Gap, SentUnspooled, Totals, Unresolved};
use super::Sending;

/// From the start to the aggregator's first word it is unresolved; then the spool is told, and after that losses are reported.
#[derive(Clone, Debug)]
pub(super) struct Earlier {
    unresolved: Option<Unresolved>,
    /// What the totals of the spool have more than those counted here.
    resolved: Resolved,
    /// What the spool is still to be told.
    unwritten: Option<Vec<Gap>>,
}

impl Earlier {
    pub(super) fn new(unresolved: Option<Unresolved>) -> Self {
        Self { unresolved, resolved: Resolved::default(), unwritten: None }
    }

    pub(super) const fn resolved(&self) -> &Resolved {
        &self.resolved
    }

    /// What the spool is still to be told.
    pub(super) const fn unwritten(&self) -> Option<&Vec<Gap>> {
        self.unwritten.as_ref()
    }

    /// Events that were handed in and dropped, with those of the earlier process.
    pub(super) const fn count(&self, totals: &Totals) -> (u64, u64) {
        let Resolved { stored, lost, .. } = self.resolved;
        (totals.produced + stored + lost, totals.dropped + lost)
    }

    pub(super) const fn place(&self, sent: SentUnspooled) -> SentUnspooled {
        SentUnspooled {
            told: sent.told + self.resolved.told,
            events: sent.events + self.resolved.stored,
            ..sent
        }
    }
}

impl Sending {
    /// The aggregator has all up to this batch, which that process sent.
    pub(super) fn resolve_earlier(&mut self, number: u64, process: Option<u64>) {
        let Some(unresolved) = self.earlier.unresolved.take() else { return };
        let resolved = unresolved.resolve(number, process);
        self.backlog.add_stored(resolved.stored);
        let unreported = self.intake.resolve(&unresolved, &resolved);
        (self.earlier.resolved, self.earlier.unwritten) = (resolved, Some(unreported));
    }

    /// The spool was told.
    pub(super) fn resolution_written(&mut self) {
        self.earlier.unwritten = None;
        self.intake.resolution_written();
    }
}
