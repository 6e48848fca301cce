//! A mergeable quantile sketch with a bounded relative error.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Quantiles of numbers of any sign, within 1 % of the true value.
///
/// DDSketch (Masson, Rim and Lee, VLDB 2019): a number falls into the bin of its rounded-up logarithm to the
/// base γ = 1.01 / 0.99; the bin's midpoint is within 1 % of everything in it. Merging adds bins and loses nothing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sketch {
    positive: BTreeMap<i32, u64>,
    negative: BTreeMap<i32, u64>,
    zero: u64,
}

impl Sketch {
    /// The relative error of a quantile.
    pub const RELATIVE_ERROR: f64 = 0.01;
    const GAMMA: f64 = (1.0 + Self::RELATIVE_ERROR) / (1.0 - Self::RELATIVE_ERROR);
    /// Numbers nearer to zero than this count as zero: a tenth of a nanosecond, in seconds.
    const SMALLEST: f64 = 1e-10;

    /// Adds a number.
    pub fn record(&mut self, value: f64) {
        let bin = || (value.abs().ln() / Self::GAMMA.ln()).ceil() as i32;
        if value.abs() < Self::SMALLEST || value.is_nan() {
            self.zero += 1;
        } else if value > 0.0 {
            *self.positive.entry(bin()).or_default() += 1;
        } else {
            *self.negative.entry(bin()).or_default() += 1;
        }
    }

    /// Adds all numbers of another.
    pub fn merge(&mut self, other: &Self) {
        for (bin, count) in &other.positive {
            *self.positive.entry(*bin).or_default() += count;
        }
        for (bin, count) in &other.negative {
            *self.negative.entry(*bin).or_default() += count;
        }
        self.zero += other.zero;
    }

    /// How many numbers.
    pub fn count(&self) -> u64 {
        self.bins().map(|(_, count)| count).sum()
    }

    /// The number below which a fraction `q` (0 to 1) of all numbers lies; `None` when there are none.
    pub fn quantile(&self, q: f64) -> Option<f64> {
        let count = self.count();
        let rank = (q.clamp(0.0, 1.0) * count.checked_sub(1)? as f64).round() as u64;
        let mut below = 0;
        self.bins().find_map(|(value, count)| {
            below += count;
            (below > rank).then_some(value)
        })
    }

    /// Midpoints and counts of all bins that are not empty, in rising order of midpoints.
    pub fn bins(&self) -> impl Iterator<Item = (f64, u64)> + '_ {
        let middle = |bin: &i32| 2.0 * Self::GAMMA.powi(*bin) / (Self::GAMMA + 1.0);
        let negative = self.negative.iter().rev().map(move |(bin, count)| (-middle(bin), *count));
        let zero = (self.zero > 0).then_some((0.0, self.zero));
        let positive = self.positive.iter().map(move |(bin, count)| (middle(bin), *count));
        negative.chain(zero).chain(positive)
    }
}
