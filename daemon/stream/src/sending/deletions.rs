//! Deletion of batches from the spool that the aggregator stored.

use peernet_clock::{MonoTime, Span};

use super::job::Job;
use crate::Chain;

/// Number of stored batches that are deleted at once. Deletions are grouped, because each is a write and the medium is
/// often a memory card.
const MOST_WAITING: u64 = 64;
/// Longest time that stored batches wait for their deletion.
const DELETED_AFTER: Span = Span::from_seconds(1);

/// Position up to which the spool is deleted, and the batches that wait for deletion.
#[derive(Clone, Debug)]
pub(super) struct Deletions {
    job: Job<Deleting>,
    /// Number up to which the file contains no batch.
    through: u64,
    /// Bytes in the file of batches that the aggregator stored.
    waiting: u64,
    /// Time since which a batch waits for deletion.
    since: Option<MonoTime>,
}

#[derive(Clone, Copy, Debug)]
struct Deleting {
    through: (u64, Chain),
    bytes: u64,
}

impl Deletions {
    pub(super) fn new(through: u64) -> Self {
        Self { job: Job::default(), through, waiting: 0, since: None }
    }

    /// Returns the number up to which the file contains no batch.
    pub(super) const fn through(&self) -> u64 {
        self.through
    }

    /// Adds bytes in the file whose batches are stored by the aggregator or given up.
    pub(super) fn add(&mut self, bytes: u64, now: MonoTime) {
        self.waiting += bytes;
        self.since.get_or_insert(now);
    }

    /// Adds bytes that were written to the file and whose batches the aggregator stored meanwhile.
    pub(super) const fn add_written(&mut self, bytes: u64) {
        self.waiting += bytes;
    }

    /// Returns whether a deletion may be requested, now or when it is due.
    pub(super) const fn may_begin(&self) -> bool {
        !self.job.is_under_way() && self.job.again().is_none()
    }

    /// Returns whether a deletion may be requested now.
    pub(super) fn is_free(&mut self, now: MonoTime) -> bool {
        self.job.is_free(now)
    }

    /// Returns whether everything up to `through` is to be deleted now, because it has many batches or `many_bytes`, or
    /// waits for long.
    pub(super) fn is_due(&self, through: u64, many_bytes: u64, now: MonoTime) -> bool {
        through - self.through >= MOST_WAITING
            || self.waiting >= many_bytes
            || self.since.is_none_or(|since| now - since >= DELETED_AFTER)
    }

    /// Returns the time at which the waiting batches are due.
    pub(super) fn due_at(&self) -> Option<MonoTime> {
        self.since.map(|since| since + DELETED_AFTER)
    }

    /// Returns the time of the next attempt after a failure.
    pub(super) const fn again(&self) -> Option<MonoTime> {
        self.job.again()
    }

    /// Begins the deletion of everything up to a batch.
    pub(super) fn begin(&mut self, through: (u64, Chain)) {
        let bytes = std::mem::take(&mut self.waiting);
        self.since = None;
        self.job.begin(Deleting { through, bytes });
    }

    /// Ends the deletion successfully. Returns the last batch and the number of bytes; `None` if there is no deletion.
    pub(super) fn end(&mut self) -> Option<((u64, Chain), u64)> {
        let Deleting { through, bytes } = self.job.end()?;
        self.through = through.0;
        Some((through, bytes))
    }

    /// Ends the deletion as failed; `None` if no deletion is in progress.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        let Deleting { bytes, .. } = self.job.end()?;
        self.add(bytes, now);
        self.job.fail(now, pause);
        Some(())
    }
}
