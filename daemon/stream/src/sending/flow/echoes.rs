//! Echoes that were requested and did not come yet.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

/// An echo that did not come for so long is requested again.
const REMIND: Span = Span::from_seconds(2);

/// Number of echoes that are waited for at most.
const MOST_PENDING: usize = 64;

/// An echo that was requested.
#[derive(Clone, Copy, Debug)]
pub(super) struct EchoRequest {
    /// Position of the request in the connection; the aggregator sends it back.
    pub(super) bytes: u64,
    /// When it was sent.
    pub(super) at: MonoTime,
    /// Bytes that were on the way before it.
    pub(super) ahead: u64,
}

/// Requests that wait for their echo, in the order in which they were sent.
#[derive(Clone, Debug, Default)]
pub(super) struct PendingEchoes {
    requests: VecDeque<EchoRequest>,
    /// Position of the last request.
    last: u64,
}

impl PendingEchoes {
    pub(super) fn is_empty(&self) -> bool {
        self.requests.is_empty()
    }

    /// Position of the last request.
    pub(super) const fn last(&self) -> u64 {
        self.last
    }

    /// When the last echo is to be requested again.
    pub(super) fn remind_at(&self) -> Option<MonoTime> {
        self.requests.back().map(|request| request.at + REMIND)
    }

    /// Adds a request; the oldest is forgotten where there are too many.
    pub(super) fn push(&mut self, request: EchoRequest) {
        if self.requests.len() == MOST_PENDING {
            self.requests.pop_front();
        }
        self.last = request.bytes;
        self.requests.push_back(request);
    }

    /// Removes the requests up to a position; returns the one of exactly this position.
    pub(super) fn answer(&mut self, bytes: u64) -> Option<EchoRequest> {
        let mut found = None;
        while let Some(request) = self.requests.pop_front_if(|request| request.bytes <= bytes) {
            found = (request.bytes == bytes).then_some(request);
        }
        found
    }
}
