//! The stage between the socket and the writer: reads events and makes rows of them while SQLite works on what came
//! before. One thread, so that order is kept without further ado: it does the work of a batch in a fraction of the
//! time that SQLite takes for it.

use std::sync::Arc;

use peernet_clock::MonoTime;
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use super::queue::{Incoming, Waiting};
use peernet_store::writing::Work;

/// Prepared pieces of work that may wait for the writer; bounded by nodes beside that.
const PIECES: usize = 4_096;

/// Work that is ready for the writer, and the room it takes until this is dropped.
#[derive(Debug)]
pub(crate) struct Queued {
    pub(crate) work: Work,
    /// How often the database had been opened anew when it was let in.
    pub(crate) generation: u64,
    /// When it was let in.
    pub(crate) since: MonoTime,
    pub(crate) room: [OwnedSemaphorePermit; 2],
}

/// What is prepared and not stored yet.
#[derive(Debug)]
pub(crate) struct Ready {
    sender: mpsc::Sender<Queued>,
    nodes: Arc<Semaphore>,
    most_nodes: u32,
}

/// Room for prepared work of so many nodes; a single larger piece has room as well.
pub(crate) fn ready(most_nodes: usize) -> (Ready, mpsc::Receiver<Queued>) {
    let (sender, receiver) = mpsc::channel(PIECES);
    let most_nodes = u32::try_from(most_nodes).unwrap_or(u32::MAX);
    (Ready { sender, nodes: Arc::new(Semaphore::new(most_nodes as usize)), most_nodes }, receiver)
}

/// Prepares until nothing more will come or the writer has gone. For a thread of its own.
pub(crate) fn run(runtime: &Handle, mut waiting: mpsc::Receiver<Waiting>, ready: &Ready) {
    while let Some(Waiting { incoming, generation, since, room }) = waiting.blocking_recv() {
        let work = match incoming {
            Incoming::Work(work) => work,
            Incoming::Batch(head, body) => Work::of_batch(head, body),
        };
        let weight = u32::try_from(work.weight()).unwrap_or(u32::MAX).min(ready.most_nodes);
        let nodes = runtime.block_on(Arc::clone(&ready.nodes).acquire_many_owned(weight));
        // Closed only when the writer gave up.
        let Ok(nodes) = nodes else { return };
        if ready.sender.blocking_send(Queued { work, generation, since, room: [room, nodes] }).is_err() {
            return;
        }
    }
}
