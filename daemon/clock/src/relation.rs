//! What is known of the offset between two hosts' wall clocks.

use serde::{Deserialize, Serialize};

use crate::{ClockIdentity, OneWayDelay, WallTime};

/// Which way a message went, seen from the edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// Edge to cloud.
    Up,
    /// Cloud to edge.
    Down,
}

/// The relation between the wall clocks of an edge and a cloud; it belongs to the pair of hosts, fed by all
/// their links.
///
/// Two states so far. The band estimated from exchanges of four stamps becomes the third: it will answer the
/// same question, [`delay`](Self::delay), with an interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relation {
    /// Both hosts read one clock: the offset is exactly zero.
    SameClock,
    /// Nothing is known.
    Unknown,
}

impl Relation {
    /// What two identities alone tell.
    pub fn between(edge: &ClockIdentity, cloud: &ClockIdentity) -> Self {
        if edge == cloud { Self::SameClock } else { Self::Unknown }
    }

    /// The delay of a message stamped `sent` by its sender's wall clock and `received` by its receiver's.
    pub fn delay(&self, _direction: Direction, sent: WallTime, received: WallTime) -> OneWayDelay {
        let raw = received - sent;
        match self {
            Self::SameClock => OneWayDelay::same_clock(raw),
            Self::Unknown => OneWayDelay::unsynchronised(raw),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DelaySource, Span, Verdict};

    #[test]
    fn one_clock_gives_exact_delays_and_two_give_none() {
        let here = ClockIdentity::new("boot-1", "system");
        let rehearsed = ClockIdentity::new("boot-1", "rehearsal");
        let (sent, received) = (WallTime::from_unix_nanos(100), WallTime::from_unix_nanos(350));

        let same = Relation::between(&here, &here.clone()).delay(Direction::Up, sent, received);
        assert_eq!(same.value, Some(Span::from_nanos(250)));
        assert_eq!((same.source, same.verdict), (DelaySource::SameClock, Verdict::Ok));

        let other = Relation::between(&here, &rehearsed).delay(Direction::Up, sent, received);
        assert_eq!((other.raw, other.value, other.bounds), (Span::from_nanos(250), None, None));
        assert_eq!(other.verdict, Verdict::Unsynchronised);
    }
}
