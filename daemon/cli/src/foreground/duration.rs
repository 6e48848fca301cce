//! Formatting of durations for a terminal: with ordinary spaces, unlike on a page.

use peernet_statistics::number::{self, SPACE};

/// Formats a duration: `0.4 s`, `35 s`, `4 min 12 s`, `2 h 5 min`, `3 d 4 h`.
pub(crate) fn long_duration(seconds: f64) -> String {
    number::long_duration(seconds).replace(SPACE, " ")
}

/// Formats an estimate of a duration, rounded up: `40 s`, `5 min`, `3 h 20 min`.
pub(crate) fn estimated_duration(seconds: f64) -> String {
    number::estimated_duration(seconds).replace(SPACE, " ")
}
