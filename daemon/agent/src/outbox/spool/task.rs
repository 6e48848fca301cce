//! The task that owns the spool file. It executes requests and returns results over channels.

use std::io;
use std::time::Duration;

use peernet_stream::{ChainHash, SpooledBatch, StreamId, Totals};
use tokio::sync::mpsc::{self, error::TrySendError};
use tokio::task::JoinError;
use tokio::time::MissedTickBehavior;
use tokio_util::task::AbortOnDropHandle;

use super::error::SpoolFileError;
use super::file::{LoadedBatches, SpoolFile};
use super::quarantine::flag_as_damaged;
use super::range_log;
use super::sync::Syncing;

/// Capacity of the channels. The state machine has at most one request of each of the four kinds in progress.
const MAX_REQUESTS: usize = 8;

/// An operation on the spool.
#[derive(Clone, Debug)]
pub(in crate::outbox) enum SpoolRequest {
    /// Appends batches; answered by [`SpoolResult::Appended`].
    Append { batches: Vec<SpooledBatch>, totals: Totals },
    /// Reads batches; answered by [`SpoolResult::Loaded`].
    Load { from: u64, bytes: usize },
    /// Deletes batches; answered by [`SpoolResult::Deleted`].
    Delete { through: u64, chain: ChainHash },
    /// Starts another stream; answered by [`SpoolResult::Renewed`].
    Renew { stream: StreamId, previous_stream: StreamId, first: u64, events_before_first: u64 },
}

/// Result of a request.
#[derive(Debug)]
pub(in crate::outbox) enum SpoolResult {
    Appended(Result<(), SpoolTaskError>),
    Loaded(Result<LoadedBatches, SpoolTaskError>),
    Deleted(Result<(), SpoolTaskError>),
    Renewed(Result<(), SpoolTaskError>),
}

/// Reason why a request failed.
#[derive(Debug, thiserror::Error)]
pub(in crate::outbox) enum SpoolTaskError {
    /// The file cannot be read or written.
    #[error(transparent)]
    File(#[from] SpoolFileError),
    /// The task has ended.
    #[error("the spool's task has ended")]
    Ended,
    /// The channel is full, which the state machine never causes.
    #[error("too many requests for the spool's task: {0:?}")]
    Overloaded(Box<SpoolRequest>),
    /// The disk does not answer in time.
    #[error("the spool's disk does not answer in time")]
    Slow,
    /// The task panicked.
    #[error("the spool's task panicked: {0}")]
    Panicked(#[from] JoinError),
}

/// Handle of the task. Dropping the handle aborts the task.
#[derive(Debug)]
pub(in crate::outbox) struct SpoolTask {
    requests: mpsc::Sender<SpoolRequest>,
    results: mpsc::Receiver<SpoolResult>,
    task: AbortOnDropHandle<Result<(), SpoolFileError>>,
}

impl SpoolTask {
    /// Starts the task.
    pub(in crate::outbox) fn start(file: SpoolFile, sync_interval: Duration) -> Self {
        let (requests, received_requests) = mpsc::channel(MAX_REQUESTS);
        let (result_sender, results) = mpsc::channel(MAX_REQUESTS);
        let task =
            AbortOnDropHandle::new(tokio::spawn(run(file, sync_interval, received_requests, result_sender)));
        Self { requests, results, task }
    }

    /// Sends a request to the task, without waiting.
    ///
    /// # Errors
    /// When the task has ended, or its channel is full, which must not happen.
    pub(in crate::outbox) fn request(&self, request: SpoolRequest) -> Result<(), SpoolTaskError> {
        self.requests.try_send(request).map_err(|error| match error {
            TrySendError::Closed(_) => SpoolTaskError::Ended,
            TrySendError::Full(request) => SpoolTaskError::Overloaded(Box::new(request)),
        })
    }

    /// Waits for the next result; `None` if the task has ended.
    pub(in crate::outbox) async fn next_result(&mut self) -> Option<SpoolResult> {
        self.results.recv().await
    }

    /// Waits until all requests are done and the task has closed the file.
    pub(in crate::outbox) async fn close(self) -> Result<(), SpoolTaskError> {
        let Self { requests, results, task } = self;
        drop((requests, results));
        Ok(task.await??)
    }
}

/// Executes requests until their channel is closed, and closes the file.
async fn run(
    mut file: SpoolFile,
    sync_interval: Duration,
    mut requests: mpsc::Receiver<SpoolRequest>,
    results: mpsc::Sender<SpoolResult>,
) -> Result<(), SpoolFileError> {
    let mut ticks = tokio::time::interval(sync_interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut syncing = Syncing::new(file.write_ahead_log());
    loop {
        tokio::select! {
            // Requests are the last branch, because they may follow each other without a pause and would delay the
            // syncs.
            biased;
            result = syncing.wait(), if syncing.is_running() => log_failed_sync(&file, result),
            _ = ticks.tick() => {
                syncing.start();
                // The file shrinks in steps between requests, because a vacuum of the whole file would delay requests.
                shrink(&mut file, &requests).await;
            }
            request = requests.recv() => {
                let Some(request) = request else { break };
                let result = execute(&mut file, &mut syncing, request).await;
                // Sending the result fails only if the outbox has ended.
                let _ = results.send(result).await;
            }
        }
    }
    let result = syncing.finish().await;
    log_failed_sync(&file, result);
    file.close().await
}

async fn execute(file: &mut SpoolFile, syncing: &mut Syncing, request: SpoolRequest) -> SpoolResult {
    match request {
        SpoolRequest::Append { batches, totals } => {
            let result = file.append(&batches, &totals).await;
            if result.is_ok() {
                syncing.mark_written();
                range_log::log_ranges(&batches);
            }
            SpoolResult::Appended(flag_if_corrupt(file, result))
        }
        SpoolRequest::Load { from, bytes } => {
            // `load` returns damage in its result and not as an error, so there is no error to flag.
            SpoolResult::Loaded(file.load(from, bytes).await.map_err(Into::into))
        }
        SpoolRequest::Delete { through, chain } => {
            let result = file.delete_through(through, chain).await;
            SpoolResult::Deleted(flag_if_corrupt(file, result))
        }
        SpoolRequest::Renew { stream, previous_stream, first, events_before_first } => {
            let result = file.renew(stream, previous_stream, (first, events_before_first)).await;
            SpoolResult::Renewed(flag_if_corrupt(file, result))
        }
    }
}

/// Flags the file as damaged if SQLite reports damage, so that the next start quarantines it.
fn flag_if_corrupt(file: &SpoolFile, result: Result<(), SpoolFileError>) -> Result<(), SpoolTaskError> {
    if let Err(SpoolFileError::Corrupt { action, source, .. }) = &result {
        // The text omits the advice to restart the agent, because it is read after the restart.
        flag_as_damaged(file.path(), &format!("an agent could not {action} it: {source}"));
    }
    Ok(result?)
}

/// Shrinks the file step by step, until a request arrives.
async fn shrink(file: &mut SpoolFile, requests: &mpsc::Receiver<SpoolRequest>) {
    while requests.is_empty() {
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
