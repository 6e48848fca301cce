//! Work that was asked of the owner: one at a time of each kind, tried again after a pause.

use peernet_clock::{MonoTime, Span};

/// One kind of work on the spool.
#[derive(Clone, Debug)]
pub(super) struct Job<T> {
    under_way: Option<T>,
    /// Not before, because it failed.
    again: Option<MonoTime>,
}

impl<T> Default for Job<T> {
    fn default() -> Self {
        Self { under_way: None, again: None }
    }
}

impl<T> Job<T> {
    /// Whether it may be asked for now.
    pub(super) fn is_free(&mut self, now: MonoTime) -> bool {
        self.again = self.again.filter(|again| now < *again);
        self.again.is_none() && self.under_way.is_none()
    }

    /// When it may be asked for after a failure.
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

    /// It is done; `None` when it was not asked for.
    pub(super) const fn end(&mut self) -> Option<T> {
        self.under_way.take()
    }

    /// It failed.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) {
        self.under_way = None;
        self.again = Some(now + pause);
    }
}
