//! Deadlines of a connection, without I/O.

use tokio::time::Instant;

use super::connection::Phase;
use super::limits::{HANDSHAKE_TIMEOUT, ListenerLimits};
use super::rejections::Rejection;

/// The deadlines of one connection: of its phase, and of its silence.
pub(super) struct Deadlines {
    limits: ListenerLimits,
    phase: Phase,
    phase_started_at: Instant,
    /// `true` if bytes arrived since the last [`due_action`](Self::due_action).
    pub(super) has_received: bool,
    last_received_at: Instant,
}

/// Action that a deadline demands.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum DueAction {
    Nothing,
    /// Send a heartbeat, because the peer is silent.
    Ping,
    /// End the connection, for this reason.
    End(Rejection, String),
}

impl Deadlines {
    pub(super) fn new(limits: &ListenerLimits, now: Instant) -> Self {
        let limits = limits.clone();
        Self {
            limits,
            phase: Phase::Handshake,
            phase_started_at: now,
            has_received: false,
            last_received_at: now,
        }
    }

    /// Returns the phase whose deadline is watched.
    pub(super) const fn phase(&self) -> Phase {
        self.phase
    }

    /// Starts the deadline of a new phase.
    pub(super) const fn enter(&mut self, phase: Phase, now: Instant) {
        (self.phase, self.phase_started_at) = (phase, now);
    }

    /// Returns the action that is due now.
    pub(super) fn due_action(&mut self, now: Instant) -> DueAction {
        if std::mem::take(&mut self.has_received) {
            self.last_received_at = now;
        }
        let phase_duration = now - self.phase_started_at;
        if self.phase == Phase::Handshake {
            // No PING is sent here: heartbeats are allowed only after the handshake (RFC 37 of ZeroMQ).
            if phase_duration < HANDSHAKE_TIMEOUT {
                return DueAction::Nothing;
            }
            return DueAction::End(Rejection::Handshake, "no ZMTP handshake in time".into());
        }
        if self.phase == Phase::Unadmitted && phase_duration >= self.limits.hello_timeout {
            let text = format!("no hello was accepted within {} ms", self.limits.hello_timeout.as_millis());
            return DueAction::End(Rejection::NoHello, text);
        }
        let silence = now - self.last_received_at;
        if silence >= self.limits.heartbeat_timeout {
            let text = format!("the peer sent nothing for {} ms", silence.as_millis());
            return DueAction::End(Rejection::Silent, text);
        }
        if silence >= self.limits.heartbeat_interval { DueAction::Ping } else { DueAction::Nothing }
    }

    /// Returns the time of the next check.
    pub(super) fn next_check(&self, now: Instant) -> Instant {
        let heartbeat = now + self.limits.heartbeat_interval;
        match self.phase {
            Phase::Handshake => self.phase_started_at + HANDSHAKE_TIMEOUT,
            Phase::Unadmitted => heartbeat.min(self.phase_started_at + self.limits.hello_timeout),
            _ => heartbeat,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn limits() -> ListenerLimits {
        ListenerLimits {
            max_connections: 1,
            max_message_bytes: 1,
            max_unfinished_bytes: 1,
            hello_timeout: Duration::from_secs(5),
            max_queued_messages: 1,
            max_queued_bytes: 1,
            heartbeat_interval: Duration::from_secs(1),
            heartbeat_timeout: Duration::from_secs(10),
        }
    }

    #[test]
    fn each_phase_ends_after_its_own_time() {
        let start = Instant::now();
        let after = |seconds| start + Duration::from_secs(seconds);
        let mut deadlines = Deadlines::new(&limits(), start);
        // `HANDSHAKE_TIMEOUT` is 2 s.
        assert_eq!(
            (deadlines.due_action(after(1)), deadlines.next_check(after(1))),
            (DueAction::Nothing, after(2))
        );
        assert!(matches!(deadlines.due_action(after(2)), DueAction::End(Rejection::Handshake, _)));
        deadlines.enter(Phase::Unadmitted, after(1));
        assert_eq!(
            (deadlines.due_action(after(5)), deadlines.next_check(after(5))),
            (DueAction::Ping, after(6))
        );
        assert!(matches!(deadlines.due_action(after(6)), DueAction::End(Rejection::NoHello, _)));
    }

    #[test]
    fn only_silence_ends_admitted_connection() {
        let start = Instant::now();
        let after = |seconds| start + Duration::from_secs(seconds);
        let mut deadlines = Deadlines::new(&limits(), start);
        deadlines.enter(Phase::Admitted, start);
        deadlines.has_received = true;
        assert_eq!(deadlines.due_action(after(100)), DueAction::Nothing);
        assert_eq!(deadlines.due_action(after(101)), DueAction::Ping);
        assert!(matches!(deadlines.due_action(after(110)), DueAction::End(Rejection::Silent, _)));
    }
}
