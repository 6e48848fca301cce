//! Stamps of messages that others sent, made at both ends of a link by programs that only observe.

use peernet_clock::{Clock, MonoTime, OneWayDelay, RawTime, Stamp, WallTime};
use peernet_logger::{RawStamps, Transit};

/// When a message was at a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct HostStamp {
    /// The host's wall clock.
    pub(crate) wall: WallTime,
    /// The host's free-running clock, by which delays are judged.
    pub(crate) raw: RawTime,
    /// [`Clock::epoch`] of the stamp; `None` where the free-running clock was interrupted near it.
    pub(crate) epoch: Option<u32>,
}

/// A message at the two ends of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Crossing {
    pub(crate) sender: HostStamp,
    pub(crate) receiver: HostStamp,
}

impl Crossing {
    pub(super) fn times(&self) -> (RawTime, RawTime) {
        (self.sender.raw, self.receiver.raw)
    }

    /// The receiver's stamp less the sender's, of which nothing else is known than that a clock was interrupted.
    pub(super) fn stepped(&self) -> OneWayDelay {
        OneWayDelay::stepped(self.receiver.wall - self.sender.wall, peernet_clock::DelaySource::None)
    }

    /// The same delay with what is kept for ever: the difference of the wall clocks, whichever clocks are related.
    pub(super) fn with_raw_difference(&self, delay: OneWayDelay) -> OneWayDelay {
        OneWayDelay { raw: self.receiver.wall - self.sender.wall, ..delay }
    }

    /// The content of a node for it.
    pub(crate) const fn transit(&self, delay: Option<OneWayDelay>) -> Transit {
        let raw_stamps = Some(RawStamps { sent: self.sender.raw, received: self.receiver.raw });
        Transit { sent: self.sender.wall, received: Some(self.receiver.wall), delay, raw_stamps }
    }
}

/// Finds out which stamps of this host's clock are of which epoch.
#[derive(Debug)]
pub(crate) struct EpochWatch {
    epoch: u32,
    /// When the epoch was seen first. Stamps from before may be older than the interruption.
    since: MonoTime,
}

impl EpochWatch {
    pub(crate) fn new(clock: &dyn Clock) -> Self {
        Self { epoch: clock.epoch(), since: clock.mono() }
    }

    /// Returns a stamp that was made a moment ago with its epoch.
    pub(crate) fn stamp(&mut self, clock: &dyn Clock, stamp: Stamp) -> HostStamp {
        let epoch = clock.epoch();
        if epoch != self.epoch {
            *self = Self { epoch, since: clock.mono() };
        }
        HostStamp { wall: stamp.wall, raw: stamp.raw, epoch: (stamp.mono >= self.since).then_some(epoch) }
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{ClockIdentity, ManualClock, Span};

    use super::*;

    #[test]
    fn stamps_from_before_an_interruption_have_no_epoch() {
        let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system"));
        let mut watch = EpochWatch::new(&clock);
        clock.advance(Span::from_millis(1));
        assert_eq!(watch.stamp(&clock, clock.stamp()).epoch, Some(0));
        let before = clock.stamp();
        clock.advance(Span::from_millis(1));
        clock.begin_epoch();
        assert_eq!(watch.stamp(&clock, before).epoch, None);
        assert_eq!(watch.stamp(&clock, before).epoch, None, "however often it is asked");
        clock.advance(Span::from_millis(1));
        assert_eq!(watch.stamp(&clock, clock.stamp()).epoch, Some(1));
    }
}
