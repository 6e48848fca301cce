//! The task that owns the spool file. It executes orders and returns results over channels.

use std::io;
use std::time::Duration;

use peernet_stream::{Chain, SpooledBatch, StreamId, Totals};
use tokio::sync::mpsc::{self, error::TrySendError};
use tokio::task::JoinError;
use tokio::time::MissedTickBehavior;
use tokio_util::task::AbortOnDropHandle;

use super::error::SpoolFileError;
use super::file::{Loaded, SpoolFile};
use super::quarantine::flag_as_damaged;
use super::range_log;
use super::sync::Syncing;

/// Capacity of the channels. The state machine has at most one order of each of the four kinds in progress.
const MAX_ORDERS: usize = 8;

/// An operation on the spool.
#[derive(Clone, Debug)]
pub(in crate::outbox) enum Order {
    /// Appends batches; answered by [`Done::Appended`].
    Append { batches: Vec<SpooledBatch>, totals: Totals },
    /// Reads batches; answered by [`Done::Loaded`].
    Load { from: u64, bytes: usize },
    /// Deletes batches; answered by [`Done::Deleted`].
    Delete { through: u64, chain: Chain },
    /// Starts another stream; answered by [`Done::Renewed`].
    Renew { stream: StreamId, previous_stream: StreamId, first: u64, events_before_first: u64 },
}

/// Result of an order.
#[derive(Debug)]
pub(in crate::outbox) enum OrderResult {
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
    #[error("the spool's task has ended")]
    Ended,
    /// The channel is full, which the state machine never causes.
    #[error("too many orders for the spool's task: {0:?}")]
    Overloaded(Box<Order>),
    /// The disk does not answer in time.
    #[error("the spool's disk does not answer in time")]
    Slow,
    /// The task panicked.
    #[error("the spool's task panicked: {0}")]
    Panicked(#[from] JoinError),
}

/// Handle of the task. Dropping it aborts the task.
#[derive(Debug)]
pub(in crate::outbox) struct SpoolTask {
    orders: mpsc::Sender<Order>,
    results: mpsc::Receiver<OrderResult>,
    task: AbortOnDropHandle<Result<(), SpoolFileError>>,
}

impl SpoolTask {
    /// Starts the task.
    pub(in crate::outbox) fn start(file: SpoolFile, sync_interval: Duration) -> Self {
        let (orders, received_orders) = mpsc::channel(MAX_ORDERS);
        let (result_sender, results) = mpsc::channel(MAX_ORDERS);
        let task =
            AbortOnDropHandle::new(tokio::spawn(run(file, sync_interval, received_orders, result_sender)));
        Self { orders, results, task }
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
    pub(in crate::outbox) async fn next_result(&mut self) -> Option<OrderResult> {
        self.results.recv().await
    }

    /// Waits until all orders are done and the task has closed the file.
    pub(in crate::outbox) async fn close(self) -> Result<(), SpoolTaskError> {
        let Self { orders, results, task } = self;
        drop((orders, results));
        Ok(task.await??)
    }
}

async fn run(
    mut file: SpoolFile,
    sync_interval: Duration,
    mut orders: mpsc::Receiver<Order>,
    results: mpsc::Sender<OrderResult>,
) -> Result<(), SpoolFileError> {
    let mut ticks = tokio::time::interval(sync_interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut syncing = Syncing::new(file.log());
    loop {
        tokio::select! {
            // Orders come last, because they may follow each other without a pause.
            biased;
            result = syncing.wait(), if syncing.is_running() => log_failed_sync(&file, result),
            _ = ticks.tick() => {
                syncing.start();
                // The file shrinks in steps between orders, because a vacuum of the whole file would delay orders.
                shrink(&mut file, &orders).await;
            }
            order = orders.recv() => {
                let Some(order) = order else { break };
                let result = execute(&mut file, &mut syncing, order).await;
                // Sending fails only if the outbox has ended; the order is done nevertheless.
                let _ = results.send(result).await;
            }
        }
    }
    let result = syncing.finish().await;
    log_failed_sync(&file, result);
    file.close().await
}

async fn execute(file: &mut SpoolFile, syncing: &mut Syncing, order: Order) -> OrderResult {
    match order {
        Order::Append { batches, totals } => {
            let result = file.append(&batches, &totals).await;
            if result.is_ok() {
                syncing.mark_written();
                range_log::log_ranges(&batches);
            }
            OrderResult::Appended(flag_if_corrupt(file, result))
        }
        Order::Load { from, bytes } => OrderResult::Loaded(file.load(from, bytes).await.map_err(Into::into)),
        Order::Delete { through, chain } => {
            let result = file.delete_through(through, chain).await;
            OrderResult::Deleted(flag_if_corrupt(file, result))
        }
        Order::Renew { stream, previous_stream, first, events_before_first } => {
            let result = file.renew(stream, previous_stream, (first, events_before_first)).await;
            OrderResult::Renewed(flag_if_corrupt(file, result))
        }
    }
}

/// Flags the file as damaged if SQLite reports damage, so that the next start quarantines it.
fn flag_if_corrupt(file: &SpoolFile, result: Result<(), SpoolFileError>) -> Result<(), SpoolTaskError> {
    if let Err(SpoolFileError::Corrupt { action, source, .. }) = &result {
        // Without the advice to restart the agent, which the next start follows.
        flag_as_damaged(file.path(), &format!("an agent could not {action} it: {source}"));
    }
    Ok(result?)
}

/// Shrinks the file step by step, until an order arrives.
async fn shrink(file: &mut SpoolFile, orders: &mpsc::Receiver<Order>) {
    while orders.is_empty() {
        match file.shrink().await {
            Ok(true) => {}
            Ok(false) => return,
            Err(file_error) => {
                tracing::debug!(error = %file_error, "cannot shrink the spool");
                return;
            }
        }
    }
}

fn log_failed_sync(file: &SpoolFile, result: io::Result<()>) {
    if let Err(error) = result {
        let spool = file.path().display();
        tracing::warn!(%error, "cannot sync the spool {spool}; a power cut may lose its newest events; retrying");
    }
}
