//! The end of a connection: a goodbye that is repeated until the other end confirms it.

use peernet_clock::{MonoTime, Span};

/// Interval between goodbyes.
const BYE_INTERVAL: Span = Span::from_millis(50);

/// Number of received goodbyes after which unfinished messages are given up.
const BYES_UNTIL_GIVING_UP: u32 = 2;
/// Number of received goodbyes after which the goodbye is confirmed even if messages are not settled.
const BYES_UNTIL_CONFIRMATION: u32 = 8;

/// State of a connection's shutdown.
#[derive(Debug)]
pub(super) struct Shutdown {
    phase: Phase,
    /// Number of goodbyes that arrived.
    received_byes: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Open,
    Closing { next_bye: MonoTime },
    Closed,
}

impl Shutdown {
    pub(super) const fn new() -> Self {
        Self { phase: Phase::Open, received_byes: 0 }
    }

    pub(super) fn is_open(&self) -> bool {
        self.phase == Phase::Open
    }

    /// Returns whether the connection is over.
    pub(super) fn is_closed(&self) -> bool {
        self.phase == Phase::Closed
    }

    /// Starts to say goodbye.
    pub(super) fn start(&mut self, now: MonoTime) {
        if self.is_open() {
            self.phase = Phase::Closing { next_bye: now };
        }
    }

    /// Returns the time of the next goodbye.
    pub(super) const fn bye_at(&self) -> Option<MonoTime> {
        match self.phase {
            Phase::Closing { next_bye } => Some(next_bye),
            Phase::Open | Phase::Closed => None,
        }
    }

    /// Notes that a goodbye is sent.
    pub(super) fn record_bye(&mut self, now: MonoTime) {
        self.phase = Phase::Closing { next_bye: now + BYE_INTERVAL };
    }

    /// Handles the confirmation of the goodbye.
    pub(super) fn confirm(&mut self) {
        // A confirmation before this end's goodbye is invalid and must not end the connection.
        if !self.is_open() {
            self.phase = Phase::Closed;
        }
    }

    /// Handles a goodbye of the other end. Returns the number of goodbyes so far.
    pub(super) fn receive_bye(&mut self) -> u32 {
        self.received_byes += 1;
        self.received_byes
    }

    /// Returns whether the other end has said goodbye so often that its unfinished messages are no longer awaited.
    pub(super) const fn must_give_up_messages(&self) -> bool {
        self.received_byes >= BYES_UNTIL_GIVING_UP
    }

    /// Returns whether the other end has said goodbye so often that the goodbye must be confirmed even if messages
    /// are not settled.
    pub(super) const fn must_confirm_bye(&self) -> bool {
        self.received_byes >= BYES_UNTIL_CONFIRMATION
    }

    /// Ends the connection. Returns whether it was open or closing before.
    pub(super) fn close(&mut self) -> bool {
        std::mem::replace(&mut self.phase, Phase::Closed) != Phase::Closed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goodbye_is_repeated_until_it_is_confirmed() {
        let time_at = |millis| MonoTime::default() + Span::from_millis(millis);
        let mut shutdown = Shutdown::new();
        shutdown.confirm();
        assert!(
            shutdown.is_open() && shutdown.bye_at().is_none(),
            "a confirmation without a goodbye has no effect"
        );
        shutdown.start(time_at(10));
        assert_eq!(shutdown.bye_at(), Some(time_at(10)));
        shutdown.record_bye(time_at(20));
        shutdown.start(time_at(30));
        assert_eq!(shutdown.bye_at(), Some(time_at(70)));
        shutdown.confirm();
        assert!(shutdown.is_closed() && shutdown.bye_at().is_none() && !shutdown.close());
    }

    #[test]
    fn messages_are_given_up_before_forced_confirmation() {
        let mut shutdown = Shutdown::new();
        let mut states = Vec::new();
        for _ in 0..8 {
            shutdown.receive_bye();
            states.push((shutdown.must_give_up_messages(), shutdown.must_confirm_bye()));
        }
        assert_eq!(states[..2], [(false, false), (true, false)]);
        assert_eq!(states[6..], [(true, false), (true, true)]);
    }
}
