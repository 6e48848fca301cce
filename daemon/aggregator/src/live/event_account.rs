//! The events of one host, as counted by the host and by the database.

use peernet_clock::{MonoTime, Span, WallTime};
use peernet_store::StoredCounts;
use peernet_stream::Accounting;

use super::lag_estimator::LagEstimator;
use super::limits;
use crate::live_state::RejectedBatches;

/// The events of one host: produced, waiting, rejected and stored.
#[derive(Debug, Default)]
pub(super) struct EventAccount {
    /// The host's own counts.
    accounting: Accounting,
    lag_estimator: LagEstimator,
    /// The database's counts.
    stored: StoredCounts,
    /// Numbers of batches that arrived and were not stored.
    rejected_batches: RejectedBatches,
    /// Time of the newest stored event on the host's clock.
    newest_stored: Option<WallTime>,
}

impl EventAccount {
    /// Replaces the host's counts by the counts of an update that was sent at `sent` on the host's clock.
    pub(super) fn update(&mut self, accounting: Accounting, sent: WallTime, now: MonoTime) {
        self.accounting = accounting;
        limits::limit_accounting(&mut self.accounting);
        self.lag_estimator.observe(self.storage_lag(Some(sent)), self.accounting.stored, now);
    }

    /// Replaces the database's counts. Duplicates are counted here, because they do not reach the database.
    pub(super) fn update_stored(&mut self, stored: StoredCounts, newest: Option<WallTime>) {
        self.stored = StoredCounts { duplicates: self.stored.duplicates, ..stored };
        self.newest_stored = self.newest_stored.max(newest);
    }

    /// Counts a duplicate batch.
    pub(super) const fn add_duplicate(&mut self) {
        self.stored.duplicates += 1;
    }

    /// Counts a batch that arrived and was not stored. `count` increments the count of the reason:
    /// deferred or damaged.
    pub(super) fn add_rejected(&mut self, count: impl FnOnce(&mut RejectedBatches)) {
        count(&mut self.rejected_batches);
    }

    /// Returns the storage lag on the host's clock at `sent`, the time of an update; `None` if no events wait.
    pub(super) fn storage_lag(&self, sent: Option<WallTime>) -> Option<Span> {
        let oldest = self.accounting.oldest.filter(|_| self.accounting.waiting > 0);
        sent.zip(oldest).map(|(sent, oldest)| (sent - oldest).max(Span::ZERO))
    }

    /// Returns the estimator of the storage lag's decrease.
    pub(super) const fn lag_estimator(&self) -> &LagEstimator {
        &self.lag_estimator
    }

    /// Returns the host's counts.
    pub(super) const fn accounting(&self) -> &Accounting {
        &self.accounting
    }

    /// Returns the latest counts of the database.
    pub(super) const fn stored(&self) -> StoredCounts {
        self.stored
    }

    /// Returns the numbers of batches that arrived and were not stored.
    pub(super) const fn rejected_batches(&self) -> RejectedBatches {
        self.rejected_batches
    }

    /// Returns the time of the newest stored event on the host's clock.
    pub(super) const fn newest_stored(&self) -> Option<WallTime> {
        self.newest_stored
    }
}
