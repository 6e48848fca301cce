//! Stamps of messages that others sent, made at both ends of a link by programs that only observe.

use peernet_clock::{Clock, MonoTime, OneWayDelay, RawTime, Stamp, WallTime};
use peernet_logger::Transit;

/// When a message was at a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct HostStamp {
    /// The host's wall clock.
    pub(crate) wall: WallTime,
    /// [`Clock::epoch`] of the stamp; `None` where the clock was stepped near it.
    pub(crate) epoch: Option<u32>,
}

/// A message at the two ends of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Crossing {
    pub(crate) sender: HostStamp,
    pub(crate) receiver: HostStamp,
}

impl HostStamp {
    /// The clock that delays are judged by.
    pub(super) const fn time(&self) -> RawTime {
        RawTime::of_wall(self.wall)
    }
}

impl Crossing {
    pub(super) fn times(&self) -> (RawTime, RawTime) {
        (self.sender.time(), self.receiver.time())
    }

    /// The receiver's stamp less the sender's, of which nothing else is known than that a clock was stepped.
    pub(super) fn stepped(&self) -> OneWayDelay {
        OneWayDelay::stepped(self.receiver.wall - self.sender.wall, peernet_clock::DelaySource::None)
    }

    /// The content of a node for it.
    pub(crate) const fn transit(&self, delay: Option<OneWayDelay>) -> Transit {
        Transit { sent: self.sender.wall, received: Some(self.receiver.wall), delay, raw_stamps: None }
    }
}

/// Finds out which stamps of this host's clock are of which epoch.
#[derive(Debug)]
pub(crate) struct EpochWatch {
    epoch: u32,
    /// When the epoch was seen first. Stamps from before may be older than the step.
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
        HostStamp { wall: stamp.wall, epoch: (stamp.mono >= self.since).then_some(epoch) }
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{ClockIdentity, ManualClock, Span};

    use super::*;

    #[test]
    fn stamps_from_before_a_step_have_no_epoch() {
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
