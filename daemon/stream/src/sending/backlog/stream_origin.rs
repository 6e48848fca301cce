//! Where the stream at hand begins.

use crate::StreamId;
use crate::spool::SpoolState;

/// The stream that the batches' numbers belong to, and where it begins.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct StreamOrigin {
    pub(in super::super) stream: StreamId,
    /// The stream that it replaced.
    pub(in super::super) previous: Option<StreamId>,
    /// Number of its first batch, at least 1.
    pub(in super::super) first: u64,
    /// Events in all batches before the first; `None` when it is not known.
    pub(in super::super) events_before_first: Option<u64>,
}

impl StreamOrigin {
    pub(super) fn new(spool: &SpoolState) -> Self {
        let SpoolState { stream, previous, first, events_before_first, .. } = *spool;
        Self { stream, previous, first: first.max(1), events_before_first }
    }

    /// The origin of the stream that replaces this one with batch `first`, which follows `events_before` events.
    pub(super) const fn renewed(&self, stream: StreamId, first: u64, events_before: u64) -> Self {
        Self { stream, previous: Some(self.stream), first, events_before_first: Some(events_before) }
    }
}
