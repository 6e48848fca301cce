//! Statistics of a duration over the time of a run.

use std::ops::Range;

use peernet_statistics::Summary;

use crate::batches::{MAX_BATCHES, MIN_BATCH_VALUES, Series};
use crate::order::SortedValues;

/// Minimum number of iterations in the beginning of a run.
const MIN_BEGINNING_VALUES: u64 = 20;
/// Maximum number of blocks of a run. The first block is its beginning.
const MAX_BLOCKS: u64 = 200;
/// Minimum change of the median between the halves, as a share of the first, that is mentioned.
pub(super) const MIN_NOTABLE_CHANGE: f64 = 0.05;
/// Standard deviation of a normal distribution divided by its median absolute deviation (MAD).
const MAD_TO_STD: f64 = 1.4826;
/// Distance above the median, in deviations computed from the MAD, above which a value is an outlier (Iglewicz and Hoaglin 1993).
const OUTLIER_DEVIATIONS: f64 = 3.5;
/// Minimum deviation, as a share of the median: the resolution of the stored quantiles.
const MIN_RELATIVE_DEVIATION: f64 = 0.01;

/// Statistics of a duration over the time of a run; seconds; successful iterations only, warm-up left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimeSeries {
    /// Number of values.
    pub count: u64,
    /// Median of all.
    pub median: f64,
    /// Mean of all.
    pub mean: f64,
    /// Medians of batches of about as many values each, in order: at most 30 of at least ten values.
    pub batches: Vec<f64>,
    /// Median of the first half of the values and of the second.
    pub halves: Option<(f64, f64)>,
    /// Comparison of the first values with the rest.
    pub beginning: Option<Beginning>,
    /// Values far above the others.
    pub outliers: Outliers,
}

/// The first values of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beginning {
    /// Number of values.
    pub count: u64,
    /// Their median, seconds.
    pub median: f64,
    /// The median of the rest, seconds.
    pub rest: f64,
    /// Share of the later blocks of equal size whose median is at least as high, 0 to 1.
    pub share_as_high: f64,
    /// Number of later blocks.
    pub blocks: usize,
}

/// Values far above the others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outliers {
    /// Limit above which a value counts as an outlier, seconds.
    pub limit: f64,
    /// Number of outliers.
    pub count: u64,
    /// The greatest value, seconds.
    pub max: f64,
    /// Contribution of the outliers to the mean: the sum of their distances from the median, divided by the count of all values; seconds.
    pub influence: f64,
}

/// Series with medians of its parts.
trait Medians: Series {
    fn median(&self, range: Range<usize>) -> Option<f64>;
}

impl Medians for [f64] {
    fn median(&self, range: Range<usize>) -> Option<f64> {
        self[range].iter().copied().collect::<SortedValues>().median()
    }
}

impl Medians for [Summary] {
    fn median(&self, range: Range<usize>) -> Option<f64> {
        merged(&self[range]).quantile(0.5)
    }
}

impl TimeSeries {
    /// Returns the statistics of values in order of time; `None` without any.
    pub fn from_values(values: &[f64]) -> Option<Self> {
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        // They are sorted one after the other, so that a long run needs memory for only one sorted copy.
        let median = finite().collect::<SortedValues>().median()?;
        let deviation = finite().map(|value| (value - median).abs()).collect::<SortedValues>().median()?;
        let limit = limit(median, deviation);
        let beyond = finite().filter(|value| *value > limit);
        let count = finite().count() as u64;
        let outliers = Outliers {
            limit,
            count: beyond.clone().count() as u64,
            max: finite().reduce(f64::max)?,
            influence: beyond.map(|value| value - median).sum::<f64>() / count as f64,
        };
        let mean = finite().sum::<f64>() / count as f64;
        let over_time = if count == values.len() as u64 {
            Self::over_time(values)
        } else {
            Self::over_time(finite().collect::<Vec<f64>>().as_slice())
        };
        Some(Self { count, median, mean, outliers, ..over_time })
    }

    /// Returns the statistics of the summaries of buckets in order of time, quantiles within 1 %; `None` without any value.
    pub fn from_summaries(buckets: &[Summary]) -> Option<Self> {
        let all = merged(buckets);
        let (median, max) = (all.quantile(0.5)?, all.moments.max);
        let mut distances: Vec<(f64, u64)> =
            all.sketch.bins().map(|(value, count)| ((value - median).abs(), count)).collect();
        distances.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let half = all.count().div_ceil(2);
        let mut nearer = 0;
        let deviation = distances.iter().find_map(|(distance, count)| {
            nearer += count;
            (nearer >= half).then_some(*distance)
        });
        let limit = limit(median, deviation?);
        let beyond = all.sketch.bins().filter(|(value, _)| *value > limit);
        let (count, sum) = beyond
            .fold((0, 0.0), |(n, sum), (value, count)| (n + count, sum + (value - median) * count as f64));
        let outliers = Outliers { limit, count, max, influence: sum / all.count() as f64 };
        let (count, mean) = (all.count(), all.moments.mean);
        Some(Self { count, median, mean, outliers, ..Self::over_time(buckets) })
    }

    /// Returns the change of the median from the first half to the second, as a share of the first.
    pub fn change(&self) -> Option<f64> {
        let (first, second) = self.halves?;
        Some(if first > 0.0 { second / first - 1.0 } else { 0.0 })
    }

    /// Returns whether that change is large enough to be mentioned, if it is more than chance: 5 %.
    pub fn has_notable_change(&self) -> bool {
        self.change().is_some_and(|share| share.abs() >= MIN_NOTABLE_CHANGE)
    }

    fn over_time<S: Medians + ?Sized>(series: &S) -> Self {
        let count = series.total_count();
        let medians = |ranges: &[Range<usize>]| -> Vec<f64> {
            ranges.iter().filter_map(|range| series.median(range.clone())).collect()
        };
        let batches = medians(&series.parts((count / MIN_BATCH_VALUES).min(MAX_BATCHES)));
        let halves = match medians(&series.parts(2)).as_slice() {
            [first, second] => Some((*first, *second)),
            _ => None,
        };
        let blocks = series.parts((count / MIN_BEGINNING_VALUES).min(MAX_BLOCKS));
        let beginning =
            blocks.split_first().filter(|(_, later)| !later.is_empty()).and_then(|(first, later)| {
                let median = series.median(first.clone())?;
                let others = medians(later);
                let share_as_high = others.iter().filter(|other| **other >= median).count();
                Some(Beginning {
                    count: first.clone().map(|at| series.count(at)).sum(),
                    median,
                    rest: series.median(first.end..series.bucket_count())?,
                    share_as_high: share_as_high as f64 / others.len() as f64,
                    blocks: others.len(),
                })
            });
        Self { batches, halves, beginning, ..Self::default() }
    }
}

fn merged(summaries: &[Summary]) -> Summary {
    let mut all = Summary::default();
    summaries.iter().for_each(|summary| all.merge(summary));
    all
}

fn limit(median: f64, deviation: f64) -> f64 {
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
        // The values are a saw tooth with a tenth of slow values, and a slow beginning.
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
        let (begun, kept) = (exact.beginning.expect("long enough"), stored.beginning.expect("long enough"));
        assert_eq!((begun.count, begun.blocks, begun.share_as_high), (20, 59, 0.0));
        assert!(near(begun.median, kept.median) && near(begun.rest, kept.rest), "{begun:?} {kept:?}");
    }

    #[test]
    fn constant_has_no_outliers() {
        let course = TimeSeries::from_values(&[0.005; 100]).expect("values");
        assert_eq!((course.outliers.count, course.outliers.influence), (0, 0.0));
        assert_eq!(TimeSeries::from_values(&[f64::NAN]), None);
        assert_eq!(TimeSeries::from_summaries(&[]), None);
    }
}
