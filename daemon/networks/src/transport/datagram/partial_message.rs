//! A message of which some fragments have arrived. Its memory grows with the fragments that arrive.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytes::Bytes;

use crate::transport::memory::{BudgetExhausted, MemoryBudget, Reservation};

/// Memory that a fragment beyond a gap needs in addition to its content: its entry in the map and the overhead of the
/// allocator. Bytes.
const FRAGMENT_OVERHEAD: u64 = 96;

/// The part of a message that has arrived.
///
/// The announced length of a message reserves no memory, so that one datagram cannot cost the memory of a whole
/// message.
#[derive(Debug)]
pub(super) struct PartialMessage {
    total_bytes: u32,
    /// Bytes from the beginning up to the first gap.
    contiguous: Vec<u8>,
    /// Fragments beyond that gap, by offset.
    beyond_gap: BTreeMap<u32, Box<[u8]>>,
    /// Memory of the fragments beyond the gap. Bytes.
    beyond_gap_bytes: u64,
    reserved: Reservation,
}

/// Largest memory of a message as a multiple of its length, in whatever order its fragments arrive. Does not
/// include [`FRAGMENT_OVERHEAD`], which is small compared to a fragment of a usual length.
// Up to twice the bytes before the gap are reserved. The bytes beyond the gap are stored separately, and once. The sum
// is at most twice the bytes of the message.
pub(super) const PEAK_MEMORY_FACTOR: u64 = 2;

/// Effect of a fragment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AddOutcome {
    New,
    /// The fragment had arrived before.
    Duplicate,
}

impl PartialMessage {
    /// Creates a message of `total_bytes` bytes, of which none has arrived.
    pub(super) fn new(total_bytes: u32, budget: &Arc<MemoryBudget>) -> Self {
        Self {
            total_bytes,
            contiguous: Vec::new(),
            beyond_gap: BTreeMap::new(),
            beyond_gap_bytes: 0,
            reserved: Reservation::empty(budget),
        }
    }

    /// Returns the length of the whole message.
    pub(super) const fn total_bytes(&self) -> u32 {
        self.total_bytes
    }

    /// Adds a fragment. Fragments of one message do not overlap and do not extend beyond its end.
    ///
    /// # Errors
    /// If the fragment would exceed the budget. The message must then be given up.
    pub(super) fn add(
        &mut self,
        offset: u32,
        bytes: &[u8],
        budget: &Arc<MemoryBudget>,
    ) -> Result<AddOutcome, BudgetExhausted> {
        let contiguous_length = self.contiguous.len();
        if (offset as usize) < contiguous_length || self.beyond_gap.contains_key(&offset) {
            return Ok(AddOutcome::Duplicate);
        }
        if offset as usize > contiguous_length {
            let beyond_gap_bytes = self.beyond_gap_bytes + bytes.len() as u64 + FRAGMENT_OVERHEAD;
            self.reserved.resize(budget, self.contiguous.capacity() as u64 + beyond_gap_bytes)?;
            self.beyond_gap_bytes = beyond_gap_bytes;
            self.beyond_gap.insert(offset, bytes.into());
            return Ok(AddOutcome::New);
        }
        self.append(bytes, budget)?;
        while let Some(entry) = self.beyond_gap.first_entry()
            && *entry.key() as usize == self.contiguous.len()
        {
            let bytes = entry.remove();
            self.append(&bytes, budget)?;
            self.beyond_gap_bytes -= bytes.len() as u64 + FRAGMENT_OVERHEAD;
            self.reserved.shrink_to(self.contiguous.capacity() as u64 + self.beyond_gap_bytes);
        }
        Ok(AddOutcome::New)
    }

    fn append(&mut self, bytes: &[u8], budget: &Arc<MemoryBudget>) -> Result<(), BudgetExhausted> {
        let needed = self.contiguous.len() + bytes.len();
        if needed > self.contiguous.capacity() {
            // A full buffer at least doubles, so that a long message is copied seldom. The buffer is never longer than
            // twice the bytes that have arrived.
            let capacity = needed.max(self.contiguous.len() * 2).min(self.total_bytes as usize);
            self.reserved.resize(budget, capacity as u64 + self.beyond_gap_bytes)?;
            self.contiguous.reserve_exact(capacity - self.contiguous.len());
        }
        self.contiguous.extend_from_slice(bytes);
        Ok(())
    }

    /// Returns the bytes of a whole message, and the reservation of their memory.
    pub(super) fn into_bytes(self) -> (Bytes, Reservation) {
        (self.contiguous.into(), self.reserved)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn claimed_length_alone_reserves_no_memory() {
        let budget = MemoryBudget::new(1 << 20);
        for offset in [0, 1_000, 3_999_999_000] {
            let mut message = PartialMessage::new(4_000_000_000, &budget);
            message.add(offset, &[7; 1_000], &budget).expect("there is room");
            assert!(
                budget.reserved_bytes() <= 2_000,
                "{} bytes for a fragment at {offset}",
                budget.reserved_bytes()
            );
        }
        assert_eq!(budget.reserved_bytes(), 0);
    }

    #[test]
    fn fragment_without_room_is_refused() {
        let budget = MemoryBudget::new(2_500);
        let mut message = PartialMessage::new(10_000, &budget);
        assert_eq!(message.add(0, &[7; 1_000], &budget), Ok(AddOutcome::New));
        assert_eq!(message.add(5_000, &[7; 1_000], &budget), Ok(AddOutcome::New));
        assert_eq!(message.add(0, &[7; 1_000], &budget), Ok(AddOutcome::Duplicate));
        assert_eq!(message.add(5_000, &[7; 1_000], &budget), Ok(AddOutcome::Duplicate));
        assert_eq!(message.add(6_000, &[7; 1_000], &budget), Err(BudgetExhausted));
        assert_eq!(message.add(1_000, &[7; 1_000], &budget), Err(BudgetExhausted));
    }

    #[test]
    fn whole_message_reserves_its_length() {
        let budget = MemoryBudget::new(1 << 20);
        let mut message = PartialMessage::new(10_000, &budget);
        for index in (0..10).rev() {
            message.add(index * 1_000, &[7; 1_000], &budget).expect("there is room");
        }
        let (bytes, _reservation) = message.into_bytes();
        assert_eq!((bytes.len(), budget.reserved_bytes()), (10_000, 10_000));
    }

    proptest! {
        #[test]
        fn memory_stays_below_twice_the_bytes_and_overhead(
            length in 1_usize..20_000,
            stride in 1_usize..1_500,
            picks in proptest::collection::vec(any::<prop::sample::Index>(), 1..200),
        ) {
            let bytes: Vec<u8> = (0..length).map(|i| (i * 31) as u8).collect();
            let fragments: Vec<(usize, &[u8])> = bytes.chunks(stride).enumerate().collect();
            let budget = MemoryBudget::new(1 << 30);
            let mut message = PartialMessage::new(length as u32, &budget);
            let (mut arrived, mut count) = (0, 0);
            let mut order: Vec<usize> = picks.iter().map(|pick| pick.index(fragments.len())).collect();
            order.extend(0..fragments.len());
            for index in order {
                let (index, part) = fragments[index];
                if message.add((index * stride) as u32, part, &budget).expect("there is room") == AddOutcome::New {
                    arrived += part.len() as u64;
                    count += 1;
                }
                prop_assert!(budget.reserved_bytes() <= 2 * arrived + count * FRAGMENT_OVERHEAD);
            }
            let (message_bytes, reservation) = message.into_bytes();
            prop_assert_eq!(&message_bytes[..], &bytes[..]);
            drop(reservation);
            prop_assert_eq!(budget.reserved_bytes(), 0);
        }
    }
}
