//! Bins of a histogram.

use peernet_analysis::order::SortedValues;
use peernet_statistics::histogram::{Binning, MAX_BINS, shown_range};

/// Values counted in bins of equal width.
#[derive(Clone, Debug, PartialEq)]
pub struct Bins {
    /// Edges of the bins in ascending order, one more than there are bins.
    pub edges: Vec<f64>,
    /// Number of values in each bin. A value on the border of two bins is counted in the upper bin. A value at the
    /// upper end of the last bin is counted in the last bin.
    pub counts: Vec<u64>,
    /// Number of values below the first bin, and number of values above the last bin.
    pub beyond: (u64, u64),
}

impl Bins {
    /// Counts values into the bins of [`Binning`]. Values that are not finite are left out. `None` without a finite
    /// value.
    pub fn of(values: &SortedValues) -> Option<Self> {
        let finite: SortedValues =
            values.values().iter().copied().filter(|value| value.is_finite()).collect();
        let binning = Binning::of(finite.values(), MAX_BINS)?;
        let Binning { range: (lo, hi), from, width, count } = binning;
        let mut bins = Self { edges: binning.edges(), counts: vec![0; count], beyond: (0, 0) };
        for value in finite.values() {
            if *value < lo {
                bins.beyond.0 += 1;
            } else if *value > hi {
                bins.beyond.1 += 1;
            } else {
                let bin = ((value - from) / width) as usize;
                bins.counts[bin.min(count - 1)] += 1;
            }
        }
        Some(bins)
    }
}

/// Returns the [range of the values that are shown](shown_range) on an axis; `None` without values.
pub(in crate::drawing) fn shown_range_of(values: &SortedValues) -> Option<(f64, f64)> {
    shown_range(values.values())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bins(values: impl IntoIterator<Item = f64>) -> Option<Bins> {
        Bins::of(&values.into_iter().collect())
    }

    /// Returns the lower end of the first bin and the upper end of the last bin.
    fn ends(bins: &Bins) -> (f64, f64) {
        (bins.edges[0], bins.edges[bins.counts.len()])
    }

    #[test]
    fn uniform_values_fill_bins_evenly() {
        let bins = bins((0..1000).map(f64::from)).expect("there are values");
        // The width is twice the interquartile range, divided by the cube root of the number of values. There are
        // 999 / (2 · 499.5 / 10) bins.
        assert_eq!((bins.counts.len(), ends(&bins)), (10, (0.0, 999.0)));
        assert_eq!((bins.counts.iter().sum::<u64>(), bins.beyond), (1000, (0, 0)));
        assert!(bins.counts.iter().all(|count| (99..=101).contains(count)), "{bins:?}");
    }

    #[test]
    fn far_tail_is_counted_beyond_bins() {
        let tail = bins((0..1000).map(f64::from).chain([1e5, 2e6, -7e5])).expect("there are values");
        assert_eq!(tail.beyond, (1, 2), "the three values far from the rest are beyond the bins");
        assert_eq!(tail.beyond.0 + tail.beyond.1 + tail.counts.iter().sum::<u64>(), 1003);
        assert!(ends(&tail).0 >= 0.0 && ends(&tail).1 < 1000.0, "{tail:?}");
        let normal = bins((0..1000).map(|i| (f64::from(i) / 500.0 - 1.0).powi(3))).expect("there are values");
        assert_eq!(normal.beyond, (0, 0), "without a far tail, every value is in a bin");
        let few = bins([1.0, 1.1, 1.2, 90.0]).expect("there are values");
        assert_eq!((few.beyond, few.counts[0]), ((0, 0), 3), "fewer than eight values have no tail");
    }

    #[test]
    fn outliers_of_short_run_are_beyond_bins() {
        let run = |count: u32| (0..count).map(|i| 1.3 + f64::from(i) * 0.01);
        for count in [15, 72, 150] {
            let stalled = bins(run(count).chain([101.0])).expect("there are values");
            assert_eq!(stalled.beyond, (0, 1), "{count} values");
            assert!(ends(&stalled).1 < 3.0 && stalled.counts.iter().filter(|count| **count > 0).count() >= 4);
        }
        let three_stalls = bins(run(40).chain([37.0, 92.0, 101.0])).expect("there are values");
        assert_eq!(three_stalls.beyond, (0, 3));
        let wide = bins((1..=7).map(f64::from).chain([12.0])).expect("there are values");
        assert_eq!(wide.beyond, (0, 0), "12 is within three interquartile ranges of the quartile");
        let two_modes = bins((0..50).map(|i| if i % 5 == 0 { 9.0 } else { 1.0 + f64::from(i) / 100.0 }));
        assert_eq!(
            two_modes.expect("there are values").beyond,
            (0, 0),
            "a fifth of the values is no outlier"
        );
    }

    #[test]
    fn empty_equal_and_non_finite_values_have_valid_bins() {
        assert_eq!(bins([]), None);
        assert_eq!(bins([f64::NAN, f64::INFINITY]), None);
        for value in [0.0, -3.0, 1e-9, 7.0] {
            let equal = bins([value; 40]).expect("there are values");
            assert_eq!(equal.counts, [40]);
            let (from, to) = ends(&equal);
            assert!(from <= value && value <= to && from < to, "{equal:?}");
        }
        let mostly_equal =
            bins(std::iter::repeat_n(1.0, 97).chain([0.5, 2.0, 3.0])).expect("there are values");
        // The interquartile range is 0, so it gives no width of the bins.
        assert_eq!(mostly_equal.counts.len(), MAX_BINS);
        let negative = bins([-3.0, -2.0, -2.0, -1.0]).expect("there are values");
        assert_eq!((ends(&negative), negative.counts.iter().sum::<u64>()), ((-3.0, -1.0), 4));
    }
}
