//! The assumptions about the drift between two clocks. They are stored as integers, which are rounded so that bounds
//! stay valid.

/// The two assumptions about the rate at which two clocks drift apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DriftModel {
    /// Largest rate.
    pub(crate) limit: DriftLimit,
    /// Limit of the speed at which the rate changes; `None` if one of the clocks may be slewed, because a slew changes
    /// the rate at once.
    pub(crate) change_limit: Option<DriftChangeLimit>,
}

/// Limit of the rate at which two clocks drift apart, relative to the edge's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DriftLimit {
    /// Parts per 2⁴⁰.
    rate: u64,
}

impl DriftLimit {
    const BITS: u32 = 40;
    /// Largest limit that can be set: half a second per second. No clock drifts faster.
    const MAX_PPM: f64 = 500_000.0;

    /// Converts a limit in parts per million. The result is valid whichever of the two clocks the limit is relative to.
    ///
    /// If the edge's clock is the slower clock, a difference of ρ per second of the cloud's clock is a difference of ρ
    /// / (1 − ρ) per second of the edge's clock. NaN is converted to the largest limit.
    pub(crate) fn new(ppm: f64) -> Self {
        let ppm = if ppm.is_nan() { Self::MAX_PPM } else { ppm.clamp(0.0, Self::MAX_PPM) };
        let rate = ppm / (1e6 - ppm);
        // The factor 1 + 1e-12 makes up for the rounding error of this line, which is far smaller.
        Self { rate: (rate * (1.0 + 1e-12) * (1u64 << Self::BITS) as f64).ceil() as u64 }
    }

    /// Returns the largest change of the offset between two times, rounded up to whole nanoseconds.
    ///
    /// With w(d) for the change over a length d, w(a) + w(b) − 1 ≤ w(a + b) ≤ w(a) + w(b);
    /// [`Slots`](super::slots::Slots) relies on this.
    #[inline]
    pub(crate) fn max_change_between(self, a: i64, b: i64) -> i64 {
        let product = u128::from(a.abs_diff(b)) * u128::from(self.rate);
        let rounded = (product + ((1 << Self::BITS) - 1)) >> Self::BITS;
        i64::try_from(rounded).unwrap_or(i64::MAX)
    }

    /// Returns the largest change of the offset over a length of time in nanoseconds, rounded up.
    #[inline]
    pub(crate) fn max_change_over(self, length: i64) -> i64 {
        self.max_change_between(0, length)
    }

    /// Returns the limit in seconds per second.
    pub(crate) fn slope(self) -> f64 {
        self.rate as f64 / (1u64 << Self::BITS) as f64
    }
}

/// Limit of the speed at which the rate of drift changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DriftChangeLimit {
    /// Half of the limit in parts per 2⁸⁰ per nanosecond.
    half: u64,
}

impl DriftChangeLimit {
    const BITS: u32 = 80;
    /// Largest limit that can be set: a thousandth per second. The rate of no oscillator changes faster.
    const MAX_PPM_PER_S: f64 = 1_000.0;

    /// Converts a limit in parts per million per second. The result is valid whichever of the two clocks the limit is
    /// relative to.
    ///
    /// If two clocks drift apart by ρ, the second derivative of the offset by one clock is at most (1 − ρ)⁻³ times the
    /// second derivative by the other clock. NaN is converted to the largest limit.
    pub(crate) fn new(ppm_per_s: f64, rate: DriftLimit) -> Self {
        let max = Self::MAX_PPM_PER_S;
        let ppm_per_s = if ppm_per_s.is_nan() { max } else { ppm_per_s.clamp(0.0, max) };
        // 1 / (1 − ρ) is 1 + slope.
        let half = ppm_per_s * 1e-15 / 2.0 * (1.0 + rate.slope()).powi(3);
        Self { half: (half * (1.0 + 1e-12) * (1u128 << Self::BITS) as f64).ceil() as u64 }
    }

    /// Returns κ·a·b / 2 for two lengths of time in nanoseconds, rounded up; κ is this limit.
    ///
    /// A straight line through two values of the offset differs from the offset by at most this result, at a time that
    /// is `a` away from the first value and `b` away from the second.
    #[inline]
    pub(crate) fn max_deviation(self, a: u64, b: u64) -> i64 {
        let area = u128::from(a) * u128::from(b);
        let Some(product) = area.checked_mul(u128::from(self.half)) else { return i64::MAX };
        let rounded = (product >> Self::BITS) + 1;
        i64::try_from(rounded).unwrap_or(i64::MAX)
    }

    /// Returns κ / 2 per nanosecond in floating point. It selects points; bounds are never computed from it.
    #[inline]
    pub(crate) fn half_limit_per_nano(self) -> f64 {
        self.half as f64 / (1u128 << Self::BITS) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn max_deviation_is_rounded_up_and_saturates() {
        let limit = DriftChangeLimit::new(1.0, DriftLimit::new(0.0));
        let second = 1_000_000_000;
        // 1 ppm/s over 10 s and 10 s: 50 µs.
        assert!((50_000..50_010).contains(&limit.max_deviation(10 * second, 10 * second)));
        assert_eq!(limit.max_deviation(1, 1), 1);
        assert_eq!(limit.max_deviation(u64::MAX, u64::MAX), i64::MAX);
        let fast = DriftChangeLimit::new(1.0, DriftLimit::new(1_000.0));
        // 1 ppm/s over 100 s and 100 s: 5 ms, divided by (1 − 1,000 ppm)³.
        assert!(fast.max_deviation(100 * second, 100 * second) >= 5_015_000);
        let no_drift = DriftLimit::new(0.0);
        assert_eq!(DriftChangeLimit::new(f64::NAN, no_drift), DriftChangeLimit::new(f64::INFINITY, no_drift));
    }
}
