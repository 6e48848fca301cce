//! Mergeable quantile sketch with bounded relative error and bounded memory.

mod bins;
mod packed;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use self::bins::Bins;
pub use self::packed::PackedError;
use crate::Merge;

/// Quantiles of numbers of any sign, with a relative error of at most 1 %.
///
/// This is a DDSketch (Masson, Rim and Lee, VLDB 2019). The key of a number's bin is the logarithm of the number to the
/// base γ = 1.01 / 0.99, rounded up. The midpoint of a bin differs by at most 1 % from every number in the bin. Merging
/// adds the counts of the bins. The order in which sketches are merged does not matter, and no precision is lost.
///
/// Memory is bounded: each sign has at most [`Sketch::MAX_BINS`] bins. These bins span a factor of 6 × 10¹⁷ between the
/// largest and the smallest magnitude. All numbers closer to zero are counted in the lowest bin, so that the error of
/// the large quantiles stays bounded.
///
/// ```
/// # use peernet_statistics::Sketch;
/// let mut sketch = Sketch::default();
/// (1..=1000).for_each(|n| sketch.record(f64::from(n) * 1e-3));
/// let p95 = sketch.quantile(0.95).unwrap();
/// assert!((p95 - 0.95).abs() < 0.01 * 0.95);
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sketch {
    /// Bins of positive numbers.
    positive: Bins,
    /// Bins of the magnitudes of negative numbers.
    negative: Bins,
    /// Number of zeros and of numbers that count as zero ([`Sketch::MIN_MAGNITUDE`]).
    zero: u64,
}

impl Sketch {
    /// Largest relative error of a quantile.
    pub const RELATIVE_ERROR: f64 = 0.01;
    /// Maximum number of bins per sign.
    pub const MAX_BINS: usize = bins::MAX_BINS_PER_SIGN;

    /// Numbers of smaller magnitude count as zero. For durations in seconds, this is a tenth of a nanosecond.
    const MIN_MAGNITUDE: f64 = 1e-10;

    /// Adds a number. A number that is not finite is ignored.
    #[inline]
    pub fn record(&mut self, value: f64) {
        let magnitude = value.abs();
        // Zero has no logarithm, so it has a count of its own.
        if magnitude < Self::MIN_MAGNITUDE {
            self.zero += 1;
        } else if magnitude.is_finite() {
            let bins = if value > 0.0 { &mut self.positive } else { &mut self.negative };
            bins.add(bins::key(magnitude), 1);
        }
    }

    /// Adds all numbers of another sketch. This takes one addition per bin.
    pub fn merge(&mut self, other: &Self) {
        self.positive.merge(&other.positive);
        self.negative.merge(&other.negative);
        self.zero += other.zero;
    }

    /// Returns the number of recorded numbers.
    pub fn count(&self) -> u64 {
        self.positive.count() + self.negative.count() + self.zero
    }

    /// Returns the quantile at `q` from 0 to 1: the number below which the fraction `q` of all numbers lies. `None` if
    /// no number was recorded.
    ///
    /// Interpolates linearly between neighbours, like numpy by default (definition 7 of Hyndman and Fan 1996). Both
    /// neighbours are known within 1 %. If they have the same sign, every value between them is also known within 1 %.
    pub fn quantile(&self, q: f64) -> Option<f64> {
        let rank = q.clamp(0.0, 1.0) * self.count().checked_sub(1)? as f64;
        let (lower, upper) = (rank.floor() as u64, rank.ceil() as u64);
        let mut cumulative_count = 0;
        let mut lower_value = None;
        self.bins().find_map(|(value, count)| {
            cumulative_count += count;
            if cumulative_count > lower {
                lower_value.get_or_insert(value);
            }
            // The bin of the upper neighbour may be a later bin than that of the lower neighbour.
            let lower_value = lower_value.filter(|_| cumulative_count > upper);
            lower_value.map(|lower_value| lower_value + (value - lower_value) * rank.fract())
        })
    }

    /// Iterates over midpoints and counts of all bins that are not empty, in ascending order of midpoints.
    pub fn bins(&self) -> impl Iterator<Item = (f64, u64)> + '_ {
        let negative = self.negative.iter().rev().map(|(key, count)| (-bins::middle(key), count));
        let zero = (self.zero > 0).then_some((0.0, self.zero));
        let positive = self.positive.iter().map(|(key, count)| (bins::middle(key), count));
        negative.chain(zero).chain(positive)
    }

    /// Iterates over lower end, midpoint and upper end of all bins that are not empty, in ascending order.
    pub(crate) fn bin_ends(&self) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
        let negative = self.negative.iter().rev().map(|(key, _)| {
            let (lower, upper) = bins::range(key);
            (-upper, -bins::middle(key), -lower)
        });
        let zero = (self.zero > 0).then_some((0.0, 0.0, 0.0));
        let positive = self.positive.iter().map(|(key, _)| {
            let (lower, upper) = bins::range(key);
            (lower, bins::middle(key), upper)
        });
        negative.chain(zero).chain(positive)
    }

    /// Returns the number of values below `x`, for drawing. The values of a bin are assumed to be evenly distributed
    /// within the bin, so the result may have a fractional part.
    pub fn count_below(&self, x: f64) -> f64 {
        let fraction_of_bin = |lower: f64, upper: f64| ((x - lower) / (upper - lower)).clamp(0.0, 1.0);
        let negative = self.negative.iter().map(|(key, count)| {
            let (lower, upper) = bins::range(key);
            count as f64 * fraction_of_bin(-upper, -lower)
        });
        let zero = if x > 0.0 { self.zero as f64 } else { 0.0 };
        let positive = self.positive.iter().map(|(key, count)| {
            let (lower, upper) = bins::range(key);
            count as f64 * fraction_of_bin(lower, upper)
        });
        negative.sum::<f64>() + zero + positive.sum::<f64>()
    }

    /// Returns the fraction of all numbers that are below `x`, 0 to 1; `None` if no number was recorded.
    pub fn fraction_below(&self, x: f64) -> Option<f64> {
        let count = self.count();
        (count > 0).then(|| self.count_below(x) / count as f64)
    }

    /// Returns the packed form that is stored and sent: usually two bytes per bin that is not empty.
    pub fn to_bytes(&self) -> Vec<u8> {
        packed::pack(self)
    }

    /// Reads the packed form.
    ///
    /// # Errors
    /// If the bytes are not a valid sketch. They may come from an untrusted source.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PackedError> {
        packed::unpack(bytes)
    }
}

impl Merge for Sketch {
    fn merge(&mut self, other: &Self) {
        // The inherent method has the same name. It can be called without the trait in scope.
        Self::merge(self, other);
    }
}

impl Serialize for Sketch {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.to_bytes())
    }
}

impl<'de> Deserialize<'de> for Sketch {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let bytes: std::borrow::Cow<'de, [u8]> = serde_bytes::deserialize(deserializer)?;
        Self::from_bytes(&bytes).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests;
