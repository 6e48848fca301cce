//! Batches of the spool of which a copy is in memory, ready to be sent.

use std::collections::VecDeque;

use crate::spool::{SpooledBatch, Usage};

/// Contiguous batches of the spool of which a copy is in memory, from the oldest unacknowledged batch on.
#[derive(Clone, Debug)]
pub(super) struct ReadyBatches {
    batches: VecDeque<SpooledBatch>,
    usage: Usage,
    /// Number of ready bytes at which reading ahead from the file stops.
    budget: u64,
}

impl ReadyBatches {
    pub(super) const fn new(budget: u64) -> Self {
        Self { batches: VecDeque::new(), usage: Usage { events: 0, bytes: 0 }, budget }
    }

    pub(super) fn len(&self) -> usize {
        self.batches.len()
    }

    /// Returns the number of events and bytes of all batches.
    pub(super) const fn usage(&self) -> Usage {
        self.usage
    }

    /// Returns the number of bytes of one read: a quarter of the budget, so that the next batches are read
    /// while earlier batches are in flight.
    pub(super) const fn read_bytes(&self) -> u64 {
        self.budget / 4
    }

    /// Returns whether `bytes` more bytes fit into the budget.
    pub(super) const fn has_capacity(&self, bytes: u64) -> bool {
        self.usage.bytes + bytes <= self.budget
    }

    pub(super) fn front(&self) -> Option<&SpooledBatch> {
        self.batches.front()
    }

    pub(super) fn get(&self, index: usize) -> Option<&SpooledBatch> {
        self.batches.get(index)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &SpooledBatch> {
        self.batches.iter()
    }

    /// Adds the batch that follows the last batch.
    pub(super) fn push(&mut self, batch: SpooledBatch) {
        self.usage = self.usage + batch.usage();
        self.batches.push_back(batch);
    }

    /// Removes and returns the first batch if its number is at most `through`.
    pub(super) fn pop_through(&mut self, through: u64) -> Option<SpooledBatch> {
        let batch = self.batches.pop_front_if(|batch| batch.number <= through)?;
        self.usage = self.usage - batch.usage();
        Some(batch)
    }
}
