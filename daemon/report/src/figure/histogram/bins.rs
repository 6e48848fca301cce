//! How values are counted into bins.

use crate::order::Ordered;

/// Fewest and most bins.
const FEWEST: usize = 8;
const MOST: usize = 60;
/// With fewer values an outlier is as much a part of the picture as any other.
const ENOUGH_TO_CUT: usize = 20;
/// Which share of the values always lies within the bins, at each end.
const KEPT: f64 = 0.995;
/// An end is cut where that makes the rest so much wider.
const WORTH: f64 = 1.5;

/// Counted values.
#[derive(Clone, Debug, PartialEq)]
pub struct Bins {
    /// Where the first bin begins.
    pub from: f64,
    /// How wide each is.
    pub width: f64,
    /// How many values are in each; a value on a border is in the upper one, the largest in the last.
    pub counts: Vec<u64>,
    /// How many are below the first and above the last.
    pub beyond: (u64, u64),
}

impl Bins {
    /// Bins of the width of Freedman and Diaconis (1981), twice the interquartile range over the cube root of the
    /// count, between 8 and 60 of them. A tail of less than 0.5 % that would squeeze the rest stays outside. `None`
    /// without a finite value.
    pub fn of(values: &Ordered) -> Option<Self> {
        let finite: Ordered = values.values().iter().copied().filter(|value| value.is_finite()).collect();
        let (lo, hi) = range(&finite)?;
        let n = finite.len() as f64;
        let middle_half = finite.quantile(0.75)? - finite.quantile(0.25)?;
        let count = if lo == hi {
            1
        } else {
            let bins = (hi - lo) / (2.0 * middle_half / n.cbrt());
            // All but a few values equal: there is no width to go by.
            if bins.is_finite() { (bins.ceil() as usize).clamp(FEWEST, MOST) } else { MOST }
        };
        let width = if lo == hi { lo.abs().max(f64::MIN_POSITIVE) / 50.0 } else { (hi - lo) / count as f64 };
        let from = if lo == hi { lo - width / 2.0 } else { lo };
        let mut this = Self { from, width, counts: vec![0; count], beyond: (0, 0) };
        for value in finite.values() {
            if *value < lo {
                this.beyond.0 += 1;
            } else if *value > hi {
                this.beyond.1 += 1;
            } else {
                let bin = ((value - from) / width) as usize;
                this.counts[bin.min(count - 1)] += 1;
            }
        }
        Some(this)
    }

    /// Where the last bin ends.
    pub fn to(&self) -> f64 {
        self.from + self.width * self.counts.len() as f64
    }

    /// Where a bin begins and ends.
    pub fn bin(&self, number: usize) -> (f64, f64) {
        let edge = |number: usize| self.from + self.width * number as f64;
        (edge(number), edge(number + 1))
    }

    /// How many values are in the fullest bin.
    pub fn highest(&self) -> u64 {
        self.counts.iter().copied().max().unwrap_or_default()
    }
}

/// What a picture of the values shows: all of them, but for a tail of less than 0.5 % that would squeeze the rest.
/// `None` without values.
pub(in crate::figure) fn range(values: &Ordered) -> Option<(f64, f64)> {
    let values = values.values();
    let (lo, hi) = (*values.first()?, *values.last()?);
    if values.len() < ENOUGH_TO_CUT {
        return Some((lo, hi));
    }
    // Ranks, not interpolated quantiles: those would be pulled by the very value that is to be cut.
    let rank = (KEPT * (values.len() - 1) as f64).floor() as usize;
    let (low, high) = (values[values.len() - 1 - rank], values[rank]);
    let top = if hi - low > WORTH * (high - low) { high } else { hi };
    let bottom = if top - lo > WORTH * (top - low) { low } else { lo };
    Some((bottom, top))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bins(values: impl IntoIterator<Item = f64>) -> Option<Bins> {
        Bins::of(&values.into_iter().collect())
    }

    #[test]
    fn an_even_spread_fills_all_bins_alike() {
        let bins = bins((0..1000).map(f64::from)).expect("there are values");
        // 999 / (2 · 499.5 / 10).
        assert_eq!((bins.counts.len(), bins.from, bins.to()), (10, 0.0, 999.0));
        assert_eq!((bins.counts.iter().sum::<u64>(), bins.beyond), (1000, (0, 0)));
        assert!(bins.counts.iter().all(|count| (99..=101).contains(count)), "{bins:?}");
    }

    #[test]
    fn a_tail_that_would_squeeze_the_rest_is_counted_outside() {
        let tail = bins((0..1000).map(f64::from).chain([1e5, 2e6, -7e5])).expect("there are values");
        assert_eq!(tail.beyond, (6, 6), "the largest half per cent");
        assert_eq!(tail.beyond.0 + tail.beyond.1 + tail.counts.iter().sum::<u64>(), 1003);
        assert!(tail.from >= 0.0 && tail.to() < 1000.0, "{tail:?}");
        let normal = bins((0..1000).map(|i| (f64::from(i) / 500.0 - 1.0).powi(3))).expect("there are values");
        assert_eq!(normal.beyond, (0, 0), "nothing is cut that can be shown");
        let few = bins([1.0, 1.1, 1.2, 90.0]).expect("there are values");
        assert_eq!((few.beyond, few.counts[0]), ((0, 0), 3));
    }

    #[test]
    fn odd_values_have_bins_as_well() {
        assert_eq!(bins([]), None);
        assert_eq!(bins([f64::NAN, f64::INFINITY]), None);
        for value in [0.0, -3.0, 1e-9, 7.0] {
            let same = bins([value; 40]).expect("there are values");
            assert_eq!(same.counts, [40]);
            assert!(same.from <= value && value <= same.to() && same.width > 0.0, "{same:?}");
        }
        let mostly = bins(std::iter::repeat_n(1.0, 97).chain([0.5, 2.0, 3.0])).expect("there are values");
        assert_eq!(mostly.counts.len(), MOST);
        let negative = bins([-3.0, -2.0, -2.0, -1.0]).expect("there are values");
        assert_eq!((negative.from, negative.to(), negative.counts.iter().sum::<u64>()), (-3.0, -1.0, 4));
    }
}
