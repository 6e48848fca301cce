//! Deleting from the spool what is stored over there.

use peernet_clock::{MonoTime, Span};

use super::job::Job;
use crate::Chain;

/// Batches that are stored over there are deleted together, when there are so many or after so long: a deletion is
/// a write, and the medium is often a memory card.
const MOST_WAITING: u64 = 64;
const DELETED_AFTER: Span = Span::from_seconds(1);

/// How far the spool is deleted, and what waits for it.
#[derive(Clone, Debug)]
pub(super) struct Deletions {
    job: Job<Deleting>,
    /// Up to and including this number nothing is in the file.
    through: u64,
    /// Bytes in the file of what is stored over there.
    waiting: u64,
    /// Since when something waits.
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

    /// Up to and including this number nothing is in the file.
    pub(super) const fn through(&self) -> u64 {
        self.through
    }

    /// Bytes in the file are stored over there, or given up.
    pub(super) fn add(&mut self, bytes: u64, now: MonoTime) {
        self.waiting += bytes;
        self.since.get_or_insert(now);
    }

    /// Bytes came into the file that were stored over there while they were written.
    pub(super) const fn add_written(&mut self, bytes: u64) {
        self.waiting += bytes;
    }

    /// Whether a deletion may be asked for, now or when it is due.
    pub(super) const fn may_begin(&self) -> bool {
        !self.job.is_under_way() && self.job.again().is_none()
    }

    /// Whether a deletion may be asked for now.
    pub(super) fn is_free(&mut self, now: MonoTime) -> bool {
        self.job.is_free(now)
    }

    /// Whether everything up to `through` is to be deleted now, because it is much or waits for long; from `many_bytes` on it
    /// is much.
    pub(super) fn is_due(&self, through: u64, many_bytes: u64, now: MonoTime) -> bool {
        through - self.through >= MOST_WAITING
            || self.waiting >= many_bytes
            || self.since.is_none_or(|since| now - since >= DELETED_AFTER)
    }

    /// When what waits has waited for long enough.
    pub(super) fn due_at(&self) -> Option<MonoTime> {
        self.since.map(|since| since + DELETED_AFTER)
    }

    /// When it may be tried again after a failure.
    pub(super) const fn again(&self) -> Option<MonoTime> {
        self.job.again()
    }

    /// Everything up to this batch is to be deleted now.
    pub(super) fn begin(&mut self, through: (u64, Chain)) {
        let bytes = std::mem::take(&mut self.waiting);
        self.since = None;
        self.job.begin(Deleting { through, bytes });
    }

    /// It is deleted: returns the last batch and how many bytes; `None` when nothing was to be.
    pub(super) fn end(&mut self) -> Option<((u64, Chain), u64)> {
        let Deleting { through, bytes } = self.job.end()?;
        self.through = through.0;
        Some((through, bytes))
    }

    /// It is not; `None` when nothing was to be.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        let Deleting { bytes, .. } = self.job.end()?;
        self.add(bytes, now);
        self.job.fail(now, pause);
        Some(())
    }
}
