//! Count of the events, in a file that survives the death of the process.
//!
//! Between the moment at which an event is queued and the commit of its batch to the spool, only this process knows
//! of it: the contents of the queue and the batch being built. Therefore each event is counted first, by run, in a
//! file in shared memory. The spool stores with each batch how many counted events it accounts for. The next process
//! compares both, and reports the difference as a gap (`outbox/spool/tail.rs`).
//!
//! The file is in `/dev/shm` and not beside the spool, because a write to a disk, mapped or not, sometimes waits for
//! that disk, which would disturb the measurements. It contains the identity of its spool, and the process that
//! counts holds a lock on it: so a copy of the spool does not use it, and a file whose spool is gone is recognised.
//! It is written and not mapped, so that a failed write is an error and does not end the process. After a restart of
//! the machine the file is gone, and no gap is reported.
//!
//! Batches that were sent while the spool could not be written are recorded as well. Only the aggregator knows which
//! of them it stored, so that the next process asks it before it reports a loss (`peernet_stream`, `unresolved.rs`).

mod abandoned;
mod owner;
#[cfg(test)]
mod tests;

pub(crate) use self::abandoned::remove_abandoned;
pub(crate) use self::owner::CountOwner;

use std::collections::BTreeMap;
use std::fs::{self, File};
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
/// First bytes of a file of an earlier version, which names no spool.
const MAGIC_WITHOUT_OWNER: &[u8; 8] = b"PNcount2";
/// Length of the head in bytes, and of the record of each run after it. No record crosses the border of a page.
const RECORD: usize = 128;
const HEAD_ALL: u64 = 8;
/// Layout of a record: number of all events, time of the last one, number of the run's events, run id, length of the
/// pipeline's name, and the name.
const NUMBERS: usize = 24;
const NAME: usize = NUMBERS + 16;
/// Offset of the slots of batches that were sent without being in the spool; the slot is selected by the batch's
/// number. Each has five numbers: the process, the number of the batch, and three counts up to it.
const SENT: usize = RECORD * (1 + MAX_COUNTED_RUNS);
const SENT_BYTES: usize = 40;
/// Offset of the identity of the spool that the counts belong to.
const OWNER: usize = SENT + SENT_BYTES * MAX_SENT_UNSPOOLED;
const FILE_BYTES: usize = OWNER + OWNER_BYTES;

/// Counter of queued events. Clones share it; without a file nothing is counted.
#[derive(Clone, Debug, Default)]
pub(crate) struct EventCounter(Option<Arc<Mutex<CountFile>>>);

/// An open file of counts, and the counts in it.
#[derive(Debug)]
struct CountFile {
    file: File,
    name: String,
    total: u64,
    /// Index of the record and number of events of each run in progress.
    runs: BTreeMap<RunId, (usize, u64)>,
    free: Vec<usize>,
    sent: Option<SentUnspooled>,
    failed: bool,
}

impl EventCounter {
    /// Creates a file in shared memory for a spool.
    ///
    /// # Errors
    /// When there is no shared memory.
    pub(crate) fn create(owner: &CountOwner) -> io::Result<Self> {
        let folder = Path::new(SHARED_MEMORY);
        if statfs(folder)?.f_type != TMPFS_MAGIC {
            return Err(io::Error::other(format!("{SHARED_MEMORY} is not in memory")));
        }
        let name = format!("peernet-{}.count", Uuid::new_v4());
        let file = create_file(&name)?;
        // Written in full now, so that later writes need no more memory and cannot fail for lack of it.
        let mut bytes = vec![0; FILE_BYTES];
        bytes[..MAGIC.len()].copy_from_slice(MAGIC);
        let owner = owner.encoded();
        bytes[OWNER..OWNER + owner.len()].copy_from_slice(&owner);
        file.write_all_at(&bytes, 0)?;
        let free = (1..=MAX_COUNTED_RUNS).rev().collect();
        let counting =
            CountFile { file, name, total: 0, runs: BTreeMap::new(), free, sent: None, failed: false };
        Ok(Self(Some(Arc::new(Mutex::new(counting)))))
    }

    /// Returns the name of the file, by which the next process finds it.
    pub(crate) fn name(&self) -> Option<String> {
        self.counting().map(|counting| counting.name.clone())
    }

    /// Counts an event that is about to be queued.
    pub(crate) fn count(&self, pipeline: Option<&Slug>, run: Option<RunId>, now: WallTime) {
        if let Some(mut counting) = self.counting() {
            let written = counting.count(pipeline, run, now);
            counting.check(written);
        }
    }

    /// Records a batch that is about to be sent and is not in the spool.
    pub(crate) fn record_sent_unspooled(&self, sent: SentUnspooled) {
        if let Some(mut counting) = self.counting().filter(|counting| counting.sent != Some(sent)) {
            counting.sent = Some(sent);
            let SentUnspooled { process, number, batched, reported_drops, events } = sent;
            let bytes = [process, number, batched, reported_drops, events].map(u64::to_be_bytes).concat();
            // A ring: a batch overwrites the one that is as many numbers older.
            let place = SENT as u64 + number % MAX_SENT_UNSPOOLED as u64 * SENT_BYTES as u64;
            let written = counting.file.write_all_at(&bytes, place);
            counting.check(written);
        }
    }

    /// Frees the record of an ended run if the spool accounts for all of its events, which are `events`. Returns
    /// whether the record is free.
    pub(crate) fn release(&self, run: RunId, events: u64) -> bool {
        let Some(mut counting) = self.counting() else { return true };
        let Some((place, counted)) = counting.runs.get(&run).copied() else { return true };
        if counted == events {
            let written = counting.release(run, place);
            counting.check(written);
        }
        counted == events
    }

    /// Creates the file again, with the same counts, if it was deleted.
    pub(crate) fn recreate_if_deleted(&self) {
        if let Some(mut counting) = self.counting() {
            let written = counting.recreate_if_deleted();
            counting.check(written);
        }
    }

    /// Returns the number of all events; `None` if they are not counted.
    pub(crate) fn total(&self) -> Option<u64> {
        self.counting().map(|counting| counting.total)
    }

    /// Removes the file, once no counted event can be lost any more.
    pub(crate) fn remove(&self) {
        if let Some(name) = self.name() {
            remove(&name);
        }
    }

    fn counting(&self) -> Option<MutexGuard<'_, CountFile>> {
        self.0.as_ref().map(|counting| counting.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl CountFile {
    fn count(&mut self, pipeline: Option<&Slug>, run: Option<RunId>, now: WallTime) -> io::Result<()> {
        self.total += 1;
        let numbers = [self.total.to_be_bytes(), now.unix_nanos().to_be_bytes()].concat();
        // Each event is a single write, so the total is in the record of its run. The largest total of all records is
        // the current one.
        let Some(run) = run else { return self.file.write_all_at(&numbers, HEAD_ALL) };
        if let Some((place, events)) = self.runs.get_mut(&run) {
            *events += 1;
            let numbers = [&numbers[..], &events.to_be_bytes()].concat();
            return self.file.write_all_at(&numbers, (*place * RECORD) as u64);
        }
        let Some(place) = self.free.pop() else { return self.file.write_all_at(&numbers, HEAD_ALL) };
        self.runs.insert(run, (place, 1));
        let name = pipeline.map_or("", Slug::as_str).as_bytes();
        let length = u8::try_from(name.len()).unwrap_or_default();
        let record = [&numbers[..], &1_u64.to_be_bytes(), run.as_bytes(), &[length], name].concat();
        self.file.write_all_at(&record, (place * RECORD) as u64)
    }

    fn release(&mut self, run: RunId, place: usize) -> io::Result<()> {
        // The total first, because the record may hold the newest one.
        self.file.write_all_at(&self.total.to_be_bytes(), HEAD_ALL)?;
        self.file.write_all_at(&[0; RECORD], (place * RECORD) as u64)?;
        self.runs.remove(&run);
        self.free.push(place);
        Ok(())
    }

    fn recreate_if_deleted(&mut self) -> io::Result<()> {
        if self.failed || self.file.metadata()?.nlink() > 0 {
            return Ok(());
        }
        let mut bytes = vec![0; FILE_BYTES];
        // The open file keeps its content, although its name is gone.
        self.file.read_exact_at(&mut bytes, 0)?;
        let file = create_file(&self.name)?;
        file.write_all_at(&bytes, 0)?;
        self.file = file;
        tracing::warn!(
            "{SHARED_MEMORY}/{} was deleted while the agent counted its events there, and is made again",
            self.name
        );
        Ok(())
    }

    /// Logs the first failed write.
    fn check(&mut self, written: io::Result<()>) {
        if let Err(error) = written
            && !std::mem::replace(&mut self.failed, true)
        {
            tracing::warn!(
                %error,
                "cannot count events in {SHARED_MEMORY}/{}: if the agent is killed, fewer are reported as lost than are",
                self.name
            );
        }
    }
}

/// Creates an empty file and locks it before anything is written, because a complete file without a lock belongs to a
/// process that has ended.
fn create_file(name: &str) -> io::Result<File> {
    let path = Path::new(SHARED_MEMORY).join(name);
    let file = File::options().read(true).write(true).create_new(true).mode(0o600).open(path)?;
    file.lock()?;
    Ok(file)
}

/// Opens the file of this name in shared memory, if it belongs to this user.
fn open_own(name: &str) -> Option<File> {
    // Opening must not block if another user created a FIFO of this name.
    let flags = i32::try_from((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits()).ok()?;
    let path = Path::new(SHARED_MEMORY).join(Path::new(name).file_name()?);
    let file = File::options().read(true).custom_flags(flags).open(path).ok()?;
    let metadata = file.metadata().ok()?;
    (metadata.is_file() && metadata.uid() == rustix::process::geteuid().as_raw()).then_some(file)
}

/// Reads the identity of the spool from a file of counts; `None` for any other file, and for one of an earlier
/// version.
fn read_owner(file: &File) -> Option<CountOwner> {
    let (mut magic, mut owner) = ([0; MAGIC.len()], [0; OWNER_BYTES]);
    file.read_exact_at(&mut magic, 0).ok()?;
    if magic != *MAGIC {
        return None;
    }
    file.read_exact_at(&mut owner, OWNER as u64).ok()?;
    CountOwner::decoded(&owner)
}

/// Returns whether the file of this name belongs to another spool.
pub(crate) fn belongs_to_another_spool(name: &str, own: &CountOwner) -> bool {
    open_own(name).and_then(|file| read_owner(&file)).is_some_and(|owner| !owner.is_same_file(own))
}

/// Reads the counts of an earlier process for this spool from the file of this name; `None` if the file is missing or
/// belongs to another spool.
pub(crate) fn read(name: &str, own: &CountOwner) -> Option<CountedEvents> {
    let file = open_own(name)?;
    let mut bytes = vec![0; OWNER];
    file.read_exact_at(&mut bytes, 0).ok()?;
    let is_ours = match read_owner(&file) {
        Some(owner) => owner.is_same_file(own),
        // Files of earlier releases do not name their spool. Only the spool knows their random name.
        None => bytes.starts_with(MAGIC_WITHOUT_OWNER),
    };
    if !is_ours {
        return None;
    }
    let (runs, sent) = bytes.split_at(SENT);
    let (head, records) = runs.split_at(RECORD);
    let number = |bytes: &[u8], at: usize| {
        bytes[at..].first_chunk().map(|bytes| u64::from_be_bytes(*bytes)).unwrap_or_default()
    };
    let time = |bytes: &[u8], at: usize| WallTime::from_unix_nanos(number(bytes, at).cast_signed());
    let sent = sent.chunks_exact(SENT_BYTES).map(|sent| SentUnspooled {
        process: number(sent, 0),
        number: number(sent, 8),
        batched: number(sent, 16),
        reported_drops: number(sent, 24),
        events: number(sent, 32),
    });
    let sent = sent.filter(|sent| sent.number > 0).collect();
    let mut counted = CountedEvents { total: number(head, 8), last: time(head, 16), sent, runs: Vec::new() };
    for record in records.chunks_exact(RECORD) {
        let (all, last, events) = (number(record, 0), time(record, 8), number(record, 16));
        // A record without events is free.
        if events == 0 {
            continue;
        }
        // The largest total is the newest one, see `count`.
        if all >= counted.total {
            (counted.total, counted.last) = (all, last);
        }
        let run = record[NUMBERS..].first_chunk().map(|id| RunId::from_bytes(*id))?;
        let name = record[NAME + 1..].get(..record[NAME].into());
        let pipeline = name.and_then(|name| std::str::from_utf8(name).ok()?.parse().ok());
        counted.runs.push(CountedRun { run, pipeline, events, last });
    }
    Some(counted)
}

/// Removes the file of this name in shared memory.
pub(crate) fn remove(name: &str) {
    let Some(name) = Path::new(name).file_name() else { return };
    match fs::remove_file(Path::new(SHARED_MEMORY).join(name)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::debug!(%error, "the count of events of an earlier process stays in {SHARED_MEMORY}");
        }
        _ => {}
    }
}
