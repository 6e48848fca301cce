//! The task that owns the spool file. It receives orders and sends results.

use std::io;
use std::time::Duration;

use peernet_stream::{Chain, SpooledBatch, StreamId, Totals};
use tokio::sync::mpsc::{self, error::TrySendError};
use tokio::task::JoinError;
use tokio::time::MissedTickBehavior;
use tokio_util::task::AbortOnDropHandle;

use super::aside::condemn;
use super::error::SpoolFileError;
use super::file::{Loaded, SpoolFile};
use super::sync::Syncing;
use super::tally;

/// Capacity of the channels. The state machine has at most one order of each of the four kinds in progress.
const MAX_ORDERS: usize = 8;

/// An operation that the task is asked to do.
#[derive(Clone, Debug)]
pub(in crate::outbox) enum Order {
    /// Appends batches; answered by [`Done::Appended`].
    Append { batches: Vec<SpooledBatch>, totals: Totals },
    /// Reads batches; answered by [`Done::Loaded`].
    Load { from: u64, bytes: usize },
    /// Deletes batches; answered by [`Done::Deleted`].
    Delete { through: u64, chain: Chain },
    /// Begins another stream; answered by [`Done::Renewed`].
    Renew { stream: StreamId, previous: StreamId, first: u64, events_before_first: u64 },
}

/// Result of an order.
#[derive(Debug)]
pub(in crate::outbox) enum Done {
    Appended(Result<(), SpoolTaskError>),
    Loaded(Result<Loaded, SpoolTaskError>),
    Deleted(Result<(), SpoolTaskError>),
    Renewed(Result<(), SpoolTaskError>),
}

/// Reason why an order failed.
#[derive(Debug, thiserror::Error)]
pub(in crate::outbox) enum SpoolTaskError {
    /// The file cannot be read or written.
    #[error(transparent)]
    File(#[from] SpoolFileError),
    /// The task has ended.
    #[error("the spool's task ended")]
    Ended,
    /// The channel is full, which the state machine never causes.
    #[error("the spool was given more orders than it can have: {0:?}")]
    Overloaded(Box<Order>),
    /// The disk does not answer in time.
    #[error("the spool's disk takes long")]
    Slow,
    /// The task panicked.
    #[error(transparent)]
    Panicked(#[from] JoinError),
}

/// Handle of the task. Dropping it aborts the task.
#[derive(Debug)]
pub(in crate::outbox) struct SpoolTask {
    orders: mpsc::Sender<Order>,
    done: mpsc::Receiver<Done>,
    task: AbortOnDropHandle<Result<(), SpoolFileError>>,
}

impl SpoolTask {
    /// Starts the task.
    pub(in crate::outbox) fn start(file: SpoolFile, sync_interval: Duration) -> Self {
        let (orders, ordered) = mpsc::channel(MAX_ORDERS);
        let (answers, done) = mpsc::channel(MAX_ORDERS);
        let task = AbortOnDropHandle::new(tokio::spawn(work(file, sync_interval, ordered, answers)));
        Self { orders, done, task }
    }

    /// Sends an order to the task, without waiting.
    ///
    /// # Errors
    /// When the task has ended, or its channel is full, which must not happen.
    pub(in crate::outbox) fn order(&self, order: Order) -> Result<(), SpoolTaskError> {
        self.orders.try_send(order).map_err(|error| match error {
            TrySendError::Closed(_) => SpoolTaskError::Ended,
            TrySendError::Full(order) => SpoolTaskError::Overloaded(Box::new(order)),
        })
    }

    /// Waits for the next result; `None` if the task has ended.
    pub(in crate::outbox) async fn done(&mut self) -> Option<Done> {
        self.done.recv().await
    }

    /// Waits until all orders are done, closes the file, and ends the task.
    pub(in crate::outbox) async fn close(self) -> Result<(), SpoolTaskError> {
        let Self { orders, done, task } = self;
        drop((orders, done));
        Ok(task.await??)
    }
}

async fn work(
    mut file: SpoolFile,
    sync_interval: Duration,
    mut orders: mpsc::Receiver<Order>,
    answers: mpsc::Sender<Done>,
) -> Result<(), SpoolFileError> {
    let mut ticks = tokio::time::interval(sync_interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut syncing = Syncing::new(file.log());
    loop {
        tokio::select! {
            biased;
            synced = syncing.ended(), if syncing.is_running() => report(&file, synced),
            _ = ticks.tick() => {
                syncing.begin();
                // In steps between orders, because a vacuum of the whole file would delay the orders that come
                // meanwhile.
                shrink(&mut file, &orders).await;
            }
            order = orders.recv() => {
                let Some(order) = order else { break };
                let done = execute(&mut file, &mut syncing, order).await;
                // The outbox may have ended; the order is done all the same.
                let _ = answers.send(done).await;
            }
        }
    }
    let synced = syncing.finish().await;
    report(&file, synced);
    file.close().await
}

async fn execute(file: &mut SpoolFile, syncing: &mut Syncing, order: Order) -> Done {
    match order {
        Order::Append { batches, totals } => {
            let appended = file.append(&batches, &totals).await;
            if appended.is_ok() {
                syncing.written();
                tally::log_ranges(&batches);
            }
            Done::Appended(condemn_if_corrupt(file, appended))
        }
        Order::Load { from, bytes } => Done::Loaded(file.load(from, bytes).await.map_err(Into::into)),
        Order::Delete { through, chain } => {
            let deleted = file.delete_through(through, chain).await;
            Done::Deleted(condemn_if_corrupt(file, deleted))
        }
        Order::Renew { stream, previous, first, events_before_first } => {
            let renewed = file.renew(stream, previous, (first, events_before_first)).await;
            Done::Renewed(condemn_if_corrupt(file, renewed))
        }
    }
}

/// Marks a file that turned out to be broken, so that the next start moves it aside.
fn condemn_if_corrupt(file: &SpoolFile, result: Result<(), SpoolFileError>) -> Result<(), SpoolTaskError> {
    if let Err(file_error @ SpoolFileError::Corrupt { .. }) = &result {
        condemn(file.path(), &file_error.to_string());
    }
    Ok(result?)
}

/// Shrinks the file step by step, until an order comes.
async fn shrink(file: &mut SpoolFile, orders: &mpsc::Receiver<Order>) {
    while orders.is_empty() {
        match file.shrink().await {
            Ok(true) => {}
            Ok(false) => return,
            Err(file_error) => {
                tracing::debug!(trouble = %file_error, "the spool keeps its size");
                return;
            }
        }
    }
}

fn report(file: &SpoolFile, synced: io::Result<()>) {
    if let Err(error) = synced {
        let spool = file.path().display();
        tracing::warn!(%error, "cannot sync the spool {spool}: a power cut may lose what it holds; tried again");
    }
}
