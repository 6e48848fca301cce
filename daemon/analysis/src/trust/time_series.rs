//! Statistics of a duration over the time of a run.

use std::ops::Range;

use peernet_statistics::Summary;

use crate::batches::{MAX_BATCHES, MIN_BATCH_VALUES, Series};
use crate::order::{SortedValues, weighted_median};

/// Minimum number of iterations in a block. The first block is the beginning of the run.
const MIN_BEGINNING_VALUES: u64 = 20;
/// Maximum number of blocks that a run is divided into.
const MAX_BLOCKS: u64 = 200;
/// Minimum change of the median from the first to the second half of a run that is reported, as a share of the first
/// half's median.
pub(super) const MIN_NOTABLE_CHANGE: f64 = 0.05;
/// Standard deviation of a normal distribution divided by its median absolute deviation (MAD).
const MAD_TO_STD: f64 = 1.4826;
/// A value is an outlier if it exceeds the median by more than this number of standard deviations, where the standard
/// deviation is computed from the MAD (Iglewicz and Hoaglin 1993).
const OUTLIER_DEVIATIONS: f64 = 3.5;
/// Minimum of the standard deviation that is computed from the MAD, as a share of the median: the resolution of the
/// stored quantiles.
const MIN_RELATIVE_DEVIATION: f64 = 0.01;

/// Statistics of a duration over the time of a run, in seconds. Only successful iterations that are not warm-up are
/// included.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimeSeries {
    /// Number of values.
    pub count: u64,
    /// Median of all values.
    pub median: f64,
    /// Mean of all values.
    pub mean: f64,
    /// Medians of at most 30 batches, in order of time. Batches have about the same number of values, at least ten.
    pub batches: Vec<f64>,
    /// Median of the first half and median of the second half of the values; `None` if there is no second half.
    pub halves: Option<(f64, f64)>,
    /// Comparison of the first values with the rest; `None` with fewer than 40 values.
    pub beginning: Option<Beginning>,
    /// Values far above the others.
    pub outliers: Outliers,
}

/// The first values of a run, compared with the rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beginning {
    /// Number of values in the beginning.
    pub count: u64,
    /// Median of the beginning, seconds.
    pub median: f64,
    /// Median of the rest, seconds.
    pub rest: f64,
    /// Share of the later blocks whose median is at least as high as that of the beginning, 0 to 1. A block has about
    /// as many values as the beginning.
    pub share_as_high: f64,
    /// Number of later blocks.
    pub later_block_count: usize,
}

/// Values far above the others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outliers {
    /// Limit above which a value counts as an outlier, seconds.
    pub limit: f64,
    /// Number of outliers.
    pub count: u64,
    /// Largest value, seconds.
    pub max: f64,
    /// Contribution of the outliers to the mean: the sum of their distances from the median, divided by the number of
    /// all values; seconds.
    pub influence: f64,
}

/// Series that can return the median of a range of its buckets.
trait MedianSeries: Series {
    fn median(&self, range: Range<usize>) -> Option<f64>;
}

impl MedianSeries for [f64] {
    fn median(&self, range: Range<usize>) -> Option<f64> {
        self[range].iter().copied().collect::<SortedValues>().median()
    }
}

impl MedianSeries for [Summary] {
    fn median(&self, range: Range<usize>) -> Option<f64> {
        merged(&self[range]).quantile(0.5)
    }
}

impl TimeSeries {
    /// Returns the statistics of values in order of time. `None` without finite values.
    pub fn from_values(values: &[f64]) -> Option<Self> {
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        // Values and deviations are sorted one after the other, so that a long run needs memory for only one sorted
        // copy.
        let median = finite().collect::<SortedValues>().median()?;
        let deviation = finite().map(|value| (value - median).abs()).collect::<SortedValues>().median()?;
        let limit = outlier_limit(median, deviation);
        let outlier_values = finite().filter(|value| *value > limit);
        let count = finite().count() as u64;
        let outliers = Outliers {
            limit,
            count: outlier_values.clone().count() as u64,
            max: finite().reduce(f64::max)?,
            influence: outlier_values.map(|value| value - median).sum::<f64>() / count as f64,
        };
        let mean = finite().sum::<f64>() / count as f64;
        // The values are copied only if some of them are not finite, because a long run has millions of values.
        let over_time = if count == values.len() as u64 {
            Self::over_time(values)
        } else {
            Self::over_time(finite().collect::<Vec<f64>>().as_slice())
        };
        Some(Self { count, median, mean, outliers, ..over_time })
    }

    /// Returns the statistics from the summaries of buckets, which are in order of time. Quantiles are within 1 %.
    /// `None` without values.
    pub fn from_summaries(buckets: &[Summary]) -> Option<Self> {
        let whole_run = merged(buckets);
        let (median, max) = (whole_run.quantile(0.5)?, whole_run.moments.max);
        // The median absolute deviation is the median of the distances of the sketch's bins from the median.
        let distances = whole_run.sketch.bins().map(|(value, count)| ((value - median).abs(), count));
        let limit = outlier_limit(median, weighted_median(distances.collect(), f64::total_cmp)?);
        let outlier_bins = whole_run.sketch.bins().filter(|(value, _)| *value > limit);
        let (count, sum) = outlier_bins
            .fold((0, 0.0), |(n, sum), (value, count)| (n + count, sum + (value - median) * count as f64));
        let outliers = Outliers { limit, count, max, influence: sum / whole_run.count() as f64 };
        let (count, mean) = (whole_run.count(), whole_run.moments.mean);
        Some(Self { count, median, mean, outliers, ..Self::over_time(buckets) })
    }

    /// Returns the change of the median from the first half of the run to the second, as a share of the first half's
    /// median. `None` without halves.
    pub fn change(&self) -> Option<f64> {
        let (first, second) = self.halves?;
        Some(relative_change(first, second))
    }

    /// Returns whether the median changes by at least 5 %. Such a change is reported if it is more than chance.
    pub fn has_notable_change(&self) -> bool {
        self.change().is_some_and(|share| share.abs() >= MIN_NOTABLE_CHANGE)
    }

    /// Computes the fields that depend on the order of the values. The other fields have their defaults.
    fn over_time<S: MedianSeries + ?Sized>(series: &S) -> Self {
        let count = series.total_count();
        let medians = |ranges: &[Range<usize>]| -> Vec<f64> {
            ranges.iter().filter_map(|range| series.median(range.clone())).collect()
        };
        let batches = medians(&series.split_evenly((count / MIN_BATCH_VALUES).min(MAX_BATCHES)));
        let halves = match medians(&series.split_evenly(2)).as_slice() {
            [first, second] => Some((*first, *second)),
            _ => None,
        };
        let blocks = series.split_evenly((count / MIN_BEGINNING_VALUES).min(MAX_BLOCKS));
        let beginning =
            blocks.split_first().filter(|(_, later)| !later.is_empty()).and_then(|(first, later)| {
                let median = series.median(first.clone())?;
                let later_medians = medians(later);
                let count_as_high = later_medians.iter().filter(|other| **other >= median).count();
                Some(Beginning {
                    count: first.clone().map(|bucket| series.count(bucket)).sum(),
                    median,
                    rest: series.median(first.end..series.bucket_count())?,
                    share_as_high: count_as_high as f64 / later_medians.len() as f64,
                    later_block_count: later_medians.len(),
                })
            });
        Self { batches, halves, beginning, ..Self::default() }
    }
}

/// Returns the change from `from` to `to`, as a share of `from`; 0 if `from` is not above 0.
pub(super) fn relative_change(from: f64, to: f64) -> f64 {
    if from > 0.0 { to / from - 1.0 } else { 0.0 }
}

fn merged(summaries: &[Summary]) -> Summary {
    let mut merged = Summary::default();
    summaries.iter().for_each(|summary| merged.merge(summary));
    merged
}

/// Returns the value above which a value is an outlier, from the median and the median absolute deviation.
fn outlier_limit(median: f64, deviation: f64) -> f64 {
    // If half of the values are equal, the MAD is 0, and without a minimum every larger value would be an outlier.
    median + OUTLIER_DEVIATIONS * (MAD_TO_STD * deviation).max(MIN_RELATIVE_DEVIATION * median.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(values: &[f64]) -> Summary {
        let mut summary = Summary::default();
        values.iter().for_each(|value| summary.record(*value));
        summary
    }

    #[test]
    fn values_and_summaries_give_same_statistics() {
        // The values are a saw tooth. A tenth of the values are slow, and so are the first 30 values.
        let value = |n: u32| {
            let slow = if n % 10 == 9 { 0.04 } else { 0.0 };
            let cold = if n < 30 { 0.02 } else { 0.0 };
            0.010 + f64::from(n % 7) * 1e-4 + slow + cold
        };
        let values: Vec<f64> = (0..1200).map(value).collect();
        let buckets: Vec<Summary> = values.chunks(20).map(summary).collect();
        let (exact, stored) = (
            TimeSeries::from_values(&values).expect("values"),
            TimeSeries::from_summaries(&buckets).expect("values"),
        );
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.025;
        assert_eq!((exact.count, stored.count, exact.outliers.max), (1200, 1200, stored.outliers.max));
        assert!(near(exact.median, stored.median) && (exact.mean - stored.mean).abs() < 1e-12);
        assert_eq!(exact.batches.len(), 30);
        assert!(exact.batches.iter().zip(&stored.batches).all(|(a, b)| near(*a, *b)));
        assert_eq!(exact.outliers.count, stored.outliers.count, "{:?} {:?}", exact.outliers, stored.outliers);
        assert!(near(exact.outliers.influence, stored.outliers.influence));
        let [exact, stored] = [exact, stored].map(|statistics| statistics.beginning.expect("long enough"));
        assert_eq!((exact.count, exact.later_block_count, exact.share_as_high), (20, 59, 0.0));
        assert!(near(exact.median, stored.median) && near(exact.rest, stored.rest), "{exact:?} {stored:?}");
    }

    #[test]
    fn equal_values_have_no_outliers() {
        let constant = TimeSeries::from_values(&[0.005; 100]).expect("values");
        assert_eq!((constant.outliers.count, constant.outliers.influence), (0, 0.0));
        assert_eq!(TimeSeries::from_values(&[f64::NAN]), None);
        assert_eq!(TimeSeries::from_summaries(&[]), None);
    }
}
