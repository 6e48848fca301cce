//! The time in which a run measured, and the values that it measured within a period.

use peernet_clock::WallTime;
use peernet_statistics::Summary;

/// Time in which a run measured: from its first successful iteration after the warm-up to its last, by the edge's wall
/// clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeasuredTime {
    /// Start of the first of these iterations.
    pub first: WallTime,
    /// Start of the last of these iterations.
    pub last: WallTime,
    /// Resolution of both times and of [`Store::measured_within`](crate::Store::measured_within), seconds. It is 0
    /// while all iterations of the run are stored. Otherwise `first` is rounded up and `last` is rounded down, so the
    /// run measured at least from `first` to `last`.
    pub resolution_s: u32,
}

/// Iterations of a run that started within a period; only successful iterations after the warm-up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasuredWithin {
    /// Number of the iterations.
    pub count: u64,
    /// Totals of the iterations, seconds.
    pub totals: Summary,
}
