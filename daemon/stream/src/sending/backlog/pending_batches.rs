//! Batches that are in memory only.

use std::collections::VecDeque;

use crate::spool::{SpooledBatch, Usage};
use crate::totals::Totals;

/// A batch that is not in the spool yet.
#[derive(Clone, Debug)]
pub(super) struct PendingBatch {
    pub(super) batch: SpooledBatch,
    /// Totals up to the last event of the batch.
    pub(super) totals: Totals,
}

/// Contiguous batches that are in memory only, up to the newest batch.
#[derive(Clone, Debug, Default)]
pub(super) struct PendingBatches {
    batches: VecDeque<PendingBatch>,
    usage: Usage,
}

impl PendingBatches {
    /// Returns the number of events and bytes of all batches.
    pub(super) const fn usage(&self) -> Usage {
        self.usage
    }

    pub(super) fn front(&self) -> Option<&SpooledBatch> {
        self.batches.front().map(|pending| &pending.batch)
    }

    /// Returns the batch with a number.
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

    /// Removes and returns the first batch if its number is at most `through`.
    pub(super) fn pop_through(&mut self, through: u64) -> Option<PendingBatch> {
        let pending = self.batches.pop_front_if(|pending| pending.batch.number <= through)?;
        self.usage = self.usage - pending.batch.usage();
        Some(pending)
    }

    /// Returns the batches for the spool's next transaction, with a limit on their number and bytes, and the totals up
    /// to the last of these batches.
    pub(super) fn next_append(
        &self,
        max_batches: usize,
        max_bytes: u64,
    ) -> Option<(Vec<SpooledBatch>, Totals)> {
        let mut bytes = 0;
        let chosen = self.batches.iter().take(max_batches).take_while(|pending| {
            let is_first = bytes == 0;
            bytes += pending.batch.body.len() as u64;
            // At least one batch is chosen, even if this batch alone exceeds the limit.
            is_first || bytes <= max_bytes
        });
        // Totals of the last chosen batch.
        let mut totals = None;
        let batches: Vec<_> =
            chosen.map(|pending| (totals = Some(&pending.totals), pending.batch.clone()).1).collect();
        Some((batches, totals?.clone()))
    }
}
