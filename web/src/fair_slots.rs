//! Slots that client addresses share. When all slots are taken, the address with the most slots loses its oldest slot.
//!
//! An address that holds slots without using them, because it sends nothing or reads slowly, therefore cannot exclude other addresses.
//! If `n` addresses request slots, an address that requests at least `1/n` of the slots gets at
//! least `1/n`, rounded down, up to the maximum of one address (max-min fairness).

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_networks::AddressGroup;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

/// A fixed number of slots, and the addresses that hold them.
#[derive(Clone, Debug)]
pub(crate) struct FairSlots {
    /// Number of all slots, in use or free.
    capacity: usize,
    max_per_address: usize,
    /// Slots that are not in use. An evicted slot is removed from `held` at once, but is free only when it is dropped.
    free: Arc<Semaphore>,
    held: Arc<Mutex<HeldSlots>>,
}

#[derive(Debug, Default)]
struct HeldSlots {
    /// Id of the next slot. Ids rise, so the smallest id of an address is its oldest slot.
    next_id: u64,
    /// Number of slots in `by_address`.
    slot_count: usize,
    /// For each address its slots, oldest first. The token of a slot ends the use of this slot.
    by_address: HashMap<AddressGroup, BTreeMap<u64, CancellationToken>>,
}

/// Reason why a slot is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SlotRefusal {
    /// The address holds this number of slots, which is the maximum for one address.
    AddressLimitReached(usize),
    /// All slots (this number) are taken, and no address has at least two slots more than the requesting address.
    AllSlotsTaken(usize),
}

/// The slot of one open connection or stream; released when dropped.
#[derive(Debug)]
pub(crate) struct Slot {
    _entry: Entry,
    _permit: OwnedSemaphorePermit,
}

/// Entry of a slot in [`HeldSlots`]; removed when dropped.
#[derive(Debug)]
struct Entry {
    address: AddressGroup,
    id: u64,
    held: Arc<Mutex<HeldSlots>>,
}

impl FairSlots {
    /// Creates `capacity` slots, at least one. An address may have at most `max_per_address` slots.
    pub(crate) fn new(capacity: usize, max_per_address: usize) -> Self {
        let capacity = capacity.max(1);
        Self { capacity, max_per_address, free: Arc::new(Semaphore::new(capacity)), held: Arc::default() }
    }

    /// Acquires a slot for `address`. `evict` is cancelled when the slot is needed for another address.
    ///
    /// If all slots are taken, this evicts the oldest slot of the address with the most slots, and waits until the
    /// evicted slot is dropped.
    ///
    /// # Errors
    /// Returns an error when `address` has the maximum number of slots for one address, or when all slots are taken and
    /// no other address has at least two slots more than `address`.
    pub(crate) async fn acquire(
        &self,
        address: AddressGroup,
        evict: CancellationToken,
    ) -> Result<Slot, SlotRefusal> {
        let entry = self.register(address, evict)?;
        let permit = Arc::clone(&self.free).acquire_owned().await.expect("the semaphore is never closed");
        Ok(Slot { _entry: entry, _permit: permit })
    }

    fn register(&self, address: AddressGroup, evict: CancellationToken) -> Result<Entry, SlotRefusal> {
        let mut held = lock(&self.held);
        let held_by_address = held.by_address.get(&address).map_or(0, BTreeMap::len);
        if held_by_address >= self.max_per_address {
            return Err(SlotRefusal::AddressLimitReached(held_by_address));
        }
        if held.slot_count == self.capacity {
            // If a difference of one slot sufficed, two addresses would evict each other in turn.
            let largest_holder = held.largest_holder().filter(|(_, slots)| *slots >= held_by_address + 2);
            let (largest_holder, _) = largest_holder.ok_or(SlotRefusal::AllSlotsTaken(self.capacity))?;
            held.evict_oldest(largest_holder);
        }
        let id = held.next_id;
        held.next_id += 1;
        held.slot_count += 1;
        held.by_address.entry(address).or_default().insert(id, evict);
        Ok(Entry { address, id, held: Arc::clone(&self.held) })
    }
}

impl HeldSlots {
    fn largest_holder(&self) -> Option<(AddressGroup, usize)> {
        let counts = self.by_address.iter().map(|(address, slots)| (*address, slots.len()));
        counts.max_by_key(|(_, slots)| *slots)
    }

    fn evict_oldest(&mut self, address: AddressGroup) {
        let oldest = self.by_address.get(&address).and_then(|slots| slots.first_key_value());
        if let Some((&id, evict)) = oldest {
            evict.cancel();
            self.remove(address, id);
        }
    }

    fn remove(&mut self, address: AddressGroup, id: u64) {
        let Some(slots) = self.by_address.get_mut(&address) else { return };
        if slots.remove(&id).is_some() {
            self.slot_count -= 1;
        }
        if slots.is_empty() {
            self.by_address.remove(&address);
        }
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        lock(&self.held).remove(self.address, self.id);
    }
}

fn lock(held: &Mutex<HeldSlots>) -> MutexGuard<'_, HeldSlots> {
    held.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;

    use super::*;

    fn group(text: &str) -> AddressGroup {
        AddressGroup::from_address(format!("{text}:1").parse().expect("an address"))
    }

    /// Returns the result of `acquire` if it is ready at once, and the token that ends the use of the slot.
    fn try_take(slots: &FairSlots, address: &str) -> (Option<Result<Slot, SlotRefusal>>, CancellationToken) {
        let evict = CancellationToken::new();
        (slots.acquire(group(address), evict.clone()).now_or_never(), evict)
    }

    /// Returns a slot that is free at once, and the token that ends its use.
    fn take(slots: &FairSlots, address: &str) -> (Slot, CancellationToken) {
        let (slot, evict) = try_take(slots, address);
        (slot.expect("at once").expect("free"), evict)
    }

    #[tokio::test]
    async fn full_slots_evict_oldest_of_largest_holder() {
        let slots = FairSlots::new(4, 4);
        let (oldest, evict_oldest_token) = take(&slots, "192.0.2.1");
        let (_second, evict_second) = take(&slots, "192.0.2.1");
        let (_third, evict_third) = take(&slots, "192.0.2.1");
        let (_other, evict_other) = take(&slots, "192.0.2.2");

        let next = tokio::spawn({
            let slots = slots.clone();
            async move { slots.acquire(group("192.0.2.3"), CancellationToken::new()).await }
        });
        evict_oldest_token.cancelled().await;
        assert!(![evict_second, evict_third, evict_other].iter().any(CancellationToken::is_cancelled));
        assert!(!next.is_finished(), "the new slot waits until the evicted slot is dropped");
        drop(oldest);
        next.await.expect("ends").expect("the evicted slot");
    }

    #[test]
    fn difference_of_one_slot_evicts_nobody() {
        let slots = FairSlots::new(4, 4);
        let held = ["192.0.2.1", "192.0.2.1", "192.0.2.2", "192.0.2.3"].map(|at| take(&slots, at));
        for address in ["192.0.2.1", "192.0.2.2"] {
            let (slot, _) = try_take(&slots, address);
            assert_eq!(slot.expect("at once").expect_err("refused"), SlotRefusal::AllSlotsTaken(4));
        }
        assert!(!held.iter().any(|(_, evict)| evict.is_cancelled()));
    }

    #[test]
    fn released_slots_leave_no_entries() {
        let slots = FairSlots::new(2, 2);
        let held = [take(&slots, "[2001:db8::1]"), take(&slots, "[2001:db8::ffff:2]")];
        // Both addresses are in one /64 network, which counts as one address.
        let (refused, _) = try_take(&slots, "[2001:db8::3]");
        assert_eq!(refused.expect("at once").expect_err("refused"), SlotRefusal::AddressLimitReached(2));
        // This call waits for the evicted slot, and is dropped while it waits.
        assert!(try_take(&slots, "192.0.2.1").0.is_none());
        drop(held);
        assert!(lock(&slots.held).by_address.is_empty());
        assert_eq!((lock(&slots.held).slot_count, slots.free.available_permits()), (0, 2));
    }
}
