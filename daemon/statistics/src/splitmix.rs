//! Reproducible pseudo-random numbers.

/// The generator SplitMix64 (Steele, Lea and Flood, OOPSLA 2014).
///
/// PEERNet has its own generator, because the default generator of a library may change between versions. A `seed` in a
/// configuration would then stand for other arrival times and another order of runs.
#[derive(Clone, Debug)]
pub struct SplitMix64(u64);

impl SplitMix64 {
    /// Creates a generator whose numbers depend on the seed only.
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns the next number, uniform over 64 bits.
    pub const fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number that is uniform in the half-open interval from 0 to 1.
    pub fn unit(&mut self) -> f64 {
        // A double has 53 significant bits, so that every result is exact and none is rounded up to 1.
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Returns an exponentially distributed number with mean 1.
    pub fn exponential(&mut self) -> f64 {
        // 1 − u is never 0, so the logarithm is finite.
        -(1.0 - self.unit()).ln()
    }

    /// Returns a number with mean 0 and standard deviation 1 that is nearly normally distributed (Irwin–Hall, twelve
    /// terms).
    pub fn normal(&mut self) -> f64 {
        // The variance of a uniform number is 1/12, so the sum of twelve of them has the variance 1. The mean of the
        // sum is 6.
        (0..12).map(|_| self.unit()).sum::<f64>() - 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequence_equals_reference_values() {
        // Reference values for seed 1234567, with which implementations of SplitMix64 are compared.
        let mut random = SplitMix64::new(1_234_567);
        let first: Vec<u64> = (0..5).map(|_| random.bits()).collect();
        assert_eq!(
            first,
            [
                6_457_827_717_110_365_317,
                3_203_168_211_198_807_973,
                9_817_491_932_198_370_423,
                4_593_380_528_125_082_431,
                16_408_922_859_458_223_821
            ]
        );
    }

    #[test]
    fn mean_and_deviation_match_distribution() {
        let mut random = SplitMix64::new(3);
        let mut mean = |draw: fn(&mut SplitMix64) -> f64| {
            (0..100_000).map(|_| draw(&mut random)).sum::<f64>() / 100_000.0
        };
        assert!((mean(SplitMix64::exponential) - 1.0).abs() < 0.02);
        assert!(mean(SplitMix64::normal).abs() < 0.02);
        assert!((mean(|random| random.normal().powi(2)) - 1.0).abs() < 0.02);
    }
}
