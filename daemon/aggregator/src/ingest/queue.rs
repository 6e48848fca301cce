//! The bounded queue of work that waits to be stored. Its items and their bytes are limited.
//!
//! The socket must not wait for the database, because live updates arrive on the same socket. So adding to the queue
//! never waits: work that does not fit into the queue counts as not received, and is requested again when
//! the queue has capacity.

use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::MonoTime;
use peernet_stream::BatchHead;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use peernet_store::writing::Work;

/// Memory for waiting batches, from their arrival until they are stored, bytes.
pub(crate) const CAPACITY_BYTES: usize = 96 * 1024 * 1024;
/// Largest window of one agent, in batches of the usual size. An agent's window is the queue's capacity divided by the
/// number of connected agents, but at most this number. 32 batches have about 160,000 nodes, enough for several
/// commits, so that a single agent keeps the writer busy while a commit syncs.
pub(crate) const MAX_WINDOW: u32 = 32;
/// Maximum number of waiting items: the capacity filled with the smallest batches.
const CAPACITY_ITEMS: usize = CAPACITY_BYTES / BYTES_PER_PERMIT;
/// Bytes per permit of the semaphore, which counts permits in 32 bits.
const BYTES_PER_PERMIT: usize = 1_024;

/// Admitted work.
#[derive(Debug)]
pub(crate) enum AdmittedWork {
    /// Work that needs no preparation.
    Work(Work),
    /// Events that match their hash and are not decoded yet.
    Batch(BatchHead, Bytes),
}

/// Admitted work with its time of admission. It occupies a part of the queue's capacity until it is dropped.
#[derive(Debug)]
pub(crate) struct QueueItem {
    pub(crate) work: AdmittedWork,
    /// Generation of the database when the work was admitted.
    pub(crate) generation: u64,
    pub(crate) admitted_at: MonoTime,
    pub(crate) capacity: OwnedSemaphorePermit,
}

/// The sending end of the queue.
#[derive(Debug)]
pub(crate) struct Queue {
    capacity: Arc<Semaphore>,
    /// `None` after [`Queue::close`].
    sender: Option<mpsc::Sender<QueueItem>>,
    /// Number of times that the database was reopened. Work admitted before was checked against the stored state of the
    /// previous database.
    generation: u64,
}

/// A reserved slot of the queue, with capacity for a number of bytes.
#[derive(Debug)]
pub(super) struct QueueSlot<'a> {
    queue: &'a Queue,
    permit: mpsc::Permit<'a, QueueItem>,
    capacity: OwnedSemaphorePermit,
    bytes: usize,
}

/// Creates an empty queue.
pub(crate) fn queue() -> (Queue, mpsc::Receiver<QueueItem>) {
    let (sender, receiver) = mpsc::channel(CAPACITY_ITEMS);
    (
        Queue {
            capacity: Arc::new(Semaphore::new(CAPACITY_BYTES / BYTES_PER_PERMIT)),
            sender: Some(sender),
            generation: 0,
        },
        receiver,
    )
}

impl Queue {
    /// Reserves a slot for `bytes`; `None` if the queue is full.
    pub(super) fn reserve(&self, bytes: usize) -> Option<QueueSlot<'_>> {
        // The slot takes at least one permit, so that work without bytes, such as a goodbye, is limited as well.
        let capacity = self.acquire(bytes / BYTES_PER_PERMIT + 1)?;
        Some(QueueSlot { queue: self, permit: self.sender.as_ref()?.try_reserve().ok()?, capacity, bytes })
    }

    /// Returns the number of items of `bytes` each that fit into the queue now.
    pub(super) fn capacity_for(&self, bytes: usize) -> usize {
        let slots = self.sender.as_ref().map_or(0, mpsc::Sender::capacity);
        slots.min(self.capacity.available_permits() / (bytes / BYTES_PER_PERMIT + 1))
    }

    /// Marks later work as checked against the reopened database.
    pub(super) fn start_generation(&mut self) {
        self.generation += 1;
    }

    /// Closes the queue: no further work is admitted.
    pub(super) fn close(&mut self) {
        // Dropping the only sender ends the receiver's loop after the queued work.
        self.sender = None;
    }

    /// Acquires permits; `None` if there are not enough.
    fn acquire(&self, permits: usize) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.capacity).try_acquire_many_owned(u32::try_from(permits).ok()?).ok()
    }
}

impl QueueSlot<'_> {
    /// Enlarges the slot to `bytes`; `None` if the queue is full.
    pub(super) fn grow_to(mut self, bytes: usize) -> Option<Self> {
        // A slot holds `bytes / BYTES_PER_PERMIT + 1` permits, so the difference of the quotients is sufficient.
        let missing_permits = (bytes / BYTES_PER_PERMIT).saturating_sub(self.bytes / BYTES_PER_PERMIT);
        self.capacity.merge(self.queue.acquire(missing_permits)?);
        Some(self)
    }

    /// Fills the slot.
    pub(super) fn fill(self, work: AdmittedWork, admitted_at: MonoTime) {
        let generation = self.queue.generation;
        self.permit.send(QueueItem { work, generation, admitted_at, capacity: self.capacity });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capacity_is_reserved_by_bytes_and_released() {
        let (queue, mut receiver) = queue();
        let slots = queue.capacity_for(1 << 20);
        // An item of 1 MiB takes 1,024 permits and one more.
        assert_eq!(slots, CAPACITY_BYTES / BYTES_PER_PERMIT / 1_025);
        let work = || AdmittedWork::Work(Work::Goodbye(peernet_logger::HostId::random()));
        for _ in 0..slots {
            queue.reserve(1 << 20).expect("there is room").fill(work(), MonoTime::from_nanos(0));
        }
        assert!(queue.reserve(1 << 20).is_none(), "the queue is full");
        let small = queue.reserve(1_000).expect("1,000 bytes fit");
        assert!(small.grow_to(1 << 20).is_none(), "a full queue has no capacity for a larger slot");
        drop(receiver.try_recv().expect("the first item"));
        let grown = queue.reserve(1_000).and_then(|slot| slot.grow_to(1 << 20));
        grown.expect("there is room again").fill(work(), MonoTime::from_nanos(0));
    }

    #[test]
    fn closed_queue_admits_nothing() {
        let (mut queue, receiver) = queue();
        queue.close();
        assert!(queue.reserve(0).is_none() && queue.capacity_for(0) == 0 && receiver.is_closed());
    }
}
