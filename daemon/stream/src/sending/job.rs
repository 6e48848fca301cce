//! Work on the spool that was requested from the owner: one request of each kind at a time, with a pause before a
//! retry.

use peernet_clock::{MonoTime, Span};

/// One kind of work on the spool.
#[derive(Clone, Debug)]
pub(super) struct Job<T> {
    in_progress: Option<T>,
    /// Earliest time of the next attempt after a failure.
    retry_at: Option<MonoTime>,
}

impl<T> Default for Job<T> {
    fn default() -> Self {
        Self { in_progress: None, retry_at: None }
    }
}

impl<T> Job<T> {
    /// Returns whether the work may be requested now.
    pub(super) fn may_start(&mut self, now: MonoTime) -> bool {
        self.retry_at = self.retry_at.filter(|retry_at| now < *retry_at);
        self.retry_at.is_none() && self.in_progress.is_none()
    }

    /// Returns the time of the next attempt after a failure.
    pub(super) const fn retry_at(&self) -> Option<MonoTime> {
        self.retry_at
    }

    pub(super) const fn is_in_progress(&self) -> bool {
        self.in_progress.is_some()
    }

    pub(super) const fn in_progress_mut(&mut self) -> Option<&mut T> {
        self.in_progress.as_mut()
    }

    pub(super) fn start(&mut self, work: T) {
        self.in_progress = Some(work);
    }

    /// Ends the work and returns it; `None` if no work is in progress.
    pub(super) const fn end(&mut self) -> Option<T> {
        self.in_progress.take()
    }

    /// Ends the work as failed.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) {
        self.in_progress = None;
        self.retry_at = Some(now + pause);
    }
}
