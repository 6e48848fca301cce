//! Conversion of the kernel's packet stamps, which are of the wall clock, to times of the free-running clock.

use peernet_clock::{Interval, RawTime, Span, WallTime};

/// Largest difference of two comparisons of the clocks, beyond their widths, if the wall clock was not set in between.
const STEADY_TOLERANCE: Span = Span::from_micros(10);

/// Bounds of the time of the free-running clock at which the wall clock showed a stamp.
///
/// Two comparisons of the clocks, one before and one after the stamp, give the difference wall clock minus free-running
/// clock. In between the wall clock may have been slewed or set; the difference was somewhere between the two. The
/// bounds are therefore as far apart as the comparisons differ, and a stamp only helps if it gains more than that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KernelStamp {
    /// Time that is not later than the true one.
    pub earliest: RawTime,
    /// Time that is not earlier than the true one.
    pub latest: RawTime,
    /// `true` if the wall clock was not set between the comparisons.
    pub is_steady: bool,
}

impl KernelStamp {
    /// Converts a stamp that was made between two comparisons of the clocks.
    pub fn between(stamp: WallTime, before: Interval, after: Interval) -> Self {
        let ahead = before.hull(after);
        let raw = |ahead: Span| RawTime::from_nanos((stamp - ahead).unix_nanos());
        let is_steady = ahead.width() <= before.width() + after.width() + STEADY_TOLERANCE;
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
    fn stamp_is_as_wide_as_comparisons_differ() {
        let stamp = WallTime::from_unix_nanos(1_000_000);
        let calm = KernelStamp::between(stamp, ahead(100, 140), ahead(110, 150));
        let raw = RawTime::from_nanos;
        assert_eq!(calm, KernelStamp { earliest: raw(999_850), latest: raw(999_900), is_steady: true });
        // Set by a second in between: it is unknown on which side of the stamp.
        let set = KernelStamp::between(stamp, ahead(100, 140), ahead(1_000_000_100, 1_000_000_140));
        assert_eq!((set.latest - set.earliest, set.is_steady), (Span::from_nanos(1_000_000_040), false));
    }
}
