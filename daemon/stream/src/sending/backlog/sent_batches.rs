//! Record of the batches that this process has sent.

use crate::SentUnspooled;
use crate::spool::SpooledBatch;

/// Position up to which this process has sent, and the number of sent events without an acknowledgement.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SentBatches {
    /// Number of the newest batch that this process has sent; 0 before the first batch is sent.
    newest: u64,
    /// Last batch that was sent while it was in memory only.
    unspooled: Option<SentUnspooled>,
    /// Number of events of the batches that were sent and not acknowledged.
    events: u64,
}

impl SentBatches {
    pub(super) const fn newest(&self) -> u64 {
        self.newest
    }

    pub(super) const fn unspooled(&self) -> Option<SentUnspooled> {
        self.unspooled
    }

    pub(super) const fn events(&self) -> u64 {
        self.events
    }

    /// Records that a batch is sent. A batch that is sent again counts once.
    pub(super) fn record(&mut self, number: u64, events: u32, unspooled: Option<SentUnspooled>) {
        self.unspooled = unspooled.or(self.unspooled);
        if number > self.newest {
            self.newest = number;
            self.events += u64::from(events);
        }
    }

    /// Records that a batch was acknowledged or dropped.
    pub(super) const fn forget(&mut self, batch: &SpooledBatch) {
        if batch.number <= self.newest {
            self.events = self.events.saturating_sub(batch.events as u64);
        }
    }
}
