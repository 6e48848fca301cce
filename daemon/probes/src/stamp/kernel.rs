//! Conversion of the kernel's packet stamps, which are of the wall clock, to times of the free-running clock.

use peernet_clock::{Interval, RawTime, Span, WallTime};

/// Tolerance for two comparisons of the clocks. If they differ by more than this span plus their own widths, the wall
/// clock was set in between.
const MAX_STEADY_DIFFERENCE: Span = Span::from_micros(10);

/// Bounds of the time of the free-running clock at which the wall clock showed a stamp.
///
/// Two comparisons of the clocks, one before and one after the stamp, give the difference wall clock minus free-running
/// clock. If the wall clock was slewed or set in between, the two differences are not equal. The true difference at the
/// stamp then lies between them, so the bounds are as far apart as the comparisons differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KernelStamp {
    /// Time that is not later than the true time.
    pub earliest: RawTime,
    /// Time that is not earlier than the true time.
    pub latest: RawTime,
    /// `true` if the wall clock was not set between the comparisons.
    pub is_steady: bool,
}

impl KernelStamp {
    /// Converts a stamp that was made between two comparisons of the clocks.
    pub fn from_comparisons(stamp: WallTime, before: Interval, after: Interval) -> Self {
        let ahead = before.hull(after);
        let raw_time = |ahead: Span| RawTime::from_nanos((stamp - ahead).unix_nanos());
        let is_steady = ahead.width() <= before.width() + after.width() + MAX_STEADY_DIFFERENCE;
        Self { earliest: raw_time(ahead.hi), latest: raw_time(ahead.lo), is_steady }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ahead(lo: i64, hi: i64) -> Interval {
        Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) }
    }

    #[test]
    fn bounds_are_as_far_apart_as_comparisons_differ() {
        let stamp = WallTime::from_unix_nanos(1_000_000);
        let steady = KernelStamp::from_comparisons(stamp, ahead(100, 140), ahead(110, 150));
        let raw = RawTime::from_nanos;
        assert_eq!(steady, KernelStamp { earliest: raw(999_850), latest: raw(999_900), is_steady: true });
        // The wall clock was set by one second in between. Whether this was before or after the stamp is unknown.
        let set = KernelStamp::from_comparisons(stamp, ahead(100, 140), ahead(1_000_000_100, 1_000_000_140));
        assert_eq!((set.latest - set.earliest, set.is_steady), (Span::from_nanos(1_000_000_040), false));
    }
}
