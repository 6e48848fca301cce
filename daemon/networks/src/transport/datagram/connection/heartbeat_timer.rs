//! Timers of heartbeats, and of the timeout after which a silent connection ends.

use peernet_clock::{MonoTime, Span};

/// Time from a message to the ping whose answer says whether the message has arrived.
const PING_DELAY: Span = Span::from_millis(50);

/// Longest interval between pings while messages are sent continuously. The answers carry statistics.
const PING_INTERVAL: Span = Span::from_seconds(1);

/// Heartbeat timers of a connection.
#[derive(Debug)]
pub(super) struct HeartbeatTimer {
    interval: Span,
    timeout: Span,
    /// Time at which the last packet of the other end arrived.
    received_at: MonoTime,
    /// Time at which the other end was last asked for a heartbeat.
    pinged_at: MonoTime,
}

impl HeartbeatTimer {
    pub(super) const fn new(interval: Span, timeout: Span, now: MonoTime) -> Self {
        Self { interval, timeout, received_at: now, pinged_at: now }
    }

    /// Returns the longest allowed silence of the other end.
    pub(super) const fn timeout(&self) -> Span {
        self.timeout
    }

    /// Notes that a packet arrived.
    pub(super) fn record_arrival(&mut self, now: MonoTime) {
        self.received_at = now;
    }

    /// Notes that the other end is asked for a heartbeat.
    pub(super) fn record_ping(&mut self, now: MonoTime) {
        self.pinged_at = now;
    }

    /// Returns the time of the next ping.
    ///
    /// `sent_at` is the time at which the last part of a message was sent, if messages are not settled. The ping is
    /// then sent sooner, because its answer says which messages never arrived.
    pub(super) fn ping_at(&self, sent_at: Option<MonoTime>) -> MonoTime {
        let idle_ping_at = self.received_at.max(self.pinged_at) + self.interval;
        let after_message =
            sent_at.map(|sent| (sent.max(self.pinged_at) + PING_DELAY).min(self.pinged_at + PING_INTERVAL));
        after_message.map_or(idle_ping_at, |time| idle_ping_at.min(time))
    }

    /// Returns the time at which the other end counts as gone if nothing arrives until then.
    pub(super) fn expires_at(&self) -> MonoTime {
        self.received_at + self.timeout
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heartbeat_is_due_when_idle_and_after_messages() {
        let time_at = |millis| MonoTime::default() + Span::from_millis(millis);
        let mut heartbeat = HeartbeatTimer::new(Span::from_seconds(2), Span::from_seconds(5), time_at(0));
        assert_eq!((heartbeat.ping_at(None), heartbeat.expires_at()), (time_at(2_000), time_at(5_000)));
        heartbeat.record_arrival(time_at(500));
        assert_eq!((heartbeat.ping_at(None), heartbeat.expires_at()), (time_at(2_500), time_at(5_500)));
        assert_eq!(
            heartbeat.ping_at(Some(time_at(600))),
            time_at(650),
            "a ping follows soon after the last message"
        );
        assert_eq!(
            heartbeat.ping_at(Some(time_at(990))),
            time_at(1_000),
            "a ping is sent once a second while messages follow each other"
        );
        heartbeat.record_ping(time_at(1_000));
        assert_eq!(heartbeat.ping_at(Some(time_at(990))), time_at(1_050));
        assert_eq!(heartbeat.ping_at(None), time_at(3_000));
    }
}
