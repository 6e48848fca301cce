//! A mergeable quantile sketch with a bounded relative error and bounded memory.

mod bins;
mod packed;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use self::bins::Bins;
pub use self::packed::PackedError;
use crate::Merge;

/// Quantiles of numbers of any sign, within 1 % of the true value.
///
/// DDSketch (Masson, Rim and Lee, VLDB 2019): a number falls into the bin of its rounded-up logarithm to the
/// base γ = 1.01 / 0.99; the bin's midpoint is within 1 % of everything in it. Merging adds bins and loses
/// nothing, in whatever order.
///
/// Memory is bounded: at most [`Sketch::MAX_BINS`] bins a sign, which spans a factor of 6 × 10¹⁷ between the
/// largest number and the smallest one that is told apart; what is nearer to zero than that shares a bin, so
/// that the large quantiles keep their promise.
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
    positive: Bins,
    /// Bins of the magnitudes.
    negative: Bins,
    zero: u64,
}

impl Sketch {
    /// The relative error of a quantile.
    pub const RELATIVE_ERROR: f64 = 0.01;
    /// Bins per sign, at most.
    pub const MAX_BINS: usize = bins::MAX;

    /// Numbers nearer to zero than this count as zero: a tenth of a nanosecond, in seconds.
    const SMALLEST: f64 = 1e-10;

    /// Adds a number. What is not finite has no place among quantiles and is left out.
    #[inline]
    pub fn record(&mut self, value: f64) {
        let magnitude = value.abs();
        if magnitude < Self::SMALLEST {
            self.zero += 1;
        } else if magnitude.is_finite() {
            let bins = if value > 0.0 { &mut self.positive } else { &mut self.negative };
            bins.add(bins::key(magnitude), 1);
        }
    }

    /// Adds all numbers of another; costs one addition per bin.
    pub fn merge(&mut self, other: &Self) {
        self.positive.merge(&other.positive);
        self.negative.merge(&other.negative);
        self.zero += other.zero;
    }

    /// How many numbers.
    pub fn count(&self) -> u64 {
        self.positive.count() + self.negative.count() + self.zero
    }

    /// The number below which a fraction `q` (0 to 1) of all numbers lies; `None` when there are none.
    ///
    /// Between two neighbours by linear interpolation, as numpy's default and the tables do it (definition 7 of
    /// Hyndman and Fan 1996). Both neighbours are known within 1 %, and so is what lies between two of one sign.
    pub fn quantile(&self, q: f64) -> Option<f64> {
        let rank = q.clamp(0.0, 1.0) * self.count().checked_sub(1)? as f64;
        let (lower, upper) = (rank.floor() as u64, rank.ceil() as u64);
        let mut seen = 0;
        let mut below = None;
        self.bins().find_map(|(value, count)| {
            seen += count;
            if seen > lower {
                below.get_or_insert(value);
            }
            below.filter(|_| seen > upper).map(|below| below + (value - below) * rank.fract())
        })
    }

    /// Midpoints and counts of all bins that are not empty, in rising order of midpoints.
    pub fn bins(&self) -> impl Iterator<Item = (f64, u64)> + '_ {
        let negative = self.negative.iter().rev().map(|(key, count)| (-bins::middle(key), count));
        let zero = (self.zero > 0).then_some((0.0, self.zero));
        let positive = self.positive.iter().map(|(key, count)| (bins::middle(key), count));
        negative.chain(zero).chain(positive)
    }

    /// How many numbers lie below `x`, for drawing: numbers within one bin count as spread evenly over it, so
    /// the answer may be a fraction.
    pub fn count_below(&self, x: f64) -> f64 {
        let part = |lower: f64, upper: f64| ((x - lower) / (upper - lower)).clamp(0.0, 1.0);
        let negative = self.negative.iter().map(|(key, count)| {
            let (lower, upper) = bins::range(key);
            count as f64 * part(-upper, -lower)
        });
        let zero = if x > 0.0 { self.zero as f64 } else { 0.0 };
        let positive = self.positive.iter().map(|(key, count)| {
            let (lower, upper) = bins::range(key);
            count as f64 * part(lower, upper)
        });
        negative.sum::<f64>() + zero + positive.sum::<f64>()
    }

    /// The share of all numbers, 0 to 1, that lies below `x`; `None` when there are none.
    pub fn fraction_below(&self, x: f64) -> Option<f64> {
        let count = self.count();
        (count > 0).then(|| self.count_below(x) / count as f64)
    }

    /// How many numbers lie between each edge and the next (lower edge included, upper one not), for
    /// drawing; `edges` must rise. One bar fewer than edges; counts may be fractions.
    pub fn histogram(&self, edges: &[f64]) -> Vec<f64> {
        edges
            .windows(2)
            .map(|pair| (self.count_below(pair[1]) - self.count_below(pair[0])).max(0.0))
            .collect()
    }

    /// The compact form that is stored and sent: usually two bytes per bin that is not empty.
    pub fn to_bytes(&self) -> Vec<u8> {
        packed::pack(self)
    }

    /// Reads the compact form back.
    ///
    /// # Errors
    /// When the bytes are not a sketch; they may come from anyone.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PackedError> {
        packed::unpack(bytes)
    }
}

impl Merge for Sketch {
    fn merge(&mut self, other: &Self) {
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
