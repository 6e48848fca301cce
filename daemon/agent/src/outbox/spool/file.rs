//! An open spool file and its operations, each in one transaction.

use std::fmt;
use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use peernet_clock::WallTime;
use peernet_stream::{ChainHash, SpooledBatch, StreamId, Totals};
use sqlx::{Connection, SqliteConnection};
use tokio::task::JoinHandle;

use super::error::SpoolFileError;
use super::killed_process;
use super::open::chain_from_column;
use super::quarantine::with_suffix;
use super::reserve::Reserve;
use super::statements::{checkpoint, delete, insert, vacuum, vacuum_all};
use super::sync::wait_for_sync;
use crate::event_queue::counter;
use crate::lock::FileLock;

/// An open spool file: the stream of one host.
#[derive(Debug)]
pub(in crate::outbox) struct SpoolFile {
    path: PathBuf,
    /// Device and inode of the open file.
    // Both numbers are needed, because an inode number is unique only within one file system.
    identity: (u64, u64),
    connection: SqliteConnection,
    reserve: Reserve,
    /// `true` if this process counts the events that it queues.
    counts_events: bool,
    _lock: FileLock,
}

/// Result of reading batches.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::outbox) struct LoadedBatches {
    /// Contiguous batches whose chain hashes were checked. The first batch cannot be checked if the previous batch is
    /// missing.
    pub(in crate::outbox) batches: Vec<SpooledBatch>,
    /// Damage that ends the list; `None` if the list ends for another reason.
    pub(in crate::outbox) damage: Option<String>,
}

impl SpoolFile {
    pub(super) fn new(
        path: PathBuf,
        connection: SqliteConnection,
        reserve: Reserve,
        counts_events: bool,
        lock: FileLock,
    ) -> io::Result<Self> {
        let identity = identity(&path)?;
        Ok(Self { path, identity, connection, reserve, counts_events, _lock: lock })
    }

    /// Returns the path of the file.
    pub(in crate::outbox) fn path(&self) -> &Path {
        &self.path
    }

    /// Writes batches, together with the totals up to the last of these batches, in one transaction. Without batches
    /// the totals are synced to the disk. On a full disk, only this case may use the reserve: batches may be lost, but
    /// the number of lost events must not be lost as well.
    pub(in crate::outbox) async fn append(
        &mut self,
        batches: &[SpooledBatch],
        totals: &Totals,
    ) -> Result<(), SpoolFileError> {
        const ACTION: &str = "append to";
        self.check_in_place()?;
        // Batches must not use the space of the reserve: without it nothing could be deleted on a full disk.
        if !self.reserve.allocate() && !batches.is_empty() {
            return Err(SpoolFileError::Full { action: ACTION, path: self.path.clone() });
        }
        // `unreported` is set if it is known which batches of an earlier, killed process the aggregator has stored. The
        // file in which that process counted its events is then removed below.
        let counter_to_remove = match totals.unreported {
            Some(_) => killed_process::unresolved_counter(&mut self.connection)
                .await
                .map_err(self.file_error(ACTION))?,
            None => None,
        };
        match self.try_to_append(ACTION, batches, totals).await {
            Err(SpoolFileError::Full { .. }) if batches.is_empty() && self.reserve.release() => {
                let append_result = self.append_on_full_disk(ACTION, totals).await;
                self.reserve.allocate();
                append_result?;
            }
            append_result => append_result?,
        }
        // The file now contains the losses of the earlier process, so the counts of that process are no longer needed.
        if let Some(counter) = counter_to_remove {
            counter::remove(&counter);
        }
        if batches.is_empty() {
            // The totals may contain `newest_sendable`. After this write the outbox may send batches that are only in
            // memory, and the aggregator may store them. After a power cut the file must still state which
            // process sent them.
            self.sync(ACTION).await?;
        }
        Ok(())
    }

    /// Reads batches from number `from` on: at least one, and more until their total length is `bytes` or more.
    pub(in crate::outbox) async fn load(
        &mut self,
        from: u64,
        bytes: usize,
    ) -> Result<LoadedBatches, SpoolFileError> {
        let mut loaded = LoadedBatches { batches: Vec::new(), damage: None };
        let mut size = 0;
        // If the chain hash before `from` is on a damaged page, the chain hash of the first batch is not checked, as
        // after a gap.
        let mut previous_chain = match self.chain_before(from).await {
            Err(SpoolFileError::Corrupt { .. }) => None,
            chain => chain?,
        };
        let mut number = from;
        while loaded.batches.is_empty() || size < bytes {
            match self.read(number, previous_chain).await {
                Ok(Ok(batch)) => {
                    (size, previous_chain) = (size + batch.body.len(), Some(batch.chain));
                    loaded.batches.push(batch);
                }
                // A missing batch ends the list, unless it is the first batch of the list.
                Ok(Err(BatchDamage::Missing)) if !loaded.batches.is_empty() => break,
                Ok(Err(batch_damage)) => {
                    loaded.damage = Some(self.damage_text(number, batch_damage));
                    break;
                }
                Err(SpoolFileError::Corrupt { source, .. }) => {
                    loaded.damage = Some(self.damage_text(number, format!("cannot be read ({source})")));
                    break;
                }
                // The batches that were read are returned. If the error persists, the next call returns it.
                Err(_) if !loaded.batches.is_empty() => break,
                Err(file_error) => return Err(file_error),
            }
            number += 1;
        }
        Ok(loaded)
    }

    /// Deletes the batches up to number `through` and stores the chain hash of that batch.
    pub(in crate::outbox) async fn delete_through(
        &mut self,
        through: u64,
        chain: ChainHash,
    ) -> Result<(), SpoolFileError> {
        self.check_in_place()?;
        match self.try_to_delete(through, chain).await {
            Err(SpoolFileError::Full { .. }) if self.reserve.release() => {
                let result = self.delete_on_full_disk(through, chain).await;
                self.reserve.allocate();
                result
            }
            result => result,
        }
    }

    /// Changes the file to another stream. The first batch of this stream has the number `first`, and `events_before`
    /// events precede it.
    pub(in crate::outbox) async fn renew(
        &mut self,
        stream: StreamId,
        previous_stream: StreamId,
        (first, events_before): (u64, u64),
    ) -> Result<(), SpoolFileError> {
        const ACTION: &str = "start a new stream in";
        self.check_in_place()?;
        let statement =
            "UPDATE stream SET uuid = ?, previous = ?, first = ?, events_before_first = ? WHERE id = 1";
        let result = sqlx::query(statement)
            .bind(stream.to_string())
            .bind(previous_stream.to_string())
            .bind(first.cast_signed())
            .bind(events_before.cast_signed())
            .execute(&mut self.connection)
            .await;
        result.map_err(self.file_error(ACTION))?;
        self.check_in_place()?;
        // Without this sync a power cut could restore the old stream, and batches that were stored in the new stream
        // would be sent again.
        self.sync(ACTION).await
    }

    /// Gives some of the unused pages back to the file system, after a backlog. Returns whether another call may give
    /// back further pages.
    pub(in crate::outbox) async fn shrink(&mut self) -> Result<bool, SpoolFileError> {
        let result = vacuum(&mut self.connection).await;
        match result.map_err(self.file_error("shrink")) {
            Err(SpoolFileError::Full { .. }) if self.reserve.release() => {
                let result = self.shrink_on_full_disk().await;
                self.reserve.allocate();
                result.map(|()| false)
            }
            result => result,
        }
    }

    /// Returns SQLite's write-ahead log, to which every change is written before it is moved to the file.
    pub(in crate::outbox) fn write_ahead_log(&self) -> WriteAheadLog {
        WriteAheadLog(with_suffix(&self.path, "-wal"))
    }

    /// Moves the write-ahead log to the file and closes the file.
    pub(in crate::outbox) async fn close(self) -> Result<(), SpoolFileError> {
        let path = self.path;
        self.connection.close().await.map_err(|source| SpoolFileError::new("close", path, source))
    }

    /// Returns the connection, for tests that change the file or its settings.
    #[cfg(test)]
    pub(super) fn connection(&mut self) -> &mut SqliteConnection {
        &mut self.connection
    }

    async fn try_to_append(
        &mut self,
        action: &'static str,
        batches: &[SpooledBatch],
        totals: &Totals,
    ) -> Result<(), SpoolFileError> {
        let result = insert(&mut self.connection, batches, totals, self.counts_events).await;
        self.end_transaction(action, result).await
    }

    /// Writes the totals after emptying the write-ahead log, so that repeated writes do not make it longer each time.
    async fn append_on_full_disk(
        &mut self,
        action: &'static str,
        totals: &Totals,
    ) -> Result<(), SpoolFileError> {
        checkpoint(&mut self.connection).await.map_err(self.file_error(action))?;
        self.try_to_append(action, &[], totals).await
    }

    async fn try_to_delete(&mut self, through: u64, chain: ChainHash) -> Result<(), SpoolFileError> {
        let result = delete(&mut self.connection, through, chain).await;
        self.end_transaction("delete from", result).await
    }

    /// Deletes batches after emptying the write-ahead log, which may be longer than the reserve. Returns the deleted
    /// pages to the file system.
    async fn delete_on_full_disk(&mut self, through: u64, chain: ChainHash) -> Result<(), SpoolFileError> {
        checkpoint(&mut self.connection).await.map_err(self.file_error("delete from"))?;
        self.try_to_delete(through, chain).await?;
        self.shrink_on_full_disk().await
    }

    /// Returns all unused pages to the file system.
    async fn shrink_on_full_disk(&mut self) -> Result<(), SpoolFileError> {
        let shrink = async {
            checkpoint(&mut self.connection).await?;
            vacuum_all(&mut self.connection).await
        };
        shrink.await.map_err(self.file_error("shrink"))
    }

    /// Returns the chain hash of the batch before `number`; `None` if the file does not contain this chain hash.
    async fn chain_before(&mut self, number: u64) -> Result<Option<ChainHash>, SpoolFileError> {
        let bytes: Option<Vec<u8>> = sqlx::query_scalar(
            "SELECT chain FROM batch WHERE number = ?1 UNION ALL SELECT chain FROM stream WHERE acknowledged = ?1",
        )
        .bind((number.saturating_sub(1)).cast_signed())
        .fetch_optional(&mut self.connection)
        .await
        .map_err(self.file_error("read"))?;
        Ok(bytes.and_then(|bytes| chain_from_column(&bytes).ok()))
    }

    /// Reads one batch and checks its chain hash. The inner error is damage of this batch only.
    async fn read(
        &mut self,
        number: u64,
        previous_chain: Option<ChainHash>,
    ) -> Result<Result<SpooledBatch, BatchDamage>, SpoolFileError> {
        let row: Option<(i64, u32, Vec<u8>, Vec<u8>)> =
            sqlx::query_as("SELECT since_ns, events, chain, body FROM batch WHERE number = ?")
                .bind(number.cast_signed())
                .fetch_optional(&mut self.connection)
                .await
                .map_err(self.file_error("read"))?;
        let Some((since, events, stored_chain, body)) = row else { return Ok(Err(BatchDamage::Missing)) };
        let since = WallTime::from_unix_nanos(since);
        Ok(match chain_from_column(&stored_chain) {
            // The chain hash of the first batch after a gap cannot be checked; the chain hash of the next batch can.
            Ok(chain) if previous_chain.is_none_or(|previous| previous.next(events, &body) == chain) => {
                Ok(SpooledBatch { number, since, events, chain, body: Bytes::from(body) })
            }
            _ => Err(BatchDamage::Changed),
        })
    }

    fn damage_text(&self, number: u64, damage: impl fmt::Display) -> String {
        format!("batch {number} in the spool {} {damage}; it is not sent", self.path.display())
    }

    /// Waits until the write-ahead log is on the disk.
    async fn sync(&mut self, action: &'static str) -> Result<(), SpoolFileError> {
        let result = wait_for_sync(&mut self.write_ahead_log().sync()).await;
        result.map_err(|error| self.file_error(action)(sqlx::Error::Io(error)))
    }

    /// Commits the transaction if it succeeded, and rolls it back if it failed.
    async fn end_transaction(
        &mut self,
        action: &'static str,
        result: Result<(), sqlx::Error>,
    ) -> Result<(), SpoolFileError> {
        let commit_result = match result {
            Ok(()) => sqlx::query("COMMIT").execute(&mut self.connection).await.map(drop),
            Err(error) => Err(error),
        };
        if let Err(error) = commit_result {
            // After some errors SQLite has rolled back already and reports that there is nothing to roll back.
            if let Err(error) = sqlx::query("ROLLBACK").execute(&mut self.connection).await {
                tracing::debug!(%error, "nothing to roll back in the spool");
            }
            return Err(self.file_error(action)(error));
        }
        // If the file was moved during the transaction, the result must be an error: the next process does not find the
        // committed rows.
        self.check_in_place()
    }

    /// Checks that the path still refers to the open file.
    // The check is cheap enough for each operation: the file system answers from its cache.
    fn check_in_place(&self) -> Result<(), SpoolFileError> {
        match identity(&self.path) {
            Ok(identity) if identity == self.identity => Ok(()),
            _ => Err(SpoolFileError::Moved(self.path.clone())),
        }
    }

    /// Returns a function that adds the attempted action and the path to an error of SQLite.
    fn file_error(&self, action: &'static str) -> impl Fn(sqlx::Error) -> SpoolFileError + use<> {
        let path = self.path.clone();
        move |source| SpoolFileError::new(action, path.clone(), source)
    }
}

/// Damage of one batch.
#[derive(Debug, thiserror::Error)]
enum BatchDamage {
    #[error("is missing")]
    Missing,
    #[error("was changed")]
    Changed,
}

/// The file of SQLite's write-ahead log.
#[derive(Clone, Debug)]
pub(in crate::outbox) struct WriteAheadLog(PathBuf);

impl WriteAheadLog {
    /// Syncs the write-ahead log to the disk on a blocking thread, because a memory card sometimes takes seconds.
    // The log is opened for the sync. SQLite does not lock the log, so closing this descriptor releases no lock. The
    // spool file must never be opened in this way, because closing that descriptor would release SQLite's locks.
    pub(super) fn sync(&self) -> JoinHandle<io::Result<()>> {
        let path = self.0.clone();
        tokio::task::spawn_blocking(move || match File::open(path) {
            Ok(log) => log.sync_data(),
            // There is no log before the first transaction.
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(error),
        })
    }
}

/// Returns device and inode of the file at a path.
fn identity(path: &Path) -> io::Result<(u64, u64)> {
    std::fs::metadata(path).map(|file| (file.dev(), file.ino()))
}
