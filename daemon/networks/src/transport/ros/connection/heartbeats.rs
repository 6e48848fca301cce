//! Heartbeats of a connection.

use peernet_clock::{MonoTime, Span};

/// Times of the last messages in both directions. An end sends a heartbeat if it has sent nothing else for the
/// interval. A peer that sends nothing for the timeout counts as gone.
#[derive(Debug)]
pub(super) struct Heartbeats {
    interval: Span,
    timeout: Span,
    sent_at: MonoTime,
    received_at: MonoTime,
}

impl Heartbeats {
    pub(super) fn new(interval: Span, timeout: Span, now: MonoTime) -> Self {
        Self { interval, timeout, sent_at: now, received_at: now }
    }

    /// Notes that this end sends a message.
    pub(super) fn note_sent(&mut self, now: MonoTime) {
        self.sent_at = now;
    }

    /// Notes that a message of the peer arrived.
    pub(super) fn note_received(&mut self, now: MonoTime) {
        self.received_at = now;
    }

    /// Returns whether a heartbeat is due.
    pub(super) fn is_due(&self, now: MonoTime) -> bool {
        now - self.sent_at >= self.interval
    }

    /// Returns whether the peer has been silent for too long.
    pub(super) fn is_peer_silent(&self, now: MonoTime) -> bool {
        now - self.received_at >= self.timeout
    }

    /// Returns the time at which a heartbeat is due or the peer has been silent for too long, whichever is earlier.
    pub(super) fn next_timer(&self) -> MonoTime {
        (self.sent_at + self.interval).min(self.received_at + self.timeout)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: i64) -> MonoTime {
        MonoTime::default() + Span::from_seconds(seconds)
    }

    #[test]
    fn next_timer_is_earlier_of_heartbeat_and_timeout() {
        let mut heartbeats = Heartbeats::new(Span::from_seconds(1), Span::from_seconds(5), at(0));
        assert_eq!(heartbeats.next_timer(), at(1));
        assert!(!heartbeats.is_due(at(0)) && heartbeats.is_due(at(1)));
        heartbeats.note_sent(at(4));
        assert!(!heartbeats.is_due(at(4)));
        assert_eq!(heartbeats.next_timer(), at(5));
        assert!(!heartbeats.is_peer_silent(at(4)) && heartbeats.is_peer_silent(at(5)));
        heartbeats.note_received(at(5));
        assert!(!heartbeats.is_peer_silent(at(9)) && heartbeats.is_peer_silent(at(10)));
    }
}
