//! The limit of drift as an integer, rounded so that it never promises too much.

/// How far apart two clocks can run within a distance of the edge's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DriftLimit {
    /// Parts per 2⁴⁰.
    rate: u64,
}

impl DriftLimit {
    const BITS: u32 = 40;
    /// Half a second per second: what is beyond is no clock.
    const WORST_PPM: f64 = 500_000.0;

    /// From parts per million, by whichever of the two clocks they are counted: when the edge is the slow one, a
    /// difference of ρ per second of the cloud is one of ρ / (1 − ρ) per second of the edge. What is not a number
    /// limits nothing.
    pub(crate) fn new(ppm: f64) -> Self {
        let ppm = if ppm.is_nan() { Self::WORST_PPM } else { ppm.clamp(0.0, Self::WORST_PPM) };
        let rate = ppm / (1e6 - ppm);
        // A relative 1e-12 outweighs the rounding of this line many times over.
        Self { rate: (rate * (1.0 + 1e-12) * (1u64 << Self::BITS) as f64).ceil() as u64 }
    }

    /// The most by which the offset can have changed between two times, rounded up to whole nanoseconds.
    ///
    /// For distances a and b, `over(a) + over(b) − 1 ≤ over(a + b) ≤ over(a) + over(b)`: what
    /// [`Slots`](super::slots::Slots) relies on.
    #[inline]
    pub(crate) fn between(self, a: i64, b: i64) -> i64 {
        let product = u128::from(a.abs_diff(b)) * u128::from(self.rate);
        let rounded = (product + ((1 << Self::BITS) - 1)) >> Self::BITS;
        i64::try_from(rounded).unwrap_or(i64::MAX)
    }

    /// The same for a length of time.
    #[inline]
    pub(crate) fn over(self, length: i64) -> i64 {
        self.between(0, length)
    }

    /// Slopes beyond this are no drift.
    pub(crate) fn slope(self) -> f64 {
        self.rate as f64 / (1u64 << Self::BITS) as f64
    }
}
