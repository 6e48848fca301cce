//! Places that addresses share: when all are taken, the address that has most of them gives one up.
//!
//! Hosts that hold places without use, by silence or by reading slowly, therefore cannot exclude other hosts: with `n` addresses each has
//! a share of `1/n`, whatever the others do (max-min fairness).

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_networks::AddressGroup;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

/// A fixed number of places, and the addresses that hold them.
#[derive(Clone, Debug)]
pub(crate) struct FairPlaces {
    count: usize,
    of_one_address: usize,
    /// Places that are not in use. It lags behind `held` as long as a place that was given up is still in use.
    free: Arc<Semaphore>,
    held: Arc<Mutex<HeldPlaces>>,
}

#[derive(Debug, Default)]
struct HeldPlaces {
    next: u64,
    count: usize,
    /// Tokens that end the use of each place, oldest first.
    by_address: HashMap<AddressGroup, BTreeMap<u64, CancellationToken>>,
}

/// Reason why there is no place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoPlace {
    /// The address holds the largest number that one address may hold.
    AddressIsFull(usize),
    /// All of these places are taken, and no address has clearly more of them than the address that asks.
    AllTaken(usize),
}

/// The place of one open connection or stream; free again when dropped.
#[derive(Debug)]
pub(crate) struct Place {
    _entry: Entry,
    _permit: OwnedSemaphorePermit,
}

/// Entry of a place in [`HeldPlaces`]; removed when dropped.
#[derive(Debug)]
struct Entry {
    address: AddressGroup,
    id: u64,
    held: Arc<Mutex<HeldPlaces>>,
}

impl FairPlaces {
    /// Creates `count` places, at least one, of which one address has at most `of_one_address`.
    pub(crate) fn new(count: usize, of_one_address: usize) -> Self {
        let count = count.max(1);
        Self { count, of_one_address, free: Arc::new(Semaphore::new(count)), held: Arc::default() }
    }

    /// Returns a place for one more of `address`. Where all are taken, the oldest of the address that has most is given up: its
    /// token is cancelled, and this waits until its place is dropped. `leave` is the token of the new place.
    ///
    /// # Errors
    /// When the address has as many as one may have, or all are taken and no other has at least two more than this one.
    pub(crate) async fn take(
        &self,
        address: AddressGroup,
        leave: CancellationToken,
    ) -> Result<Place, NoPlace> {
        let entry = self.enter(address, leave)?;
        let permit = Arc::clone(&self.free).acquire_owned().await.expect("the semaphore is never closed");
        Ok(Place { _entry: entry, _permit: permit })
    }

    fn enter(&self, address: AddressGroup, leave: CancellationToken) -> Result<Entry, NoPlace> {
        let mut held = lock(&self.held);
        let of_address = held.by_address.get(&address).map_or(0, BTreeMap::len);
        if of_address >= self.of_one_address {
            return Err(NoPlace::AddressIsFull(of_address));
        }
        if held.count == self.count {
            // With a difference of one, two addresses would take the place from each other alternately.
            let crowded = held.most_crowded().filter(|(_, places)| *places >= of_address + 2);
            let (crowded, _) = crowded.ok_or(NoPlace::AllTaken(self.count))?;
            held.give_up_oldest(crowded);
        }
        let id = held.next;
        held.next += 1;
        held.count += 1;
        held.by_address.entry(address).or_default().insert(id, leave);
        Ok(Entry { address, id, held: Arc::clone(&self.held) })
    }
}

impl HeldPlaces {
    fn most_crowded(&self) -> Option<(AddressGroup, usize)> {
        let counts = self.by_address.iter().map(|(address, places)| (*address, places.len()));
        counts.max_by_key(|(_, places)| *places)
    }

    fn give_up_oldest(&mut self, address: AddressGroup) {
        let oldest = self.by_address.get(&address).and_then(|places| places.first_key_value());
        if let Some((&id, leave)) = oldest {
            leave.cancel();
            self.remove(address, id);
        }
    }

    fn remove(&mut self, address: AddressGroup, id: u64) {
        let Some(places) = self.by_address.get_mut(&address) else { return };
        if places.remove(&id).is_some() {
            self.count -= 1;
        }
        if places.is_empty() {
            self.by_address.remove(&address);
        }
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        lock(&self.held).remove(self.address, self.id);
    }
}

fn lock(held: &Mutex<HeldPlaces>) -> MutexGuard<'_, HeldPlaces> {
    held.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;

    use super::*;

    fn group(text: &str) -> AddressGroup {
        AddressGroup::of(format!("{text}:1").parse().expect("an address"))
    }

    /// Returns the result of `take` if it is ready at once.
    fn take(places: &FairPlaces, address: &str) -> (Option<Result<Place, NoPlace>>, CancellationToken) {
        let leave = CancellationToken::new();
        (places.take(group(address), leave.clone()).now_or_never(), leave)
    }

    fn taken(places: &FairPlaces, address: &str) -> (Place, CancellationToken) {
        let (place, leave) = take(places, address);
        (place.expect("at once").expect("free"), leave)
    }

    #[tokio::test]
    async fn the_address_that_has_most_gives_up_its_oldest_place() {
        let places = FairPlaces::new(4, 4);
        let (oldest, leave_oldest) = taken(&places, "192.0.2.1");
        let (_second, leave_second) = taken(&places, "192.0.2.1");
        let (_third, leave_third) = taken(&places, "192.0.2.1");
        let (_other, leave_other) = taken(&places, "192.0.2.2");

        let next = tokio::spawn({
            let places = places.clone();
            async move { places.take(group("192.0.2.3"), CancellationToken::new()).await }
        });
        leave_oldest.cancelled().await;
        assert!(![leave_second, leave_third, leave_other].iter().any(CancellationToken::is_cancelled));
        assert!(!next.is_finished(), "there are never more in use than places");
        drop(oldest);
        next.await.expect("ends").expect("the place that was given up");
    }

    #[test]
    fn nobody_gives_up_a_place_for_an_address_that_has_as_many() {
        let places = FairPlaces::new(4, 4);
        let held = ["192.0.2.1", "192.0.2.1", "192.0.2.2", "192.0.2.3"].map(|at| taken(&places, at));
        for address in ["192.0.2.1", "192.0.2.2"] {
            let (place, _) = take(&places, address);
            assert_eq!(place.expect("at once").expect_err("refused"), NoPlace::AllTaken(4));
        }
        assert!(!held.iter().any(|(_, leave)| leave.is_cancelled()));
    }

    #[test]
    fn nothing_is_remembered_of_addresses_that_left() {
        let places = FairPlaces::new(2, 2);
        let held = [taken(&places, "[2001:db8::1]"), taken(&places, "[2001:db8::ffff:2]")];
        // Both are of one network.
        let (refused, _) = take(&places, "[2001:db8::3]");
        assert_eq!(refused.expect("at once").expect_err("refused"), NoPlace::AddressIsFull(2));
        // This one waits, and gives up waiting.
        assert!(take(&places, "192.0.2.1").0.is_none());
        drop(held);
        assert!(lock(&places.held).by_address.is_empty());
        assert_eq!((lock(&places.held).count, places.free.available_permits()), (0, 2));
    }
}
