//! The stage between the socket and the writer: decodes events and turns them into rows while SQLite works on the
//! previous group.
//!
//! Preparing depends only on its input, so it runs in parallel with SQLite's thread. One thread is enough, because
//! preparing a batch takes a fraction of the time that SQLite needs for the batch. One thread also keeps the order of
//! the batches.

use std::sync::Arc;

use peernet_clock::MonoTime;
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use super::queue::{AdmittedWork, QueueItem};
use peernet_store::writing::Work;

/// Maximum number of prepared items. The number of their nodes has a separate limit.
const MAX_PREPARED_ITEMS: usize = 4_096;

/// Work that is ready for the writer. It occupies a part of the queue's capacity until it is dropped.
#[derive(Debug)]
pub(crate) struct PreparedWork {
    pub(crate) work: Work,
    /// Generation of the database when the work was admitted.
    pub(crate) generation: u64,
    /// Time of the admission.
    pub(crate) admitted_at: MonoTime,
    /// Permits of the queue and of this channel.
    pub(crate) capacity: [OwnedSemaphorePermit; 2],
}

/// The sending end of the prepared work.
#[derive(Debug)]
pub(crate) struct PreparedSender {
    sender: mpsc::Sender<PreparedWork>,
    /// One permit per node.
    node_permits: Arc<Semaphore>,
    max_nodes: u32,
}

/// Creates the channel of prepared work with capacity for `max_nodes` nodes. A single larger item is also accepted.
pub(crate) fn channel(max_nodes: usize) -> (PreparedSender, mpsc::Receiver<PreparedWork>) {
    let (sender, receiver) = mpsc::channel(MAX_PREPARED_ITEMS);
    let max_nodes = u32::try_from(max_nodes).unwrap_or(u32::MAX);
    let node_permits = Arc::new(Semaphore::new(max_nodes as usize));
    (PreparedSender { sender, node_permits, max_nodes }, receiver)
}

/// Prepares work until the queue is closed or the writer has ended. Blocks its thread.
pub(crate) fn run(runtime: &Handle, mut queue: mpsc::Receiver<QueueItem>, prepared: &PreparedSender) {
    while let Some(QueueItem { work, generation, admitted_at, capacity }) = queue.blocking_recv() {
        let work = match work {
            AdmittedWork::Work(work) => work,
            AdmittedWork::Batch(head, body) => Work::from_batch(head, body),
        };
        // An item takes at most all permits, so that an item larger than the whole capacity passes, too.
        let weight = u32::try_from(work.weight()).unwrap_or(u32::MAX).min(prepared.max_nodes);
        let permits = runtime.block_on(Arc::clone(&prepared.node_permits).acquire_many_owned(weight));
        // The semaphore is closed only after the writer ended.
        let Ok(permits) = permits else { return };
        let prepared_work = PreparedWork { work, generation, admitted_at, capacity: [capacity, permits] };
        if prepared.sender.blocking_send(prepared_work).is_err() {
            return;
        }
    }
}
