//! Bytes in flight to the other end.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

/// Time without progress of the other end after which all sent bytes are treated as arrived or lost.
pub(super) const FLIGHT_TIMEOUT: Span = Span::from_millis(200);

/// Counts the bytes that were sent, and the bytes that are no longer in flight: the other end reported them, or made no
/// progress for [`FLIGHT_TIMEOUT`].
#[derive(Debug)]
pub(super) struct BytesInFlight {
    /// Number of bytes that were sent.
    sent_bytes: u64,
    /// Number of sent bytes that are no longer in flight. At most `sent_bytes`.
    arrived_or_lost: u64,
    /// Datagrams in flight, in the order in which they were sent.
    datagrams: VecDeque<DatagramInFlight>,
    /// Time of the last progress of the other end, or of the first datagram in flight if that is later.
    progress_at: MonoTime,
}

/// A datagram in flight.
#[derive(Clone, Copy, Debug)]
struct DatagramInFlight {
    /// Number of the message, and the offset in it at which the part in this datagram ends.
    end: (u64, u32),
    /// Number of bytes sent so far, including this datagram.
    sent_total: u64,
}

impl BytesInFlight {
    pub(super) const fn new(now: MonoTime) -> Self {
        Self { sent_bytes: 0, arrived_or_lost: 0, datagrams: VecDeque::new(), progress_at: now }
    }

    /// Returns the number of bytes in flight.
    pub(super) const fn bytes(&self) -> u64 {
        self.sent_bytes - self.arrived_or_lost
    }

    /// Returns the number of bytes that were sent.
    pub(super) const fn sent_bytes(&self) -> u64 {
        self.sent_bytes
    }

    /// Returns the number of sent bytes that are no longer in flight.
    pub(super) const fn arrived_or_lost(&self) -> u64 {
        self.arrived_or_lost
    }

    /// Returns the time at which the bytes in flight are treated as arrived or lost.
    pub(super) fn expires_at(&self) -> MonoTime {
        self.progress_at + FLIGHT_TIMEOUT
    }

    /// Notes that a datagram was sent. `end` is the end of its part of a message.
    pub(super) fn record_sent(&mut self, end: (u64, u32), bytes: u32, now: MonoTime) {
        // Silence is only measured while something is in flight.
        if self.bytes() == 0 {
            self.progress_at = now;
        }
        self.sent_bytes += u64::from(bytes);
        self.datagrams.push_back(DatagramInFlight { end, sent_total: self.sent_bytes });
    }

    /// Handles a report of progress. Returns the number of bytes that have arrived or were lost since the last report.
    pub(super) fn record_progress(&mut self, end: (u64, u32), now: MonoTime) -> u64 {
        let arrived_before = self.arrived_or_lost;
        // Reports are cumulative: progress up to `end` includes all datagrams sent before.
        while let Some(datagram) = self.datagrams.pop_front_if(|datagram| datagram.end <= end) {
            self.arrived_or_lost = datagram.sent_total;
        }
        let progress_bytes = self.arrived_or_lost - arrived_before;
        if progress_bytes > 0 {
            self.progress_at = now;
        }
        progress_bytes
    }

    /// Treats the bytes in flight as arrived or lost after a long silence.
    pub(super) fn tick(&mut self, now: MonoTime) {
        if self.bytes() > 0 && now >= self.expires_at() {
            self.arrived_or_lost = self.sent_bytes;
            self.datagrams.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    #[test]
    fn progress_report_removes_all_datagrams_before_it() {
        let mut in_flight = BytesInFlight::new(at(0));
        for end in [(0, 100), (0, 200), (1, 50)] {
            in_flight.record_sent(end, 110, at(0));
        }
        assert_eq!(in_flight.record_progress((0, 99), at(1)), 0);
        assert_eq!(in_flight.record_progress((0, 300), at(2)), 220);
        assert_eq!(in_flight.record_progress((0, 300), at(3)), 0, "a repeated report changes nothing");
        assert_eq!((in_flight.bytes(), in_flight.expires_at()), (110, at(202)));
        assert_eq!(in_flight.record_progress((1, 50), at(4)), 110);
        assert_eq!((in_flight.sent_bytes(), in_flight.arrived_or_lost()), (330, 330));
    }

    #[test]
    fn silence_removes_datagrams_in_flight() {
        let mut in_flight = BytesInFlight::new(at(0));
        in_flight.record_sent((0, 1), 10, at(100));
        in_flight.tick(at(299));
        assert_eq!(in_flight.bytes(), 10);
        in_flight.tick(at(300));
        assert_eq!(in_flight.bytes(), 0);
        assert_eq!(in_flight.record_progress((0, 1), at(301)), 0, "a late report");
    }
}
