//! Counts the queued events in a file that survives a kill of the process.
//!
//! From the time an event is queued until its batch is in the spool, only the memory of this process contains the
//! event. To count the events that a kill loses, each event is counted before it is queued, in a file in shared memory.
//! The file has one count for each run. With each batch the spool stores how many of the counted events are settled so
//! far: they are in batches or were dropped. The next process reports the difference between the counted and the
//! settled events as a gap (`outbox/spool/killed_process.rs`).
//!
//! The file is in `/dev/shm`, because a write to a disk can wait for that disk, which would disturb the measurements.
//! The file is written and not mapped, because a failed write to a mapping would end the process. After a restart of
//! the machine the file is gone, and no gap is reported.
//!
//! The file contains the identity of its spool, and the counting process holds a lock on the file. So a copy of the
//! spool does not use the file, and a file whose spool was deleted can be removed.
//!
//! Batches that were sent while the spool could not be written are also recorded. Only the aggregator knows which of
//! these batches it stored, so the next process queries the aggregator before the process reports a loss
//! (`peernet_stream`, `unresolved.rs`).

mod abandoned;
mod locked;
mod owner;
#[cfg(test)]
mod tests;

pub(crate) use self::abandoned::remove_abandoned;
pub(crate) use self::locked::LockedCounts;
pub(crate) use self::owner::CountOwner;

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_clock::WallTime;
use peernet_logger::{RunId, Slug};
use peernet_stream::{CountedEvents, CountedRun, MAX_COUNTED_RUNS, MAX_SENT_UNSPOOLED, SentUnspooled};
use rustix::fs::{OFlags, statfs};
use uuid::Uuid;

use self::owner::OWNER_BYTES;

/// Folder of a file system in memory.
const SHARED_MEMORY: &str = "/dev/shm";
/// `f_type` of a file system in memory (statfs(2)).
const TMPFS_MAGIC: i64 = 0x0102_1994;
/// First bytes of the file.
const MAGIC: &[u8; 8] = b"PNcount3";
/// First bytes of a file of an earlier version, which does not contain the identity of its spool.
const MAGIC_WITHOUT_OWNER: &[u8; 8] = b"PNcount2";
/// Length in bytes of the header, and of each of the run records after it. No record crosses the border of a page,
/// because a kill can interrupt a write at such a border.
// A record with the longest name (64 bytes) takes 105 bytes. A page is a multiple of the next power of two.
const RECORD_BYTES: usize = 128;
/// Offset of the total number of events in the header.
const TOTAL_OFFSET: u64 = 8;
// A record contains: total number of events, time of the last event, number of the run's events (8 bytes each), run id,
// length of the pipeline's name, and the name.
const NUMBERS_BYTES: usize = 24;
const NAME_OFFSET: usize = NUMBERS_BYTES + 16;
/// Offset of the slots for batches that were sent without being in the spool. The number of a batch selects the slot.
/// Each slot has the five numbers of a [`SentUnspooled`].
const SENT_OFFSET: usize = RECORD_BYTES * (1 + MAX_COUNTED_RUNS);
const SENT_RECORD_BYTES: usize = 40;
/// Offset of the identity of the spool that the counts belong to.
const OWNER_OFFSET: usize = SENT_OFFSET + SENT_RECORD_BYTES * MAX_SENT_UNSPOOLED;
const FILE_BYTES: usize = OWNER_OFFSET + OWNER_BYTES;

/// Counter of queued events. Clones share the counter; without a file nothing is counted.
#[derive(Clone, Debug, Default)]
pub(crate) struct EventCounter(Option<Arc<Mutex<CountFile>>>);

/// An open file of counts, and the counts in the file.
#[derive(Debug)]
struct CountFile {
    file: File,
    name: String,
    /// Number of all counted events, with and without a run.
    total: u64,
    /// For each run with a record: the index of the record and the number of the run's events.
    runs: BTreeMap<RunId, (usize, u64)>,
    /// Indices of the unused records.
    unused_records: Vec<usize>,
    /// The last recorded batch that was sent without being in the spool.
    last_sent: Option<SentUnspooled>,
    /// `true` once a write has failed.
    has_failed: bool,
}

impl EventCounter {
    /// Creates a file in shared memory for a spool.
    ///
    /// # Errors
    /// When there is no shared memory.
    pub(crate) fn create(owner: &CountOwner) -> io::Result<Self> {
        let folder = Path::new(SHARED_MEMORY);
        if statfs(folder)?.f_type != TMPFS_MAGIC {
            return Err(io::Error::other(format!("{SHARED_MEMORY} is not a tmpfs")));
        }
        let name = format!("peernet-{}.count", Uuid::new_v4());
        // The whole file is written now, so that later writes need no more memory and cannot fail because memory is
        // full.
        let mut bytes = vec![0; FILE_BYTES];
        bytes[..MAGIC.len()].copy_from_slice(MAGIC);
        let owner = owner.encode();
        bytes[OWNER_OFFSET..OWNER_OFFSET + owner.len()].copy_from_slice(&owner);
        let file = create_file(&name, &bytes)?;
        let unused_records = (1..=MAX_COUNTED_RUNS).rev().collect();
        let count_file = CountFile {
            file,
            name,
            total: 0,
            runs: BTreeMap::new(),
            unused_records,
            last_sent: None,
            has_failed: false,
        };
        Ok(Self(Some(Arc::new(Mutex::new(count_file)))))
    }

    /// Returns the name of the file, by which the next process finds it.
    pub(crate) fn name(&self) -> Option<String> {
        self.lock_counts().map(|count_file| count_file.name.clone())
    }

    /// Counts an event that is about to be queued.
    pub(crate) fn count(&self, pipeline: Option<&Slug>, run: Option<RunId>, now: WallTime) {
        if let Some(mut count_file) = self.lock_counts() {
            let result = count_file.count(pipeline, run, now);
            count_file.log_first_failure(result);
        }
    }

    /// Records a batch that is about to be sent without being in the spool.
    pub(crate) fn record_sent_unspooled(&self, sent: SentUnspooled) {
        if let Some(mut count_file) =
            self.lock_counts().filter(|count_file| count_file.last_sent != Some(sent))
        {
            count_file.last_sent = Some(sent);
            let SentUnspooled { process, number, batched, reported_drops, events } = sent;
            let bytes = [process, number, batched, reported_drops, events].map(u64::to_be_bytes).concat();
            // The slots are a ring: a batch overwrites the older batch in its slot.
            let offset = SENT_OFFSET as u64 + number % MAX_SENT_UNSPOOLED as u64 * SENT_RECORD_BYTES as u64;
            let result = count_file.file.write_all_at(&bytes, offset);
            count_file.log_first_failure(result);
        }
    }

    /// Frees the record of an ended run if all events of the run are settled: in batches or dropped. `settled_events`
    /// is the number of the run's settled events. Returns whether all events are settled.
    pub(crate) fn release_if_settled(&self, run: RunId, settled_events: u64) -> bool {
        let Some(mut count_file) = self.lock_counts() else { return true };
        let Some((record_index, counted_events)) = count_file.runs.get(&run).copied() else { return true };
        if counted_events == settled_events {
            let result = count_file.release(run, record_index);
            count_file.log_first_failure(result);
        }
        counted_events == settled_events
    }

    /// Creates the file again, with the same counts, if it was deleted.
    pub(crate) fn recreate_if_deleted(&self) {
        if let Some(mut count_file) = self.lock_counts() {
            let result = count_file.recreate_if_deleted();
            count_file.log_first_failure(result);
        }
    }

    /// Returns the number of all counted events; `None` if events are not counted.
    pub(crate) fn total(&self) -> Option<u64> {
        self.lock_counts().map(|count_file| count_file.total)
    }

    /// Removes the file. Called when no counted event can be lost any more.
    pub(crate) fn remove(&self) {
        if let Some(name) = self.name() {
            remove(&name);
        }
    }

    fn lock_counts(&self) -> Option<MutexGuard<'_, CountFile>> {
        self.0.as_ref().map(|count_file| count_file.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl CountFile {
    fn count(&mut self, pipeline: Option<&Slug>, run: Option<RunId>, now: WallTime) -> io::Result<()> {
        self.total += 1;
        let numbers = [self.total.to_be_bytes(), now.unix_nanos().to_be_bytes()].concat();
        // To count an event with a single write, the total is written to the record of its run. The largest total of
        // all records is the current one.
        let Some(run) = run else { return self.file.write_all_at(&numbers, TOTAL_OFFSET) };
        if let Some((record_index, events)) = self.runs.get_mut(&run) {
            *events += 1;
            let numbers = [&numbers[..], &events.to_be_bytes()].concat();
            return self.file.write_all_at(&numbers, (*record_index * RECORD_BYTES) as u64);
        }
        // If all records are in use, the event counts in the total only.
        let Some(record_index) = self.unused_records.pop() else {
            return self.file.write_all_at(&numbers, TOTAL_OFFSET);
        };
        self.runs.insert(run, (record_index, 1));
        let name = pipeline.map_or("", Slug::as_str).as_bytes();
        let length = u8::try_from(name.len()).unwrap_or_default();
        let record = [&numbers[..], &1_u64.to_be_bytes(), run.as_bytes(), &[length], name].concat();
        self.file.write_all_at(&record, (record_index * RECORD_BYTES) as u64)
    }

    fn release(&mut self, run: RunId, record_index: usize) -> io::Result<()> {
        // The total is written to the header first, because the record may have the newest total.
        self.file.write_all_at(&self.total.to_be_bytes(), TOTAL_OFFSET)?;
        self.file.write_all_at(&[0; RECORD_BYTES], (record_index * RECORD_BYTES) as u64)?;
        self.runs.remove(&run);
        self.unused_records.push(record_index);
        Ok(())
    }

    fn recreate_if_deleted(&mut self) -> io::Result<()> {
        if self.has_failed || self.file.metadata()?.nlink() > 0 {
            return Ok(());
        }
        let mut bytes = vec![0; FILE_BYTES];
        // The open file keeps its content, although its name is gone.
        self.file.read_exact_at(&mut bytes, 0)?;
        self.file = create_file(&self.name, &bytes)?;
        tracing::warn!(
            "{SHARED_MEMORY}/{} was deleted while the agent counted its events in it; the agent created it again",
            self.name
        );
        Ok(())
    }

    /// Logs the first failed write.
    fn log_first_failure(&mut self, result: io::Result<()>) {
        if let Err(error) = result
            && !std::mem::replace(&mut self.has_failed, true)
        {
            tracing::warn!(
                %error,
                "cannot count events in {SHARED_MEMORY}/{}; if the agent is killed, the reported number of lost events is too small",
                self.name
            );
        }
    }
}

/// Creates a locked file with this content. After a failure, such as that of a full memory, no file remains.
// The file is locked before anything is written, because a complete file without a lock belongs to a process that has
// ended.
fn create_file(name: &str, bytes: &[u8]) -> io::Result<File> {
    let path = Path::new(SHARED_MEMORY).join(name);
    let file = File::options().read(true).write(true).create_new(true).mode(0o600).open(path)?;
    let result = file.lock().and_then(|()| file.write_all_at(bytes, 0));
    if result.is_err() {
        remove(name);
    }
    result.map(|()| file)
}

/// Opens the file of this name in shared memory for reading, if it belongs to this user.
fn open_owned_file(name: &str) -> Option<File> {
    open_owned_file_with(name, File::options().read(true))
}

/// Opens the file of this name in shared memory with these options, if it belongs to this user.
fn open_owned_file_with(name: &str, options: &mut OpenOptions) -> Option<File> {
    // Other users can create files in this folder: opening must not block on a FIFO, and must not follow a link.
    let flags = i32::try_from((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits()).ok()?;
    // The name comes from the spool and may be any path. The last component of a path cannot lead out of the folder.
    let path = Path::new(SHARED_MEMORY).join(Path::new(name).file_name()?);
    let file = options.custom_flags(flags).open(path).ok()?;
    let metadata = file.metadata().ok()?;
    (metadata.is_file() && metadata.uid() == rustix::process::geteuid().as_raw()).then_some(file)
}

/// Reads the identity of the spool from a file of counts; `None` for any other file, and for a file of an earlier
/// version.
fn read_owner(file: &File) -> Option<CountOwner> {
    let (mut magic, mut owner) = ([0; MAGIC.len()], [0; OWNER_BYTES]);
    file.read_exact_at(&mut magic, 0).ok()?;
    if magic != *MAGIC {
        return None;
    }
    file.read_exact_at(&mut owner, OWNER_OFFSET as u64).ok()?;
    CountOwner::decode(&owner)
}

/// Returns whether the file of this name belongs to another spool.
pub(crate) fn belongs_to_another_spool(name: &str, spool: &CountOwner) -> bool {
    open_owned_file(name).and_then(|file| read_owner(&file)).is_some_and(|owner| !owner.is_same_file(spool))
}

/// Reads the counts of an earlier process for this spool from the file of this name; `None` if the file is missing or
/// belongs to another spool.
pub(crate) fn read(name: &str, spool: &CountOwner) -> Option<CountedEvents> {
    let file = open_owned_file(name)?;
    let mut bytes = vec![0; OWNER_OFFSET];
    file.read_exact_at(&mut bytes, 0).ok()?;
    let is_ours = match read_owner(&file) {
        Some(owner) => owner.is_same_file(spool),
        // Files of earlier releases do not contain the identity of their spool. But the random name of such a file is
        // stored in its spool only, and `name` was read from this spool.
        None => bytes.starts_with(MAGIC_WITHOUT_OWNER),
    };
    if !is_ours {
        return None;
    }
    let (header_and_runs, sent_batches) = bytes.split_at(SENT_OFFSET);
    let (header, records) = header_and_runs.split_at(RECORD_BYTES);
    let number = |bytes: &[u8], offset: usize| {
        bytes[offset..].first_chunk().map(|bytes| u64::from_be_bytes(*bytes)).unwrap_or_default()
    };
    let time = |bytes: &[u8], offset: usize| WallTime::from_unix_nanos(number(bytes, offset).cast_signed());
    let sent = sent_batches.chunks_exact(SENT_RECORD_BYTES).map(|sent| SentUnspooled {
        process: number(sent, 0),
        number: number(sent, 8),
        batched: number(sent, 16),
        reported_drops: number(sent, 24),
        events: number(sent, 32),
    });
    let sent = sent.filter(|sent| sent.number > 0).collect();
    let mut counted_events =
        CountedEvents { total: number(header, 8), last: time(header, 16), sent, runs: Vec::new() };
    for record in records.chunks_exact(RECORD_BYTES) {
        let (total, last, events) = (number(record, 0), time(record, 8), number(record, 16));
        // A record without events is free.
        if events == 0 {
            continue;
        }
        // The largest total is the newest one (see `CountFile::count`).
        if total >= counted_events.total {
            (counted_events.total, counted_events.last) = (total, last);
        }
        let run = record[NUMBERS_BYTES..].first_chunk().map(|id| RunId::from_bytes(*id))?;
        let name = record[NAME_OFFSET + 1..].get(..record[NAME_OFFSET].into());
        let pipeline = name.and_then(|name| std::str::from_utf8(name).ok()?.parse().ok());
        counted_events.runs.push(CountedRun { run, pipeline, events, last });
    }
    Some(counted_events)
}

/// Removes the file of this name in shared memory.
pub(crate) fn remove(name: &str) {
    let Some(name) = Path::new(name).file_name() else { return };
    match fs::remove_file(Path::new(SHARED_MEMORY).join(name)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::debug!(%error, "cannot remove {SHARED_MEMORY}/{}, in which an earlier process counted its events", name.display());
        }
        _ => {}
    }
}
