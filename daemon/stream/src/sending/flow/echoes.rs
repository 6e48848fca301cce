//! Requests for echoes without an answer yet.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

/// Time after which a missing echo is requested again.
const RETRY_AFTER: Span = Span::from_seconds(2);

/// Maximum number of pending requests.
const MAX_PENDING: usize = 64;

/// A request for an echo.
#[derive(Clone, Copy, Debug)]
pub(super) struct EchoRequest {
    /// Number of bytes that were handed to the connection up to the end of the request. The aggregator sends this
    /// number back.
    pub(super) position: u64,
    /// Time at which the request was sent.
    pub(super) at: MonoTime,
    /// Number of bytes that were in flight before the request.
    pub(super) bytes_ahead: u64,
}

/// Requests that wait for their echo, in the order in which they were sent.
#[derive(Clone, Debug, Default)]
pub(super) struct PendingEchoes {
    requests: VecDeque<EchoRequest>,
    /// Position of the last request.
    last_position: u64,
}

impl PendingEchoes {
    pub(super) fn is_empty(&self) -> bool {
        self.requests.is_empty()
    }

    /// Returns the position of the last request.
    pub(super) const fn last_position(&self) -> u64 {
        self.last_position
    }

    /// Returns the time at which an echo is requested again, if the last request stays without an echo.
    pub(super) fn echo_retry_at(&self) -> Option<MonoTime> {
        self.requests.back().map(|request| request.at + RETRY_AFTER)
    }

    /// Adds a request. The oldest request is dropped if there are too many requests.
    pub(super) fn push(&mut self, request: EchoRequest) {
        if self.requests.len() == MAX_PENDING {
            self.requests.pop_front();
        }
        self.last_position = request.position;
        self.requests.push_back(request);
    }

    /// Removes the requests up to a position. Returns the request at exactly this position, if there is one.
    pub(super) fn answer(&mut self, position: u64) -> Option<EchoRequest> {
        let mut answered = None;
        while let Some(request) = self.requests.pop_front_if(|request| request.position <= position) {
            answered = (request.position == position).then_some(request);
        }
        answered
    }
}
