//! Batches that are in the spool and in memory, ready to be sent.

use std::collections::VecDeque;

use crate::spool::{SpooledBatch, Usage};

/// Contiguous batches of the spool that are kept in memory, beginning with the oldest that is held.
#[derive(Clone, Debug)]
pub(super) struct ReadyBatches {
    batches: VecDeque<SpooledBatch>,
    usage: Usage,
    /// Bytes from which on the file is not read ahead.
    budget: u64,
}

impl ReadyBatches {
    pub(super) const fn new(budget: u64) -> Self {
        Self { batches: VecDeque::new(), usage: Usage { events: 0, bytes: 0 }, budget }
    }

    pub(super) fn len(&self) -> usize {
        self.batches.len()
    }

    /// Events and bytes of all of them.
    pub(super) const fn usage(&self) -> Usage {
        self.usage
    }

    /// Bytes that are read at once: a quarter of what is kept, so that the next part is read while the others are under
    /// way.
    pub(super) const fn part_bytes(&self) -> u64 {
        self.budget / 4
    }

    /// Whether so many more bytes may be kept.
    pub(super) const fn has_room(&self, bytes: u64) -> bool {
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

    /// Adds the batch that follows the last one.
    pub(super) fn push(&mut self, batch: SpooledBatch) {
        self.usage = self.usage + batch.usage();
        self.batches.push_back(batch);
    }

    /// Removes the first batch, if its number is `through` or lower.
    pub(super) fn pop_through(&mut self, through: u64) -> Option<SpooledBatch> {
        let batch = self.batches.pop_front_if(|batch| batch.number <= through)?;
        self.usage = self.usage - batch.usage();
        Some(batch)
    }
}
