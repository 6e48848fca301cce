//! Stamps that the kernel makes of packets. They are of the wall clock, and become times of the free-running clock here.

use peernet_clock::{Interval, RawTime, Span, WallTime};

/// Two looks at a host's clocks that agree to this: the wall clock was not set in between.
const STEADY: Span = Span::from_micros(10);

/// When, by the free-running clock, the wall clock showed `stamp`.
///
/// `before` and `after` are how far the wall clock was ahead at two looks, one before and one after the stamp. In between it may have
/// been slewed, or set: it was ahead by something between the two. So the ends are apart by what the looks differ, and a stamp narrows
/// nothing by which they differ more than it gains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KernelStamp {
    /// Not later than the truth.
    pub earliest: RawTime,
    /// Not earlier than the truth.
    pub latest: RawTime,
    /// Whether the wall clock went on steadily between the looks.
    pub is_steady: bool,
}

impl KernelStamp {
    /// A stamp between two looks.
    pub fn between(stamp: WallTime, before: Interval, after: Interval) -> Self {
        let ahead = before.hull(after);
        let raw = |ahead: Span| RawTime::from_nanos((stamp - ahead).unix_nanos());
        let is_steady = ahead.width() <= before.width() + after.width() + STEADY;
        Self { earliest: raw(ahead.hi), latest: raw(ahead.lo), is_steady }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ahead(lo: i64, hi: i64) -> Interval {
        Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) }
    }

    #[test]
    fn stamp_is_as_wide_as_looks_at_clocks_differ() {
        let stamp = WallTime::from_unix_nanos(1_000_000);
        let calm = KernelStamp::between(stamp, ahead(100, 140), ahead(110, 150));
        let raw = RawTime::from_nanos;
        assert_eq!(calm, KernelStamp { earliest: raw(999_850), latest: raw(999_900), is_steady: true });
        // Set by a second in between: nobody knows on which side of the stamp.
        let set = KernelStamp::between(stamp, ahead(100, 140), ahead(1_000_000_100, 1_000_000_140));
        assert_eq!((set.latest - set.earliest, set.is_steady), (Span::from_nanos(1_000_000_040), false));
    }
}
