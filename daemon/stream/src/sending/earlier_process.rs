//! The end of an earlier process of which only the aggregator knows what is stored.

use super::super::unresolved::Resolved;
use super::super::{Gap, SentUnspooled, Totals, Unresolved};

/// From the start to the aggregator's first word it is unresolved; then the spool is told, and after that losses are reported.
#[derive(Clone, Debug)]
pub(super) struct EarlierProcess {
    unresolved: Option<Unresolved>,
    /// What the totals of the spool have more than those counted here.
    resolved: Resolved,
    /// What the spool is still to be told.
    unwritten: Option<Vec<Gap>>,
}

impl EarlierProcess {
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

    /// The aggregator has all up to this batch, which that process sent: what was unresolved until now and what became of it.
    pub(super) fn resolve(&mut self, number: u64, process: Option<u64>) -> Option<(Unresolved, Resolved)> {
        let unresolved = self.unresolved.take()?;
        let resolved = unresolved.resolve(number, process);
        Some((unresolved, resolved))
    }

    /// The spool is to be told what became of it, and of losses that no gap reports.
    pub(super) fn write(&mut self, resolved: Resolved, unreported: Vec<Gap>) {
        (self.resolved, self.unwritten) = (resolved, Some(unreported));
    }

    /// The spool was told.
    pub(super) fn written(&mut self) {
        self.unwritten = None;
    }
}
