//! What became of the events, in this machine and before it.

use peernet_stream::Accounting;

use super::Sender;
use crate::outbox::farewell::Standing;

impl Sender {
    pub(super) fn standing(&self) -> Standing {
        let account = self.machine.accounting();
        Standing {
            spooled: self.machine.is_spooled(),
            away: self.away,
            stored: account.stored,
            waiting: account.waiting,
        }
    }

    /// The machine's account and what has not reached it.
    pub(super) fn count(&self) -> Accounting {
        let mut account = self.machine.accounting();
        let (queued, dropped) = (self.exit.queue.len() as u64, self.exit.overflow.dropped());
        account.produced += queued + dropped;
        account.waiting += queued;
        account.dropped += dropped;
        account
    }

    pub(super) fn publish(&mut self) {
        let account = self.count();
        self.reports.account(&account, self.clock.mono());
        self.accounting.send_if_modified(|shown| {
            let changed = *shown != account;
            *shown = account;
            changed
        });
    }
}
