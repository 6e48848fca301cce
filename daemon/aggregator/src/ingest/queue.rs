//! What waits to be stored, bounded by number and bytes.
//!
//! The socket must never wait for the database: live updates come through it. So there is room or there is not;
//! what finds none is let go as if the network had lost it, and the agent sends it again.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use crate::store::write::Work;

/// Bytes of frames that may wait; what they become in memory is about four times as much.
const ROOM_BYTES: usize = 64 * 1024 * 1024;
/// Pieces of work that may wait.
const ROOM_ITEMS: usize = 4_096;
/// Bytes per permit: permits are counted in 32 bits.
const PER_PERMIT: usize = 1_024;

/// A piece of work, and the room it takes until it is dropped.
#[derive(Debug)]
pub(crate) struct Queued {
    /// What is to be stored.
    pub(crate) work: Work,
    room: OwnedSemaphorePermit,
}

impl Queued {
    /// The work and its room, to be dropped when the work is done.
    pub(crate) fn into_parts(self) -> (Work, OwnedSemaphorePermit) {
        (self.work, self.room)
    }
}

/// The end where work comes in.
#[derive(Debug)]
pub(crate) struct Queue {
    room: Arc<Semaphore>,
    /// `None` once closed.
    sender: Option<mpsc::Sender<Queued>>,
}

/// A place that a piece of work will take.
#[derive(Debug)]
pub(super) struct Place<'a> {
    slot: mpsc::Permit<'a, Queued>,
    room: OwnedSemaphorePermit,
}

/// An empty queue.
pub(crate) fn queue() -> (Queue, mpsc::Receiver<Queued>) {
    let (sender, receiver) = mpsc::channel(ROOM_ITEMS);
    (Queue { room: Arc::new(Semaphore::new(ROOM_BYTES / PER_PERMIT)), sender: Some(sender) }, receiver)
}

impl Queue {
    /// A place for a frame of so many bytes, if there is one now.
    pub(super) fn place(&self, bytes: usize) -> Option<Place<'_>> {
        let permits = u32::try_from(bytes / PER_PERMIT + 1).ok()?;
        let room = Arc::clone(&self.room).try_acquire_many_owned(permits).ok()?;
        Some(Place { slot: self.sender.as_ref()?.try_reserve().ok()?, room })
    }

    /// Nothing more will come.
    pub(super) fn close(&mut self) {
        self.sender = None;
    }
}

impl Place<'_> {
    /// Puts the work there.
    pub(super) fn put(self, work: Work) {
        self.slot.send(Queued { work, room: self.room });
    }
}
