//! Deletion of stored batches from the spool.

use peernet_clock::{MonoTime, Span};

use super::job::Job;
use crate::ChainHash;

/// Number of stored batches at which a deletion starts. Deletions are grouped, because each deletion is a write and the
/// medium is often a memory card.
const MAX_WAITING_BATCHES: u64 = 64;
/// Longest time that stored batches wait for their deletion.
const MAX_WAIT: Span = Span::from_seconds(1);

/// Deletion of batches from the spool: the number up to which batches are deleted, and the batches that wait for
/// deletion.
#[derive(Clone, Debug)]
pub(super) struct Deletions {
    job: Job<RunningDeletion>,
    /// Number up to which the file contains no batch.
    through: u64,
    /// Bytes of stored batches that are still in the file.
    waiting_bytes: u64,
    /// Time since which a batch waits for deletion.
    waiting_since: Option<MonoTime>,
}

#[derive(Clone, Copy, Debug)]
struct RunningDeletion {
    through: (u64, ChainHash),
    bytes: u64,
}

impl Deletions {
    pub(super) fn new(through: u64) -> Self {
        Self { job: Job::default(), through, waiting_bytes: 0, waiting_since: None }
    }

    /// Returns the number up to which the file contains no batch.
    pub(super) const fn through(&self) -> u64 {
        self.through
    }

    /// Adds bytes of batches in the file that the aggregator stored or that the agent skips.
    pub(super) fn add(&mut self, bytes: u64, now: MonoTime) {
        self.waiting_bytes += bytes;
        self.waiting_since.get_or_insert(now);
    }

    /// Adds bytes that were written to the file and whose batches the aggregator stored meanwhile. The wait of these
    /// batches began when they were acknowledged ([`add`](Self::add)).
    pub(super) const fn add_written(&mut self, bytes: u64) {
        self.waiting_bytes += bytes;
    }

    /// Returns whether a deletion may be requested, now or when it is due.
    pub(super) const fn may_be_scheduled(&self) -> bool {
        !self.job.is_in_progress() && self.job.retry_at().is_none()
    }

    /// Returns whether a deletion may be requested now.
    pub(super) fn may_start(&mut self, now: MonoTime) -> bool {
        self.job.may_start(now)
    }

    /// Returns whether the batches up to `through` are to be deleted now: because there are many of them, because they
    /// have at least `max_waiting_bytes` bytes, or because they have waited for long or for an unknown time.
    pub(super) fn is_due(&self, through: u64, max_waiting_bytes: u64, now: MonoTime) -> bool {
        through - self.through >= MAX_WAITING_BATCHES
            || self.waiting_bytes >= max_waiting_bytes
            || self.waiting_since.is_none_or(|waiting_since| now - waiting_since >= MAX_WAIT)
    }

    /// Returns the time at which the waiting batches are due.
    pub(super) fn due_at(&self) -> Option<MonoTime> {
        self.waiting_since.map(|waiting_since| waiting_since + MAX_WAIT)
    }

    /// Returns the time of the next attempt after a failure.
    pub(super) const fn retry_at(&self) -> Option<MonoTime> {
        self.job.retry_at()
    }

    /// Begins the deletion of all batches up to a batch.
    pub(super) fn start(&mut self, through: (u64, ChainHash)) {
        let bytes = std::mem::take(&mut self.waiting_bytes);
        self.waiting_since = None;
        self.job.start(RunningDeletion { through, bytes });
    }

    /// Ends the deletion successfully. Returns the last batch and the number of deleted bytes; `None` if no deletion is
    /// in progress.
    pub(super) fn finish(&mut self) -> Option<((u64, ChainHash), u64)> {
        let RunningDeletion { through, bytes } = self.job.end()?;
        self.through = through.0;
        Some((through, bytes))
    }

    /// Ends the deletion as failed; `None` if no deletion is in progress.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        let RunningDeletion { bytes, .. } = self.job.end()?;
        self.add(bytes, now);
        self.job.fail(now, pause);
        Some(())
    }
}
