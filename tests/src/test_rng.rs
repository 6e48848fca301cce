//! Pseudo-random numbers for tests, which can be repeated.

use std::time::Duration;

use peernet_statistics::SplitMix64;

use crate::print_line;
use crate::time::wall;

/// Environment variable with the seed of an earlier test run.
const SEED: &str = "PEERNET_SEED";

/// Generator of pseudo-random numbers that depend on a seed only.
#[derive(Clone, Debug)]
pub struct TestRng(SplitMix64);

impl TestRng {
    /// Seeds the generator with `PEERNET_SEED`, or with the time; prints the seed, so that the test can be repeated.
    ///
    /// # Panics
    /// If `PEERNET_SEED` is not a number.
    pub fn new(title: &str) -> Self {
        let seed = match std::env::var(SEED) {
            Ok(text) => text.parse().unwrap_or_else(|_| panic!("{SEED}={text:?} is no number")),
            Err(_) => wall().unix_nanos().cast_unsigned() % 1_000_000,
        };
        print_line(&format!("{title}: {SEED}={seed}"));
        Self(SplitMix64::new(seed))
    }

    /// Returns the next number, uniform over 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// Returns a number below `end`, which must not be 0.
    pub fn below(&mut self, end: usize) -> usize {
        (self.bits() % end as u64) as usize
    }

    /// Returns `true` with probability 1 / `times`.
    pub fn once_in(&mut self, times: usize) -> bool {
        self.below(times) == 0
    }

    /// Waits for a random time up to `longest`, so that the next step happens at any moment of a concurrent activity.
    pub fn sleep_up_to(&mut self, longest: Duration) {
        std::thread::sleep(longest.mul_f64(self.below(1_000) as f64 / 1_000.0));
    }
}
