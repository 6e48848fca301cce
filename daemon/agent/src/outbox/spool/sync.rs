//! Syncs the log in the background, while it is written.

use std::io;

use tokio::task::JoinHandle;

use super::file::Log;

/// State of syncing the log.
#[derive(Debug)]
pub(super) struct Syncing {
    log: Log,
    /// `true` if something was written since the last sync began.
    dirty: bool,
    running: Option<JoinHandle<io::Result<()>>>,
}

impl Syncing {
    pub(super) const fn new(log: Log) -> Self {
        Self { log, dirty: false, running: None }
    }

    /// Records that something was written.
    pub(super) const fn written(&mut self) {
        self.dirty = true;
    }

    /// Begins to sync what was written, unless a sync is in progress.
    pub(super) fn begin(&mut self) {
        if self.dirty && self.running.is_none() {
            self.dirty = false;
            self.running = Some(self.log.sync());
        }
    }

    /// Returns whether [`ended`](Self::ended) has something to wait for.
    pub(super) const fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Waits for the end of the sync in progress. A failed one is repeated at the next [`begin`](Self::begin).
    /// Dropping the future loses nothing.
    pub(super) async fn ended(&mut self) -> io::Result<()> {
        let Some(running) = &mut self.running else { return Ok(()) };
        let synced = ended(running).await;
        self.running = None;
        self.dirty |= synced.is_err();
        synced
    }

    /// Syncs everything that was written, and waits for it.
    pub(super) async fn finish(&mut self) -> io::Result<()> {
        self.ended().await?;
        self.begin();
        self.ended().await
    }
}

/// Waits for a sync and returns its result.
pub(super) async fn ended(sync: &mut JoinHandle<io::Result<()>>) -> io::Result<()> {
    sync.await.unwrap_or_else(|died| Err(io::Error::other(died)))
}
