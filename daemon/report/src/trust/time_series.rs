//! A duration over the time of a run.

use std::ops::Range;

use peernet_statistics::Summary;

use crate::order::Ordered;

/// Iterations that count as a run's beginning, at least.
const BEGINNING: u64 = 20;
/// Most blocks that a run is cut into, of which the first is its beginning.
const MOST_BLOCKS: u64 = 200;
/// Batches of which the trend is found, at most: more add nothing (Schmeiser 1982).
const MOST_BATCHES: u64 = 30;
/// Least iterations of a batch.
const LEAST_BATCH: u64 = 10;
/// Change of the median between the halves, as a share of the first, that is mentioned.
const DRIFT: f64 = 0.05;
/// What makes the median of the distances from the median the standard deviation of a normal distribution.
const NORMAL: f64 = 1.4826;
/// Distances above the median, in such deviations, from which on a value is an outlier (Iglewicz and Hoaglin 1993).
const OUTLIER: f64 = 3.5;
/// The deviation is at least this share of the median: the resolution of the stored quantiles.
const FINEST: f64 = 0.01;

/// A duration over the time of a run; seconds; successful iterations only, warm-up left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimeSeries {
    /// How many values there are.
    pub count: u64,
    /// Median of all.
    pub median: f64,
    /// Mean of all.
    pub mean: f64,
    /// Medians of batches of about as many values each, in order: at most 30 of at least ten values.
    pub batches: Vec<f64>,
    /// Their means, likewise.
    pub batch_means: Vec<f64>,
    /// Median of the first half of the values and of the second.
    pub halves: Option<(f64, f64)>,
    /// The first values against the rest.
    pub beginning: Option<Beginning>,
    /// Values far above the others.
    pub outliers: Outliers,
}

/// The first values of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beginning {
    /// How many.
    pub count: u64,
    /// Their median, seconds.
    pub median: f64,
    /// The median of the rest, seconds.
    pub rest: f64,
    /// Share of the later blocks of as many values whose median is at least as high, 0 to 1.
    pub as_high: f64,
    /// How many later blocks there are.
    pub blocks: usize,
}

/// Values far above the others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outliers {
    /// From where on a value counts as one, seconds.
    pub limit: f64,
    /// How many do.
    pub count: u64,
    /// The greatest value, seconds.
    pub max: f64,
    /// What they add to the mean: their distances from the median, over the count of all values; seconds.
    pub influence: f64,
}

/// How many values there are at each place, in order of time.
trait Weights {
    fn len(&self) -> usize;
    fn weight(&self, at: usize) -> u64;
}

/// Values in order of time, singly or summed up in buckets.
trait Flow: Weights {
    fn median(&self, range: Range<usize>) -> Option<f64>;
    fn mean(&self, range: Range<usize>) -> Option<f64>;
}

impl Weights for [f64] {
    fn len(&self) -> usize {
        <[f64]>::len(self)
    }

    fn weight(&self, _at: usize) -> u64 {
        1
    }
}

impl Flow for [f64] {
    fn median(&self, range: Range<usize>) -> Option<f64> {
        self[range].iter().copied().collect::<Ordered>().median()
    }

    fn mean(&self, range: Range<usize>) -> Option<f64> {
        let values = &self[range];
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    }
}

/// Counts and means of buckets.
impl Weights for [(u64, f64)] {
    fn len(&self) -> usize {
        <[(u64, f64)]>::len(self)
    }

    fn weight(&self, at: usize) -> u64 {
        self[at].0
    }
}

impl Weights for [Summary] {
    fn len(&self) -> usize {
        <[Summary]>::len(self)
    }

    fn weight(&self, at: usize) -> u64 {
        self[at].count()
    }
}

impl Flow for [Summary] {
    fn median(&self, range: Range<usize>) -> Option<f64> {
        merged(&self[range]).quantile(0.5)
    }

    fn mean(&self, range: Range<usize>) -> Option<f64> {
        let moments = merged(&self[range]).moments;
        (moments.count > 0).then_some(moments.mean)
    }
}

impl TimeSeries {
    /// Of values in order of time. `None` without any.
    pub fn of_values(values: &[f64]) -> Option<Self> {
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        // Sorted one after the other, so that a long run needs the room of one.
        let median = finite().collect::<Ordered>().median()?;
        let deviation = finite().map(|value| (value - median).abs()).collect::<Ordered>().median()?;
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

    /// Of the summaries of buckets in order of time, quantiles within 1 %. `None` without any value.
    pub fn of_summaries(buckets: &[Summary]) -> Option<Self> {
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

    /// The change of the median from the first half to the second, as a share of the first.
    pub fn change(&self) -> Option<f64> {
        let (first, second) = self.halves?;
        Some(if first > 0.0 { second / first - 1.0 } else { 0.0 })
    }

    /// Whether that change is large enough to be mentioned, if it is more than chance: 5 %.
    pub fn has_moved(&self) -> bool {
        self.change().is_some_and(|share| share.abs() >= DRIFT)
    }

    fn over_time<F: Flow + ?Sized>(flow: &F) -> Self {
        let count = weight(flow);
        let medians = |ranges: &[Range<usize>]| -> Vec<f64> {
            ranges.iter().filter_map(|range| flow.median(range.clone())).collect()
        };
        let ranges = batches(flow);
        let (batches, batch_means) =
            (medians(&ranges), ranges.into_iter().filter_map(|range| flow.mean(range)).collect());
        let halves = match medians(&parts(flow, 2)).as_slice() {
            [first, second] => Some((*first, *second)),
            _ => None,
        };
        let blocks = parts(flow, (count / BEGINNING).min(MOST_BLOCKS));
        let beginning =
            blocks.split_first().filter(|(_, later)| !later.is_empty()).and_then(|(first, later)| {
                let median = flow.median(first.clone())?;
                let others = medians(later);
                let as_high = others.iter().filter(|other| **other >= median).count();
                Some(Beginning {
                    count: first.clone().map(|at| flow.weight(at)).sum(),
                    median,
                    rest: flow.median(first.end..flow.len())?,
                    as_high: as_high as f64 / others.len() as f64,
                    blocks: others.len(),
                })
            });
        Self { batches, batch_means, halves, beginning, ..Self::default() }
    }
}

/// The means of the batches of a course, as [`TimeSeries::batch_means`], of counts and means of buckets in order of time.
pub fn batch_means(buckets: &[(u64, f64)]) -> Vec<f64> {
    let mean = |range: Range<usize>| {
        let (count, sum) = buckets[range]
            .iter()
            .fold((0, 0.0), |(all, sum), (count, mean)| (all + count, sum + mean * *count as f64));
        (count > 0).then(|| sum / count as f64)
    };
    batches(buckets).into_iter().filter_map(mean).collect()
}

fn weight<W: Weights + ?Sized>(flow: &W) -> u64 {
    (0..flow.len()).map(|at| flow.weight(at)).sum()
}

/// At most 30 parts of at least ten values.
fn batches<W: Weights + ?Sized>(flow: &W) -> Vec<Range<usize>> {
    parts(flow, (weight(flow) / LEAST_BATCH).min(MOST_BATCHES))
}

/// Parts of about the same weight, at most so many, none empty: buckets are not divided.
fn parts<W: Weights + ?Sized>(flow: &W, parts: u64) -> Vec<Range<usize>> {
    let all = weight(flow);
    let (mut ranges, mut from, mut sum) = (Vec::new(), 0, 0);
    for at in 0..flow.len() {
        sum += flow.weight(at);
        // The end of the part that is being filled lies at this share of all.
        let end = u128::from(all) * (ranges.len() as u128 + 1);
        if u128::from(sum) * u128::from(parts) >= end && (ranges.len() as u64) < parts {
            ranges.push(from..at + 1);
            from = at + 1;
        }
    }
    ranges
}

fn merged(summaries: &[Summary]) -> Summary {
    let mut all = Summary::default();
    summaries.iter().for_each(|summary| all.merge(summary));
    all
}

fn limit(median: f64, deviation: f64) -> f64 {
    median + OUTLIER * (NORMAL * deviation).max(FINEST * median.abs())
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
    fn parts_are_of_about_the_same_weight_and_cover_everything() {
        let values = vec![1.0; 103];
        let ranges = parts(values.as_slice(), 10);
        assert_eq!((ranges.len(), ranges[0].start, ranges[9].end), (10, 0, 103));
        assert!(ranges.iter().all(|range| (10..=11).contains(&range.len())), "{ranges:?}");
        let buckets: Vec<Summary> = [5, 50, 1, 1, 1].map(|count| summary(&vec![1.0; count])).to_vec();
        assert_eq!(parts(buckets.as_slice(), 2), [0..2, 2..5]);
        assert!(parts(values.as_slice(), 0).is_empty());
    }

    #[test]
    fn values_and_their_summaries_tell_the_same() {
        // A saw tooth with a tenth that is slow, and a slow beginning.
        let value = |n: u32| {
            let slow = if n % 10 == 9 { 0.04 } else { 0.0 };
            let cold = if n < 30 { 0.02 } else { 0.0 };
            0.010 + f64::from(n % 7) * 1e-4 + slow + cold
        };
        let values: Vec<f64> = (0..1200).map(value).collect();
        let buckets: Vec<Summary> = values.chunks(20).map(summary).collect();
        let (exact, stored) = (
            TimeSeries::of_values(&values).expect("values"),
            TimeSeries::of_summaries(&buckets).expect("values"),
        );
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.025;
        assert_eq!((exact.count, stored.count, exact.outliers.max), (1200, 1200, stored.outliers.max));
        assert!(near(exact.median, stored.median) && (exact.mean - stored.mean).abs() < 1e-12);
        assert_eq!(exact.batches.len(), 30);
        let means: Vec<(u64, f64)> =
            buckets.iter().map(|bucket| (bucket.count(), bucket.moments.mean)).collect();
        let of_means = batch_means(&means);
        assert_eq!(of_means.len(), stored.batch_means.len());
        assert!(of_means.iter().zip(&stored.batch_means).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!(exact.batches.iter().zip(&stored.batches).all(|(a, b)| near(*a, *b)));
        assert_eq!(exact.outliers.count, stored.outliers.count, "{:?} {:?}", exact.outliers, stored.outliers);
        assert!(near(exact.outliers.influence, stored.outliers.influence));
        let (begun, kept) = (exact.beginning.expect("long enough"), stored.beginning.expect("long enough"));
        assert_eq!((begun.count, begun.blocks, begun.as_high), (20, 59, 0.0));
        assert!(near(begun.median, kept.median) && near(begun.rest, kept.rest), "{begun:?} {kept:?}");
    }

    #[test]
    fn a_constant_has_no_outliers_and_nothing_is_made_of_nothing() {
        let course = TimeSeries::of_values(&[0.005; 100]).expect("values");
        assert_eq!((course.outliers.count, course.outliers.influence), (0, 0.0));
        assert_eq!(TimeSeries::of_values(&[f64::NAN]), None);
        assert_eq!(TimeSeries::of_summaries(&[]), None);
    }
}
