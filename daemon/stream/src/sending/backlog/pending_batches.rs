//! Batches that are in memory only.

use std::collections::VecDeque;

use crate::spool::{SpooledBatch, Usage};
use crate::totals::Totals;

/// A batch that is not in the spool yet.
#[derive(Clone, Debug)]
pub(super) struct PendingBatch {
    pub(super) batch: SpooledBatch,
    /// What was counted up to its last event.
    pub(super) totals: Totals,
}

/// Contiguous batches that are in memory only, up to the newest.
#[derive(Clone, Debug, Default)]
pub(super) struct PendingBatches {
    batches: VecDeque<PendingBatch>,
    usage: Usage,
}

impl PendingBatches {
    /// Events and bytes of all of them.
    pub(super) const fn usage(&self) -> Usage {
        self.usage
    }

    pub(super) fn front(&self) -> Option<&SpooledBatch> {
        self.batches.front().map(|pending| &pending.batch)
    }

    /// The batch of this number.
    pub(super) fn get(&self, number: u64) -> Option<&PendingBatch> {
        self.batches.get(number.checked_sub(self.front()?.number)? as usize)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &SpooledBatch> {
        self.batches.iter().map(|pending| &pending.batch)
    }

    pub(super) fn push(&mut self, batch: SpooledBatch, totals: Totals) {
        self.usage = self.usage + batch.usage();
        self.batches.push_back(PendingBatch { batch, totals });
    }

    /// Removes the first batch, if its number is `through` or lower.
    pub(super) fn pop_through(&mut self, through: u64) -> Option<PendingBatch> {
        let pending = self.batches.pop_front_if(|pending| pending.batch.number <= through)?;
        self.usage = self.usage - pending.batch.usage();
        Some(pending)
    }

    /// What the next transaction of the spool is to hold: the first batches up to so many bytes, and what was counted up
    /// to the last of them.
    pub(super) fn to_append(&self, most: usize, most_bytes: u64) -> Option<(Vec<SpooledBatch>, Totals)> {
        let mut bytes = 0;
        let chosen = self.batches.iter().take(most).take_while(|pending| {
            let first = bytes == 0;
            bytes += pending.batch.body.len() as u64;
            first || bytes <= most_bytes
        });
        let mut totals = None;
        let batches: Vec<_> =
            chosen.map(|pending| (totals = Some(&pending.totals), pending.batch.clone()).1).collect();
        Some((batches, totals?.clone()))
    }
}
