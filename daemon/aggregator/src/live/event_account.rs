//! What became of the events of a host: by its own word, and by that of the database.

use peernet_clock::{MonoTime, Span, WallTime};
use peernet_store::Stored;
use peernet_stream::Accounting;

use super::bounds;
use super::catching_up::Lag;
use crate::picture::Arrivals;

/// The events of one host: made, waiting, arrived and stored.
#[derive(Debug, Default)]
pub(super) struct EventAccount {
    accounting: Accounting,
    lag: Lag,
    stored: Stored,
    arrivals: Arrivals,
    /// The newest moment that is stored, on the host's clock.
    newest_stored: Option<WallTime>,
}

impl EventAccount {
    /// The host tells its account, `sent` at that time by its clock.
    pub(super) fn update(&mut self, accounting: Accounting, sent: WallTime, now: MonoTime) {
        self.accounting = accounting;
        bounds::accounting(&mut self.accounting);
        self.lag.observe(self.behind(Some(sent)), self.accounting.stored, now);
    }

    /// The database tells what it holds.
    pub(super) fn store(&mut self, stored: Stored, newest: Option<WallTime>) {
        self.stored = Stored { duplicates: self.stored.duplicates, ..stored };
        self.newest_stored = self.newest_stored.max(newest);
    }

    /// A batch came again.
    pub(super) const fn add_duplicate(&mut self) {
        self.stored.duplicates += 1;
    }

    /// A batch came and was not taken.
    pub(super) fn add_arrival(&mut self, count: impl FnOnce(&mut Arrivals)) {
        count(&mut self.arrivals);
    }

    /// How far storing is behind measuring, by the host's own clock.
    pub(super) fn behind(&self, sent: Option<WallTime>) -> Option<Span> {
        let oldest = self.accounting.oldest.filter(|_| self.accounting.waiting > 0);
        sent.zip(oldest).map(|(sent, oldest)| (sent - oldest).max(Span::ZERO))
    }

    /// How the backlog changes.
    pub(super) const fn lag(&self) -> &Lag {
        &self.lag
    }

    /// The host's own account.
    pub(super) const fn accounting(&self) -> &Accounting {
        &self.accounting
    }

    /// What the database was last said to hold.
    pub(super) const fn stored(&self) -> Stored {
        self.stored
    }

    pub(super) const fn arrivals(&self) -> Arrivals {
        self.arrivals
    }

    /// The newest moment that is stored, on the host's clock.
    pub(super) const fn newest_stored(&self) -> Option<WallTime> {
        self.newest_stored
    }
}
