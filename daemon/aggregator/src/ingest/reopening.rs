//! Closes a database whose file failed or was replaced, and opens what stands at its path as soon as that works.

use std::path::PathBuf;
use std::time::Duration;

use super::committing::{Backoff, Errand, StoreEvent, Wires, not_storing, set};
use crate::readiness::Readiness;
use peernet_store::writing::{CommitError, Integrity, OpenDatabase};
use peernet_store::{RetentionConfig, Store, StoreError};

/// What is needed to open the database anew.
#[derive(Debug)]
pub(crate) struct Reopening {
    /// Where it stands.
    pub(crate) path: PathBuf,
    pub(crate) retention: RetentionConfig,
    pub(crate) integrity: Integrity,
    /// The readers, whose connections are replaced as well.
    pub(crate) store: Store,
}

impl Reopening {
    /// Closes all connections, so that a file system can be unmounted, and tries until the file can be opened and
    /// written. `None` when told to stop before.
    pub(super) async fn reopen(
        &self,
        database: OpenDatabase,
        error: &CommitError,
        wires: &mut Wires,
        backoff: &mut Backoff,
    ) -> Option<OpenDatabase> {
        set(&wires.ready, not_storing(error));
        // Closed only while everything ends; so below.
        let _ended = wires.stored.send(StoreEvent::Closed).await;
        // SQLite carries its log over when the last connection is closed.
        self.store.close().await;
        let (former, closed) = database.close().await;
        if let Err(error) = closed {
            tracing::debug!(%error, database = %self.path.display(), "the database was not closed well");
        }
        loop {
            pause(backoff.next(), wires).await?;
            match OpenDatabase::reopen(&self.path, self.retention, &self.integrity, &former).await {
                Ok((database, state)) => {
                    self.store.reopen();
                    let _ended = wires.stored.send(StoreEvent::Opened(Box::new(state))).await;
                    set(&wires.ready, Readiness::Ready);
                    return Some(database);
                }
                Err(error) => set(&wires.ready, not_storing(&error)),
            }
        }
    }
}

/// Waits; errands are refused meanwhile. `None` when told to stop before the end.
async fn pause(pause: Duration, wires: &mut Wires) -> Option<()> {
    let end = tokio::time::sleep(pause);
    tokio::pin!(end);
    loop {
        tokio::select! {
            () = &mut end => return Some(()),
            () = wires.stop.cancelled() => return None,
            Some(errand) = wires.errands.recv() => refuse(errand),
        }
    }
}

fn refuse(errand: Errand) {
    match errand {
        Errand::Pin(_, _, answer) => {
            // Whoever asked may have gone.
            let _gone = answer.send(Err(StoreError::no_database()));
        }
    }
}
