//! Stamps of a message at both ends of a link, from which the delay of the message is judged.

use peernet_clock::{Clock, MonoTime, OneWayDelay, RawTime, Stamp, WallTime};
use peernet_logger::{Measure, NodeId, RawStamps, Transit, Tree};

/// Time at which a host sent or received a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct HostStamp {
    /// Wall clock of the host.
    pub(crate) wall: WallTime,
    /// Free-running clock of the host, by which delays are judged.
    pub(crate) raw: RawTime,
    /// [`Clock::epoch`] of the stamp; `None` if the free-running clock was interrupted near the stamp.
    pub(crate) epoch: Option<u32>,
}

/// Stamps of one message at the two ends of a link.
///
/// The departure of an observed message is not stamped. `sender` is then the stamp with which the agent on the
/// sender's host received the message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TransitStamps {
    pub(crate) sender: HostStamp,
    pub(crate) receiver: HostStamp,
}

impl TransitStamps {
    /// Returns the stamps of a transit in a tree, with the given epochs of sender and receiver. `None` if the message
    /// has not arrived, or if the transit has no stamps of the free-running clocks.
    pub(super) fn in_tree(
        tree: &Tree,
        node: NodeId,
        (sender, receiver): (Option<u32>, Option<u32>),
    ) -> Option<Self> {
        let Measure::Transit(transit) = &tree.get(node)?.measure else { return None };
        let raw = transit.raw_stamps?;
        Some(Self {
            sender: HostStamp { wall: transit.sent, raw: raw.sent, epoch: sender },
            receiver: HostStamp { wall: transit.received?, raw: raw.received, epoch: receiver },
        })
    }

    /// Returns the times at the sender and at the receiver, each by the host's free-running clock.
    pub(super) fn times(&self) -> (RawTime, RawTime) {
        (self.sender.raw, self.receiver.raw)
    }

    /// Returns the delay of a message during whose transit a clock was interrupted. Only the difference of the wall
    /// clocks is known.
    pub(super) fn stepped_delay(&self) -> OneWayDelay {
        OneWayDelay::stepped(self.receiver.wall - self.sender.wall, peernet_clock::DelaySource::None)
    }

    /// Returns the delay with the difference of the wall clocks as its raw value, even if other clocks are related.
    pub(super) fn with_raw_difference(&self, delay: OneWayDelay) -> OneWayDelay {
        OneWayDelay { raw: self.receiver.wall - self.sender.wall, ..delay }
    }

    /// Returns the measure of the node for this message.
    pub(crate) const fn transit(&self, delay: Option<OneWayDelay>) -> Transit {
        let raw_stamps = Some(RawStamps { sent: self.sender.raw, received: self.receiver.raw });
        Transit { sent: self.sender.wall, received: Some(self.receiver.wall), delay, raw_stamps }
    }
}

/// Determines the epochs of stamps of this host's clock.
#[derive(Debug)]
pub(crate) struct EpochWatch {
    epoch: u32,
    /// Time at which the epoch was first seen. Earlier stamps may be from before the interruption.
    first_seen: MonoTime,
}

impl EpochWatch {
    pub(crate) fn new(clock: &dyn Clock) -> Self {
        Self { epoch: clock.epoch(), first_seen: clock.mono() }
    }

    /// Adds the epoch to a stamp that was made a moment ago.
    pub(crate) fn stamp(&mut self, clock: &dyn Clock, stamp: Stamp) -> HostStamp {
        let epoch = clock.epoch();
        if epoch != self.epoch {
            *self = Self { epoch, first_seen: clock.mono() };
        }
        HostStamp {
            wall: stamp.wall,
            raw: stamp.raw,
            epoch: (stamp.mono >= self.first_seen).then_some(epoch),
        }
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
        assert_eq!(watch.stamp(&clock, before).epoch, None, "a repeated call has the same result");
        clock.advance(Span::from_millis(1));
        assert_eq!(watch.stamp(&clock, clock.stamp()).epoch, Some(1));
    }
}
