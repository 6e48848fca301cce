//! Instants on the clocks of a host, and the difference between two instants of one clock.
//!
//! All these types are signed 64-bit nanoseconds: ±292 years around the clock's origin. Arithmetic saturates, so that a
//! nonsensical stamp from a peer cannot cause a panic.

use std::fmt;
use std::ops::{Add, AddAssign, Neg, Sub};
use std::time::Duration;

use serde::{Deserialize, Serialize};

/// Instant of a host's wall clock (`CLOCK_REALTIME`): nanoseconds since 1970-01-01 00:00 UTC without leap seconds.
///
/// An instant can be compared only with wall times of the same host, unless a [`Relation`](crate::Relation) translates
/// the instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct WallTime(i64);

/// Instant of a host's monotonic clock (`CLOCK_MONOTONIC`): nanoseconds since an arbitrary moment near boot.
///
/// An instant is never sent to another host; only differences between two instants are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MonoTime(i64);

/// Instant of a host's free-running clock (`CLOCK_MONOTONIC_RAW`): nanoseconds since an arbitrary moment near boot.
///
/// No time daemon steps or slews this clock, so it drifts steadily against the free-running clock of another host. An
/// instant can be compared only with instants of the same host since the same boot, unless a
/// [`Relation`](crate::Relation) translates the instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RawTime(i64);

/// Signed difference between two instants of one clock, in nanoseconds.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Span(i64);

impl WallTime {
    /// Returns the instant `nanos` nanoseconds after the Unix epoch.
    pub const fn from_unix_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Returns the nanoseconds since the Unix epoch.
    pub const fn unix_nanos(self) -> i64 {
        self.0
    }

    /// Returns the whole seconds since the Unix epoch, rounded towards the past.
    pub const fn unix_seconds(self) -> i64 {
        self.0.div_euclid(1_000_000_000)
    }
}

impl MonoTime {
    /// Returns the instant `nanos` nanoseconds after the clock's own origin.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Returns the nanoseconds since the clock's own origin.
    pub const fn nanos(self) -> i64 {
        self.0
    }
}

impl RawTime {
    /// Returns the instant `nanos` nanoseconds after the clock's own origin.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Returns a wall-clock time in the type of free-running times.
    // Needed for peers that send no free-running stamps, and for runs that were recorded with wall clocks only.
    pub const fn from_wall(wall: WallTime) -> Self {
        Self(wall.0)
    }

    /// Returns the nanoseconds since the clock's own origin.
    pub const fn nanos(self) -> i64 {
        self.0
    }
}

impl Span {
    /// Zero nanoseconds.
    pub const ZERO: Self = Self(0);

    /// Returns a span of `nanos` nanoseconds.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Returns a span of `micros` microseconds.
    pub const fn from_micros(micros: i64) -> Self {
        Self(micros.saturating_mul(1_000))
    }

    /// Returns a span of `millis` milliseconds.
    pub const fn from_millis(millis: i64) -> Self {
        Self(millis.saturating_mul(1_000_000))
    }

    /// Returns a span of `seconds` seconds.
    pub const fn from_seconds(seconds: i64) -> Self {
        Self(seconds.saturating_mul(1_000_000_000))
    }

    /// Returns the span nearest to `seconds`. NaN becomes zero, and values out of range saturate.
    pub fn from_seconds_f64(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as i64)
    }

    /// Returns the nanoseconds.
    pub const fn nanos(self) -> i64 {
        self.0
    }

    /// Returns the seconds, the unit in which durations are stored and served.
    pub fn seconds(self) -> f64 {
        // The number is divided, because 1e-9 is not exact in binary: the product would print as 60.00000000000001.
        self.0 as f64 / 1e9
    }

    /// Returns the drift of a clock within this time at a rate of `ppm` parts per million, rounded up.
    pub fn drift(self, ppm: f64) -> Self {
        Self((self.0 as f64 * ppm * 1e-6).ceil() as i64)
    }

    /// Converts to the standard library's unsigned duration; negative spans become zero.
    pub fn to_duration(self) -> Duration {
        Duration::from_nanos(u64::try_from(self.0).unwrap_or(0))
    }

    /// Returns whether the span is below zero.
    pub const fn is_negative(self) -> bool {
        self.0 < 0
    }

    /// Returns the span without its sign.
    pub const fn abs(self) -> Self {
        Self(self.0.saturating_abs())
    }
}

impl From<Duration> for Span {
    fn from(duration: Duration) -> Self {
        Self(i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX))
    }
}

macro_rules! instant_arithmetic {
    ($($instant:ident),*) => {$(
        impl Sub for $instant {
            type Output = Span;
            fn sub(self, earlier: Self) -> Span {
                Span(self.0.saturating_sub(earlier.0))
            }
        }

        impl Add<Span> for $instant {
            type Output = Self;
            fn add(self, span: Span) -> Self {
                Self(self.0.saturating_add(span.0))
            }
        }

        impl Sub<Span> for $instant {
            type Output = Self;
            fn sub(self, span: Span) -> Self {
                Self(self.0.saturating_sub(span.0))
            }
        }
    )*};
}

instant_arithmetic!(WallTime, MonoTime, RawTime);

impl Add for Span {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl AddAssign for Span {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Span {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl Neg for Span {
    type Output = Self;
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

impl std::iter::Sum for Span {
    fn sum<I: Iterator<Item = Self>>(spans: I) -> Self {
        spans.fold(Self::ZERO, |total, span| total + span)
    }
}

impl fmt::Debug for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Formats milliseconds with three decimals: `12.345 ms`.
impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3} ms", self.0 as f64 * 1e-6)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn adding_difference_restores_instant(a in -1i64 << 61..1 << 61, b in -1i64 << 61..1 << 61) {
            let (a, b) = (WallTime::from_unix_nanos(a), WallTime::from_unix_nanos(b));
            prop_assert_eq!(a + (b - a), b);
        }

        #[test]
        fn arithmetic_of_extreme_values_does_not_panic(a: i64, b: i64, s: i64) {
            let (a, b, s) = (MonoTime::from_nanos(a), MonoTime::from_nanos(b), Span::from_nanos(s));
            let _ = (a - b, a + s, b - s, -s, s.abs(), (a - b) + s, s.to_duration());
        }

        #[test]
        fn seconds_round_trip_within_a_nanosecond(nanos in -1i64 << 50..1 << 50) {
            let span = Span::from_nanos(nanos);
            prop_assert!((Span::from_seconds_f64(span.seconds()) - span).abs() <= Span::from_nanos(1));
        }
    }

    #[test]
    fn seconds_before_1970_round_towards_past() {
        assert_eq!(WallTime::from_unix_nanos(-1).unix_seconds(), -1);
        assert_eq!(WallTime::from_unix_nanos(1_999_999_999).unix_seconds(), 1);
    }
}
