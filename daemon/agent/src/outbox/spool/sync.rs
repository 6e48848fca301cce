//! Syncs SQLite's write-ahead log to the disk in the background.

use std::io;

use tokio::task::JoinHandle;

use super::file::WriteAheadLog;

/// State of syncing the write-ahead log.
#[derive(Debug)]
pub(super) struct Syncing {
    write_ahead_log: WriteAheadLog,
    /// `true` if a transaction was written since the last sync started.
    is_dirty: bool,
    running_sync: Option<JoinHandle<io::Result<()>>>,
}

impl Syncing {
    pub(super) const fn new(write_ahead_log: WriteAheadLog) -> Self {
        Self { write_ahead_log, is_dirty: false, running_sync: None }
    }

    /// Records that a transaction was written.
    pub(super) const fn mark_written(&mut self) {
        self.is_dirty = true;
    }

    /// Starts a sync if a transaction was written and no sync is in progress.
    pub(super) fn start(&mut self) {
        if self.is_dirty && self.running_sync.is_none() {
            // The flag is cleared before the sync starts. A transaction that is written during the sync sets it again.
            self.is_dirty = false;
            self.running_sync = Some(self.write_ahead_log.sync());
        }
    }

    /// Returns whether a sync is in progress.
    pub(super) const fn is_running(&self) -> bool {
        self.running_sync.is_some()
    }

    /// Waits for the end of the sync in progress. A failed sync is repeated by the next [`start`](Self::start).
    /// Cancel-safe.
    pub(super) async fn wait(&mut self) -> io::Result<()> {
        let Some(running_sync) = &mut self.running_sync else { return Ok(()) };
        let result = wait_for_sync(running_sync).await;
        self.running_sync = None;
        self.is_dirty |= result.is_err();
        result
    }

    /// Syncs all written transactions, and waits for the end of the sync.
    pub(super) async fn finish(&mut self) -> io::Result<()> {
        self.wait().await?;
        self.start();
        self.wait().await
    }
}

/// Waits for a sync and returns its result.
pub(super) async fn wait_for_sync(sync: &mut JoinHandle<io::Result<()>>) -> io::Result<()> {
    sync.await.unwrap_or_else(|join_error| Err(io::Error::other(join_error)))
}
