//! The stage between the socket and the writer: reads events and turns them into rows while SQLite works on the
//! previous group.
//!
//! Preparing depends on its input only, so it runs in parallel with SQLite's thread. One thread is enough, and it keeps
//! the order of batches: it needs a fraction of the time that SQLite needs for a batch.

use std::sync::Arc;

use peernet_clock::MonoTime;
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use super::queue::{AdmittedWork, QueueItem};
use peernet_store::writing::Work;

/// Largest number of prepared items. Their nodes are limited, too.
const MAX_PREPARED_ITEMS: usize = 4_096;

/// Work that is ready for the writer. It occupies its capacity of the queue until it is dropped.
#[derive(Debug)]
pub(crate) struct PreparedWork {
    pub(crate) work: Work,
    /// Generation of the database when the work was admitted.
    pub(crate) generation: u64,
    /// Time of the admission.
    pub(crate) since: MonoTime,
    pub(crate) capacity: [OwnedSemaphorePermit; 2],
}

/// The sending end of the prepared work.
#[derive(Debug)]
pub(crate) struct PreparedSender {
    sender: mpsc::Sender<PreparedWork>,
    nodes: Arc<Semaphore>,
    max_nodes: u32,
}

/// Creates the channel of prepared work with capacity for `max_nodes` nodes. A single larger item is also accepted.
pub(crate) fn channel(max_nodes: usize) -> (PreparedSender, mpsc::Receiver<PreparedWork>) {
    let (sender, receiver) = mpsc::channel(MAX_PREPARED_ITEMS);
    let max_nodes = u32::try_from(max_nodes).unwrap_or(u32::MAX);
    (PreparedSender { sender, nodes: Arc::new(Semaphore::new(max_nodes as usize)), max_nodes }, receiver)
}

/// Prepares work until the queue is closed or the writer has ended. Blocks its thread.
pub(crate) fn run(runtime: &Handle, mut waiting: mpsc::Receiver<QueueItem>, prepared: &PreparedSender) {
    while let Some(QueueItem { admitted, generation, since, capacity }) = waiting.blocking_recv() {
        let work = match admitted {
            AdmittedWork::Work(work) => work,
            AdmittedWork::Batch(head, body) => Work::from_batch(head, body),
        };
        // At most all permits, so that an item larger than the whole capacity passes, too.
        let weight = u32::try_from(work.weight()).unwrap_or(u32::MAX).min(prepared.max_nodes);
        let nodes = runtime.block_on(Arc::clone(&prepared.nodes).acquire_many_owned(weight));
        // The semaphore is closed only after the writer ended.
        let Ok(nodes) = nodes else { return };
        if prepared
            .sender
            .blocking_send(PreparedWork { work, generation, since, capacity: [capacity, nodes] })
            .is_err()
        {
            return;
        }
    }
}
