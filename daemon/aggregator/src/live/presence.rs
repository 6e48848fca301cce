//! The presence of a host, and the time of its last message.

use peernet_clock::{MonoTime, Span, Stamp, WallTime};

/// Silence after which a host counts as disconnected. Agents send four messages a second, so a few may be lost or late.
const SILENCE_TIMEOUT: Span = Span::from_seconds(3);

/// State of a host's presence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// The host has a session and sends updates.
    Connected,
    /// The host became silent without a goodbye.
    Silent,
    /// The host said goodbye.
    Left,
}

/// The latest process of a host, its state, and the time of its last message.
#[derive(Clone, Copy, Debug)]
pub(super) struct Presence {
    state: State,
    /// The number that the host's process drew at its start.
    process: u64,
    /// Time of the last message.
    last_seen: Stamp,
    update: Option<Update>,
}

/// The latest update of a host.
#[derive(Clone, Copy, Debug)]
struct Update {
    /// The process that sent the update.
    process: u64,
    /// The host's clock when the update was sent.
    sent: WallTime,
    /// The aggregator's clock when the update was received.
    received: WallTime,
}

impl Presence {
    /// Creates the state at a process's hello.
    pub(super) const fn new(process: u64, now: Stamp) -> Self {
        Self { state: State::Connected, process, last_seen: now, update: None }
    }

    /// Returns whether the host is connected.
    pub(super) fn is_connected(&self) -> bool {
        self.state == State::Connected
    }

    /// Returns whether the host has said goodbye.
    pub(super) fn has_left(&self) -> bool {
        self.state == State::Left
    }

    /// Returns the time of the host's last message.
    pub(super) const fn last_seen(&self) -> Stamp {
        self.last_seen
    }

    /// Returns the host's clock at its latest update.
    pub(super) fn sent(&self) -> Option<WallTime> {
        self.update.map(|update| update.sent)
    }

    /// Returns the host's clock at the latest update of the current process.
    pub(super) fn sent_by_current_process(&self) -> Option<WallTime> {
        self.update.filter(|update| update.process == self.process).map(|update| update.sent)
    }

    /// Returns the host's clock minus the aggregator's at the latest update.
    pub(super) fn clock_ahead(&self) -> Span {
        self.update.map_or(Span::ZERO, |update| update.sent - update.received)
    }

    /// Records a process's hello. Returns whether the process is the same as before.
    pub(super) fn introduce(&mut self, process: u64, now: Stamp) -> bool {
        self.last_seen = now;
        let is_same_process = std::mem::replace(&mut self.process, process) == process;
        // A new process counts as connected from its first update on. Until then the live state shows values of the
        // previous process.
        if is_same_process {
            self.state = State::Connected;
        }
        is_same_process
    }

    /// Records an update.
    pub(super) const fn update(&mut self, sent: WallTime, now: Stamp) {
        (self.state, self.last_seen) = (State::Connected, now);
        self.update = Some(Update { process: self.process, sent, received: now.wall });
    }

    /// Records a goodbye.
    pub(super) const fn mark_left(&mut self) {
        self.state = State::Left;
    }

    /// Records that the host became silent, unless it has said goodbye.
    pub(super) fn mark_silent(&mut self) {
        if self.is_connected() {
            self.state = State::Silent;
        }
    }

    /// Returns whether the host counts as connected and has been silent for too long.
    pub(super) fn is_overdue(&self, now: MonoTime) -> bool {
        self.is_connected() && now - self.last_seen.mono > SILENCE_TIMEOUT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamp(seconds: i64) -> Stamp {
        Stamp::default() + Span::from_seconds(seconds)
    }

    #[test]
    fn hello_does_not_change_the_clock_comparison() {
        let mut presence = Presence::new(1, stamp(100));
        presence.update(stamp(101).wall + Span::from_millis(250), stamp(101));
        presence.introduce(2, stamp(160));
        assert_eq!(presence.clock_ahead(), Span::from_millis(250));
    }
}
