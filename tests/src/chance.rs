//! Chance that can be repeated.

use std::time::Duration;

use peernet_statistics::SplitMix64;

use crate::say;
use crate::time::wall;

/// The variable that repeats a run.
const SEED: &str = "PEERNET_SEED";

/// Numbers that look random and follow from a seed.
#[derive(Clone, Debug)]
pub struct Chance(SplitMix64);

impl Chance {
    /// Seeded by `PEERNET_SEED`, or else anew; says with what, so that it can be repeated.
    ///
    /// # Panics
    /// When `PEERNET_SEED` is no number.
    pub fn new(what: &str) -> Self {
        let seed = match std::env::var(SEED) {
            Ok(text) => text.parse().unwrap_or_else(|_| panic!("{SEED}={text:?} is no number")),
            Err(_) => wall().unix_nanos().cast_unsigned() % 1_000_000,
        };
        say(&format!("{what}: {SEED}={seed}"));
        Self(SplitMix64::new(seed))
    }

    /// The next number, evenly spread over 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// A number below `end`, which is not 0.
    pub fn below(&mut self, end: usize) -> usize {
        (self.bits() % end as u64) as usize
    }

    /// True once in so many times.
    pub fn once_in(&mut self, times: usize) -> bool {
        self.below(times) == 0
    }

    /// Lets a random time pass, so that what follows meets any moment of what goes on elsewhere.
    pub fn linger(&mut self, longest: Duration) {
        std::thread::sleep(longest.mul_f64(self.below(1_000) as f64 / 1_000.0));
    }
}
