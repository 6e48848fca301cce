//! Tests of the spool with real files.

mod damage;
mod disk;
mod file;
mod fixtures;
mod growth;
mod killed_process;
mod range_log;
mod task;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::{ClockIdentity, ManualClock, SharedClock, WallTime};
use peernet_logger::HostId;
use peernet_stream::{ChainHash, SpoolState, SpooledBatch, Totals};
use tempfile::TempDir;

use super::file::SpoolFile;
use super::{OpenSpool, SpoolError, inspect};

/// Returns the id of the host that owns the spools.
fn host() -> HostId {
    HostId::from_bytes([7; 16])
}

/// A folder for a spool.
struct SpoolFolder {
    folder: TempDir,
}

impl SpoolFolder {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a folder") }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("spool.sqlite")
    }

    async fn open(&self) -> Result<OpenSpool, SpoolError> {
        let is_default_path = true;
        OpenSpool::open(&self.path(), host(), is_default_path, &clock()).await
    }

    /// Opens a spool that must not be damaged.
    async fn open_undamaged(&self) -> (SpoolFile, SpoolState) {
        let OpenSpool { file, state, quarantined, counter, was_empty: _ } = self.open().await.expect("opens");
        assert_eq!(quarantined, None);
        // Without the counter's file, the next start does not look like a start after a killed process.
        counter.remove();
        (file, state)
    }

    async fn lost_when_killed(&self) -> Option<i64> {
        inspect(&self.path()).await.expect("reads").lost_when_killed
    }
}

fn clock() -> SharedClock {
    Arc::new(ManualClock::new(WallTime::from_unix_nanos(5_000_000_000), ClockIdentity::new("boot", "system")))
}

/// Returns batches with these numbers and bodies of `bytes` bytes, whose chain hashes continue `previous_chain`.
fn batches(
    mut previous_chain: ChainHash,
    numbers: impl IntoIterator<Item = u64>,
    bytes: usize,
) -> Vec<SpooledBatch> {
    let batch = |number: u64| {
        let body = Bytes::from(vec![number as u8; bytes]);
        previous_chain = previous_chain.next(3, &body);
        SpooledBatch {
            number,
            since: WallTime::from_unix_nanos(number as i64),
            events: 3,
            chain: previous_chain,
            body,
        }
    };
    numbers.into_iter().map(batch).collect()
}

/// Returns totals with this number of produced events, of which two were dropped and reported in a gap.
fn totals(produced: u64) -> Totals {
    Totals { produced, dropped: 2, gaps: 1, reported_drops: 2, ..Totals::default() }
}

/// Returns the names of the files in a folder, without the files that SQLite and the agent keep beside an open spool.
fn list_files(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("can be listed");
    let name = |entry: std::io::Result<std::fs::DirEntry>| {
        entry.expect("can be listed").file_name().into_string().expect("the name is UTF-8")
    };
    let mut names: Vec<String> = entries.map(name).collect();
    names.retain(|name| !["-shm", "-wal", "-lock", "-reserve"].iter().any(|ending| name.ends_with(ending)));
    names.sort();
    names
}
