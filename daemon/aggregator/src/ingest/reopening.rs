//! Closes a database whose file failed or was replaced, and opens the file at its path as soon as that is possible.
//!
//! The writer compares the file at the path with the open file before and after each commit and once a second while it
//! is idle. This comparison assumes nothing about the file's content. It therefore also detects files that were moved,
//! replaced or unmounted. A file that can no longer be written is detected by a failed commit. An empty or missing file
//! is never opened: an operator who moves the database away would otherwise get a new, empty database. Batches that
//! were queued before the database was closed are dropped, and the agents send them again.

use std::path::PathBuf;
use std::time::Duration;

use super::backoff::Backoff;
use super::committing::{StoreEvent, TaskContext, WriterRequest, not_storing, set_readiness};
use crate::readiness::Readiness;
use peernet_store::writing::{CommitError, Integrity, OpenDatabase};
use peernet_store::{RetentionConfig, Store, StoreError};

/// The parameters of reopening the database.
#[derive(Debug)]
pub(crate) struct Reopening {
    /// Path of the database.
    pub(crate) path: PathBuf,
    pub(crate) retention: RetentionConfig,
    pub(crate) integrity: Integrity,
    /// The read-only connections, which are closed and reopened with the database.
    pub(crate) store: Store,
}

impl Reopening {
    /// Closes all connections, so that the file system can be unmounted, and retries until the file can be opened and
    /// written. Returns `None` if the aggregator is stopped before that.
    pub(super) async fn reopen(
        &self,
        database: OpenDatabase,
        error: &CommitError,
        context: &mut TaskContext,
        backoff: &mut Backoff,
    ) -> Option<OpenDatabase> {
        // The readiness is set before the files are closed, because closing may take long.
        set_readiness(&context.readiness, not_storing(error));
        // The receiver is closed only while the aggregator ends, here and below.
        let _ended = context.store_events.send(StoreEvent::Closed).await;
        // SQLite checkpoints its -wal file when the last connection is closed. The readers are closed before the
        // writer, because a read-only connection cannot do that.
        self.store.close().await;
        let (former_files, closed) = database.close().await;
        if let Err(error) = closed {
            tracing::debug!(%error, database = %self.path.display(), "cannot close the database cleanly");
        }
        loop {
            pause(backoff.next(), context).await?;
            match OpenDatabase::reopen(&self.path, self.retention, &self.integrity, &former_files).await {
                Ok((database, state)) => {
                    self.store.reopen();
                    let _ended = context.store_events.send(StoreEvent::Opened(Box::new(state))).await;
                    set_readiness(&context.readiness, Readiness::Ready);
                    return Some(database);
                }
                Err(error) => set_readiness(&context.readiness, not_storing(&error)),
            }
        }
    }
}

/// Waits for `pause` and refuses requests meanwhile. Returns `None` if the aggregator is stopped meanwhile.
async fn pause(pause: Duration, context: &mut TaskContext) -> Option<()> {
    let timeout = tokio::time::sleep(pause);
    tokio::pin!(timeout);
    loop {
        tokio::select! {
            () = &mut timeout => return Some(()),
            () = context.stop.cancelled() => return None,
            Some(request) = context.requests.recv() => refuse(request),
        }
    }
}

/// Refuses a request because no database is open.
fn refuse(request: WriterRequest) {
    match request {
        WriterRequest::Pin(_, _, answer) => {
            // The requester may have been dropped.
            let _gone = answer.send(Err(StoreError::pin_while_closed()));
        }
    }
}
