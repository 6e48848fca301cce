//! Work that was requested from the owner: one item of each kind at a time, tried again after a pause.

use peernet_clock::{MonoTime, Span};

/// One kind of work on the spool.
#[derive(Clone, Debug)]
pub(super) struct Job<T> {
    under_way: Option<T>,
    /// Earliest time of the next attempt after a failure.
    again: Option<MonoTime>,
}

impl<T> Default for Job<T> {
    fn default() -> Self {
        Self { under_way: None, again: None }
    }
}

impl<T> Job<T> {
    /// Returns whether the work may be requested now.
    pub(super) fn is_free(&mut self, now: MonoTime) -> bool {
        self.again = self.again.filter(|again| now < *again);
        self.again.is_none() && self.under_way.is_none()
    }

    /// Returns the time of the next attempt after a failure.
    pub(super) const fn again(&self) -> Option<MonoTime> {
        self.again
    }

    pub(super) const fn is_under_way(&self) -> bool {
        self.under_way.is_some()
    }

    pub(super) const fn under_way(&mut self) -> Option<&mut T> {
        self.under_way.as_mut()
    }

    pub(super) fn begin(&mut self, work: T) {
        self.under_way = Some(work);
    }

    /// Ends the work successfully; `None` if none was requested.
    pub(super) const fn end(&mut self) -> Option<T> {
        self.under_way.take()
    }

    /// Ends the work as failed.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) {
        self.under_way = None;
        self.again = Some(now + pause);
    }
}
