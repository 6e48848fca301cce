//! Reduction of many values over time to the statistics of few bins.

use peernet_analysis::order::SortedValues;

/// Statistics of the values in one bin. A bin is one of the equal periods into which the time axis is divided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bin {
    /// Index of the bin, from the left.
    pub(super) index: usize,
    /// Smallest value.
    pub(super) min: f64,
    /// Median of the values.
    pub(super) median: f64,
    /// Largest value.
    pub(super) max: f64,
}

/// Divides the time between `from` and `to` evenly into `count` bins, and returns the bins that have values, from left
/// to right. Each item of `values` has a time and a value. Values that are not finite, and values whose time is
/// not between `from` and `to`, are left out.
pub(super) fn bins(values: &[(f64, f64)], (from, to): (f64, f64), count: usize) -> Vec<Bin> {
    let inside = |(at, value): &&(f64, f64)| value.is_finite() && (from..=to).contains(at);
    // A time at the end of the range belongs to the last bin.
    let bin_index =
        |at: f64| (((at - from) / (to - from) * count as f64) as usize).min(count.saturating_sub(1));
    let mut values_by_bin: Vec<(usize, f64)> =
        values.iter().filter(inside).map(|(at, value)| (bin_index(*at), *value)).collect();
    values_by_bin.sort_by_key(|(index, _)| *index);
    let bin = |group: &[(usize, f64)]| {
        let values: SortedValues = group.iter().map(|(_, value)| *value).collect();
        let (min, max) = (*values.values().first()?, *values.values().last()?);
        Some(Bin { index: group[0].0, min, median: values.median()?, max })
    };
    values_by_bin.chunk_by(|a, b| a.0 == b.0).filter_map(bin).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bin_keeps_extremes_of_many_values() {
        let mut values: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i), f64::from(i % 7))).collect();
        values[55_555].1 = 1000.0;
        values[70_000].1 = f64::NAN;
        let bins = bins(&values, (0.0, 99_999.0), 300);
        assert_eq!(bins.len(), 300);
        let highest = bins.iter().max_by(|a, b| a.max.total_cmp(&b.max)).expect("there are bins");
        assert_eq!((highest.index, highest.max, highest.median), (166, 1000.0, 3.0));
        assert!(bins.iter().all(|bin| bin.min == 0.0));
    }

    #[test]
    fn gap_in_time_has_no_bins() {
        let values = [(0.0, 1.0), (1.0, 2.0), (9.0, 3.0), (10.0, 4.0), (11.0, 5.0)];
        let indexes: Vec<usize> = bins(&values, (0.0, 10.0), 10).iter().map(|bin| bin.index).collect();
        assert_eq!(indexes, [0, 1, 9]);
    }
}
