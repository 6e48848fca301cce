//! Beginning of the current stream.

use crate::StreamId;
use crate::spool::SpoolState;

/// Stream that the batches belong to, and its beginning.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct StreamOrigin {
    pub(in super::super) stream: StreamId,
    /// Stream that the current stream replaced.
    pub(in super::super) previous_stream: Option<StreamId>,
    /// Number of the first batch of the current stream, at least 1.
    pub(in super::super) first: u64,
    /// Number of events in all batches before the first batch; `None` if it is unknown.
    pub(in super::super) events_before_first: Option<u64>,
}

impl StreamOrigin {
    pub(super) fn new(spool: &SpoolState) -> Self {
        let SpoolState { stream, previous_stream, first, events_before_first, .. } = *spool;
        Self { stream, previous_stream, first: first.max(1), events_before_first }
    }

    /// Returns the origin of the stream that replaces this stream from batch `first` on. All batches before `first`
    /// contain `events_before` events.
    pub(super) const fn renewed(&self, stream: StreamId, first: u64, events_before: u64) -> Self {
        Self { stream, previous_stream: Some(self.stream), first, events_before_first: Some(events_before) }
    }
}
