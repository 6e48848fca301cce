//! Numbers of values in logarithmic bins. All bins between the lowest and the highest bin in use are stored, also the
//! empty bins.

use super::Sketch;

/// Maximum number of bins for numbers of one sign. If more bins would be needed, the lowest bins are
/// merged into one.
pub(super) const MAX_BINS_PER_SIGN: usize = 2048;

/// Ratio of the upper to the lower end of a bin.
const GAMMA: f64 = (1.0 + Sketch::RELATIVE_ERROR) / (1.0 - Sketch::RELATIVE_ERROR);
/// ln(γ) = 2 artanh(1 %), as a literal because logarithms cannot be computed in constants.
const LN_GAMMA: f64 = 0.020_000_666_706_669_524;
const PER_LN_GAMMA: f64 = 1.0 / LN_GAMMA;

/// Range that contains the keys of all numbers from [`Sketch::MIN_MAGNITUDE`] to the largest finite number, with a
/// margin for rounding.
pub(super) const VALID_KEYS: std::ops::RangeInclusive<i32> = -1_200..=35_600;

/// Returns the key of the bin of a finite magnitude.
#[inline]
pub(super) fn key(magnitude: f64) -> i32 {
    (magnitude.ln() * PER_LN_GAMMA).ceil() as i32
}

/// Returns the lower and upper end of a bin; the upper end belongs to the bin.
pub(super) fn range(key: i32) -> (f64, f64) {
    let upper = (f64::from(key) * LN_GAMMA).exp();
    (upper / GAMMA, upper)
}

/// Returns the number that represents a bin: its relative distance to both ends is the same.
pub(super) fn middle(key: i32) -> f64 {
    let (lower, _) = range(key);
    lower * (1.0 + Sketch::RELATIVE_ERROR)
}

/// Bins with their counts: `counts[i]` belongs to the key `lowest_key + i`.
#[derive(Clone, Debug, Default)]
pub(super) struct Bins {
    lowest_key: i32,
    counts: Vec<u64>,
    total: u64,
}

impl Bins {
    #[inline]
    pub(super) fn add(&mut self, key: i32, count: u64) {
        let index = i64::from(key) - i64::from(self.lowest_key);
        match usize::try_from(index).ok().and_then(|index| self.counts.get_mut(index)) {
            Some(bin) => *bin += count,
            None => self.add_outside_range(key, count),
        }
        self.total += count;
    }

    /// Adds a count for a key outside of the stored range.
    #[cold]
    fn add_outside_range(&mut self, key: i32, count: u64) {
        self.extend_range(key, key);
        // A key below the stored range is counted in the lowest bin.
        let index = (key.max(self.lowest_key) - self.lowest_key) as usize;
        self.counts[index] += count;
    }

    pub(super) fn merge(&mut self, other: &Self) {
        let Some(highest) = other.highest_key() else { return };
        self.extend_range(other.lowest_key, highest);
        // Bins of the other sketch below the stored range are added to the lowest bin.
        let bins_below =
            usize::try_from(self.lowest_key - other.lowest_key).unwrap_or(0).min(other.counts.len());
        let (collapsed, rest) = other.counts.split_at(bins_below);
        self.counts[0] += collapsed.iter().sum::<u64>();
        let offset = usize::try_from(other.lowest_key - self.lowest_key).unwrap_or(0);
        for (bin, count) in self.counts[offset..].iter_mut().zip(rest) {
            *bin += count;
        }
        self.total += other.total;
    }

    pub(super) const fn count(&self) -> u64 {
        self.total
    }

    /// Iterates over the bins that are not empty, lowest key first.
    pub(super) fn iter(&self) -> impl DoubleEndedIterator<Item = (i32, u64)> + '_ {
        let with_keys =
            self.counts.iter().enumerate().map(|(index, count)| (self.lowest_key + index as i32, *count));
        with_keys.filter(|(_, count)| *count > 0)
    }

    fn highest_key(&self) -> Option<i32> {
        Some(self.lowest_key + i32::try_from(self.counts.len()).ok()? - 1).filter(|_| !self.counts.is_empty())
    }

    /// Extends the stored range to the keys `low..=high`. If the range would have more than [`MAX_BINS_PER_SIGN`] bins,
    /// its lowest bins are merged into one.
    fn extend_range(&mut self, low: i32, high: i32) {
        let (lowest, highest) = match self.highest_key() {
            None => (low, high),
            Some(highest) => (self.lowest_key.min(low), highest.max(high)),
        };
        let lowest = lowest.max(highest - (MAX_BINS_PER_SIGN as i32 - 1));
        if self.counts.is_empty() {
            self.lowest_key = lowest;
        } else if lowest > self.lowest_key {
            // The lowest bins are merged, because the error of the largest quantiles must stay bounded.
            let collapsed_bins = ((lowest - self.lowest_key) as usize).min(self.counts.len());
            let sum: u64 = self.counts.drain(..collapsed_bins).sum();
            self.lowest_key = lowest;
            // If all bins were merged, none is left, but their sum needs a bin.
            self.counts.resize(self.counts.len().max(1), 0);
            self.counts[0] += sum;
        } else if lowest < self.lowest_key {
            let added = (self.lowest_key - lowest) as usize;
            self.counts.splice(..0, std::iter::repeat_n(0, added));
            self.lowest_key = lowest;
        }
        self.counts.resize((highest - self.lowest_key) as usize + 1, 0);
    }
}

/// Compares the counts of the bins that are not empty. The stored range is ignored.
impl PartialEq for Bins {
    fn eq(&self, other: &Self) -> bool {
        self.total == other.total && self.iter().eq(other.iter())
    }
}
