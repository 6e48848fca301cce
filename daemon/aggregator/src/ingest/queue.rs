//! What waits to be stored, bounded by number and bytes.
//!
//! The socket must never wait for the database: live updates come through it. So there is room or there is not; what
//! finds none counts as never come, and is asked for again when there is some.

use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::MonoTime;
use peernet_stream::BatchHead;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use peernet_store::writing::Work;

/// Bytes of batches that may wait, from their arrival until they are stored.
pub(crate) const ROOM_BYTES: usize = 96 * 1024 * 1024;
/// What one agent may have under way, in batches of its usual length: about 160,000 nodes, so that there is always
/// enough to be prepared while a commit syncs, also where few agents send.
pub(crate) const MOST_WINDOW: u32 = 32;
/// Pieces of work that may wait: as many small batches as there is room for.
const ROOM_ITEMS: usize = ROOM_BYTES / PER_PERMIT;
/// Bytes per permit: permits are counted in 32 bits.
const PER_PERMIT: usize = 1_024;

/// What was let in.
#[derive(Debug)]
pub(crate) enum Incoming {
    /// Ready to be stored.
    Work(Work),
    /// Events that match their hash and have not been read yet.
    Batch(BatchHead, Bytes),
}

/// What was let in, when, and the room it takes until this is dropped.
#[derive(Debug)]
pub(crate) struct Waiting {
    pub(crate) incoming: Incoming,
    pub(crate) generation: u64,
    pub(crate) since: MonoTime,
    pub(crate) room: OwnedSemaphorePermit,
}

/// The end where work comes in.
#[derive(Debug)]
pub(crate) struct Queue {
    room: Arc<Semaphore>,
    /// `None` once closed.
    sender: Option<mpsc::Sender<Waiting>>,
    /// How often the database was opened anew. What was let in before is compared with the marks of the one before.
    generation: u64,
}

/// A place that a piece of work will take.
#[derive(Debug)]
pub(super) struct Place<'a> {
    queue: &'a Queue,
    slot: mpsc::Permit<'a, Waiting>,
    room: OwnedSemaphorePermit,
    bytes: usize,
}

/// An empty queue.
pub(crate) fn queue() -> (Queue, mpsc::Receiver<Waiting>) {
    let (sender, receiver) = mpsc::channel(ROOM_ITEMS);
    (
        Queue {
            room: Arc::new(Semaphore::new(ROOM_BYTES / PER_PERMIT)),
            sender: Some(sender),
            generation: 0,
        },
        receiver,
    )
}

impl Queue {
    /// A place for so many bytes, if there is one now.
    pub(super) fn place(&self, bytes: usize) -> Option<Place<'_>> {
        let room = self.take(bytes / PER_PERMIT + 1)?;
        Some(Place { queue: self, slot: self.sender.as_ref()?.try_reserve().ok()?, room, bytes })
    }

    /// How many pieces of so many bytes there is room for.
    pub(super) fn room_for(&self, bytes: usize) -> usize {
        let slots = self.sender.as_ref().map_or(0, mpsc::Sender::capacity);
        slots.min(self.room.available_permits() / (bytes / PER_PERMIT + 1))
    }

    /// The database was opened anew.
    pub(super) fn begin_generation(&mut self) {
        self.generation += 1;
    }

    /// Nothing more will come.
    pub(super) fn close(&mut self) {
        self.sender = None;
    }

    fn take(&self, permits: usize) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.room).try_acquire_many_owned(u32::try_from(permits).ok()?).ok()
    }
}

impl Place<'_> {
    /// The place made large enough for so many bytes, if there is room now.
    pub(super) fn grown_to(mut self, bytes: usize) -> Option<Self> {
        let more = (bytes / PER_PERMIT).saturating_sub(self.bytes / PER_PERMIT);
        self.room.merge(self.queue.take(more)?);
        Some(self)
    }

    /// Puts something there.
    pub(super) fn put(self, incoming: Incoming, since: MonoTime) {
        let generation = self.queue.generation;
        self.slot.send(Waiting { incoming, generation, since, room: self.room });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_taken_by_bytes_and_given_back() {
        let (queue, mut waiting) = queue();
        let fits = queue.room_for(1 << 20);
        assert_eq!(fits, ROOM_BYTES / PER_PERMIT / 1_025);
        let frame = || Incoming::Work(Work::Goodbye(peernet_logger::HostId::random()));
        for _ in 0..fits {
            queue.place(1 << 20).expect("there is room").put(frame(), MonoTime::from_nanos(0));
        }
        assert!(queue.place(1 << 20).is_none(), "full");
        let small = queue.place(1_000).expect("there is a little");
        assert!(small.grown_to(1 << 20).is_none(), "it cannot grow");
        drop(waiting.try_recv().expect("the first"));
        let grown = queue.place(1_000).and_then(|place| place.grown_to((1 << 20) - 1));
        grown.expect("there is room again").put(frame(), MonoTime::from_nanos(0));
    }

    #[test]
    fn nothing_comes_in_after_it_is_closed() {
        let (mut queue, waiting) = queue();
        queue.close();
        assert!(queue.place(0).is_none() && queue.room_for(0) == 0 && waiting.is_closed());
    }
}
