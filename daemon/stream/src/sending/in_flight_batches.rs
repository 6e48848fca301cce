//! What was sent and is not acknowledged.

use std::collections::VecDeque;

use super::super::{MOST_UNDER_WAY, batch_weight};

/// A batch under way.
#[derive(Clone, Copy, Debug)]
struct InFlightBatch {
    number: u64,
    weight: u64,
    /// Bytes of its frame.
    frame: u64,
    /// Bytes of the connection up to its end; 0 while a part of it is still here.
    end: u64,
}

/// Batches under way, contiguous, and what they count together.
#[derive(Clone, Debug, Default)]
pub(super) struct InFlightBatches {
    sent: VecDeque<InFlightBatch>,
    weight: u64,
}

impl InFlightBatches {
    /// Whether a batch with a body of so many bytes must wait while no more than `window` may be under way.
    pub(super) fn is_full(&self, body: usize, window: u64) -> bool {
        let too_much = self.weight + batch_weight(body) > window || self.sent.len() >= MOST_UNDER_WAY;
        too_much && !self.sent.is_empty()
    }

    pub(super) fn push(&mut self, number: u64, body: usize, frame: usize) {
        let weight = batch_weight(body);
        self.weight += weight;
        self.sent.push_back(InFlightBatch { number, weight, frame: frame as u64, end: 0 });
    }

    /// The last batch is on its way, all of it.
    pub(super) fn handed_over(&mut self, end: u64) {
        if let Some(sent) = self.sent.back_mut() {
            sent.end = end;
        }
    }

    /// Batches up to this one are acknowledged: returns the bytes of their frames, and those of the connection up to
    /// the end of the last.
    pub(super) fn acknowledged(&mut self, through: u64) -> (u64, u64) {
        let (mut bytes, mut end) = (0, 0);
        while let Some(sent) = self.sent.pop_front_if(|sent| sent.number <= through) {
            self.weight -= sent.weight;
            bytes += sent.frame;
            end = sent.end;
        }
        (bytes, end)
    }

    /// Batches from this one on did not arrive.
    pub(super) fn lost(&mut self, from: u64) {
        while let Some(sent) = self.sent.pop_back_if(|sent| sent.number >= from) {
            self.weight -= sent.weight;
        }
    }
}
