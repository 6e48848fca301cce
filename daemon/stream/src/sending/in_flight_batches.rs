//! Batches that were sent and are not acknowledged.

use std::collections::VecDeque;

use super::super::{MAX_IN_FLIGHT_BATCHES, batch_weight};

/// A batch in flight.
#[derive(Clone, Copy, Debug)]
struct InFlightBatch {
    number: u64,
    /// Share of the window that the batch takes ([`batch_weight`]).
    weight: u64,
    /// Number of bytes of the batch's frame.
    frame_bytes: u64,
    /// Position in the connection after the last byte of the batch; 0 until the whole batch was handed over.
    end: u64,
}

/// Contiguous batches in flight, and the sum of their weights.
#[derive(Clone, Debug, Default)]
pub(super) struct InFlightBatches {
    batches: VecDeque<InFlightBatch>,
    weight: u64,
}

impl InFlightBatches {
    /// Returns whether a batch with a body of `body_bytes` must wait, if batches of a total weight of at most `window`
    /// may be in flight.
    pub(super) fn is_full(&self, body_bytes: usize, window: u64) -> bool {
        let exceeds_limit =
            self.weight + batch_weight(body_bytes) > window || self.batches.len() >= MAX_IN_FLIGHT_BATCHES;
        // One batch may always be in flight, or a batch larger than the window would never be sent.
        exceeds_limit && !self.batches.is_empty()
    }

    pub(super) fn push(&mut self, number: u64, body_bytes: usize, frame_bytes: usize) {
        let weight = batch_weight(body_bytes);
        self.weight += weight;
        self.batches.push_back(InFlightBatch { number, weight, frame_bytes: frame_bytes as u64, end: 0 });
    }

    /// Records that the whole last batch was handed over to the connection. `end` is the position in the connection
    /// after the batch's last byte.
    pub(super) fn record_handed_over(&mut self, end: u64) {
        if let Some(batch) = self.batches.back_mut() {
            batch.end = end;
        }
    }

    /// Removes the batches up to `through`. Returns the number of bytes of their frames, and the position in the
    /// connection after the last removed batch.
    pub(super) fn remove_through(&mut self, through: u64) -> (u64, u64) {
        let (mut bytes, mut end) = (0, 0);
        while let Some(batch) = self.batches.pop_front_if(|batch| batch.number <= through) {
            self.weight -= batch.weight;
            bytes += batch.frame_bytes;
            end = batch.end;
        }
        (bytes, end)
    }

    /// Removes the batches from `from` on, because they did not arrive.
    pub(super) fn remove_from(&mut self, from: u64) {
        while let Some(batch) = self.batches.pop_back_if(|batch| batch.number >= from) {
            self.weight -= batch.weight;
        }
    }
}
