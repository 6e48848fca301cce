//! Difference of two means, with its interval.

use peernet_statistics::Moments;
use peernet_statistics::number::Estimate;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::batches::{MAX_BATCHES, MIN_BATCH_VALUES, Series};

/// Minimum number of values that each run needs for an interval.
pub const MIN_VALUES: usize = 30;

/// Minimum number of batches that each of the two means needs for an interval.
pub const MIN_BATCHES: usize = 5;

/// Difference with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Second value minus the first.
    pub value: f64,
    /// Ends of the interval; `None` if there are too few values.
    pub interval: Option<(f64, f64)>,
}

impl Difference {
    /// Returns the second mean minus the first.
    ///
    /// The interval is Welch's for unequal variances (Biometrika 34, 1947). Its width is computed from the means of
    /// batches, but its middle is the difference of the means of all values. The mean of the batch means would differ a
    /// little, because batches may differ in length.
    pub fn between_means(first: &MeanEstimate, second: &MeanEstimate) -> Self {
        let value = second.mean - first.mean;
        let half_width = first.variance().zip(second.variance()).and_then(|(a, b)| half_width(&a, &b));
        Self { value, interval: half_width.map(|half_width| (value - half_width, value + half_width)) }
    }

    /// Returns half the width of the interval; `None` if there is no interval.
    pub fn margin(self) -> Option<f64> {
        self.interval.map(|(lo, hi)| (hi - lo) / 2.0)
    }

    /// Returns the value and the two ends of the interval.
    pub(super) fn value_and_ends(self) -> [Option<f64>; 3] {
        [Some(self.value), self.interval.map(|ends| ends.0), self.interval.map(|ends| ends.1)]
    }

    /// Returns the difference and its interval with their signs, in ms.
    pub fn texts(self, decimals: usize) -> (String, Option<String>) {
        let interval = self.interval.unwrap_or((self.value, self.value));
        let estimate = Estimate::new(self.value, interval).with_decimals(decimals);
        (estimate.signed(), self.interval.map(|_| estimate.signed_interval()))
    }

    /// Returns whether the interval excludes zero, so that the difference is more than chance; `None` if there is no
    /// interval.
    pub fn is_distinct(&self) -> Option<bool> {
        self.interval.map(|(lo, hi)| lo > 0.0 || hi < 0.0)
    }
}

/// Mean of a quantity over all runs of a configuration, with the batch means that determine its precision.
#[derive(Clone, Debug, PartialEq)]
pub struct MeanEstimate {
    mean: f64,
    /// `true` if each run with values has [enough values](have_enough_values) for an interval.
    has_enough_values: bool,
    /// Means of batches; empty if a run has too few values.
    batches: Vec<f64>,
}

impl MeanEstimate {
    /// Returns the estimate from the values of each run, in the order in which they were measured. `None` without
    /// values.
    pub fn from_values(runs: &[Vec<f64>]) -> Option<Self> {
        Self::from_series(runs.iter().map(Vec::as_slice))
    }

    /// Returns the estimate of a mean over all values. Its precision is computed from the stored buckets of each run
    /// that has values, in order of time. A bucket is the count and the mean of its values. The buckets may cover only
    /// a part of the values, because retention deletes buckets before it deletes the mean. If all buckets of a run are
    /// deleted, the precision is unknown.
    pub fn from_buckets(mean: f64, runs: &[Vec<(u64, f64)>]) -> Self {
        let has_run_without_buckets = runs.iter().any(|run| run.as_slice().total_count() == 0);
        let estimate = Self::from_series(runs.iter().map(Vec::as_slice)).filter(|_| !has_run_without_buckets);
        let unknown = Self { mean, has_enough_values: false, batches: Vec::new() };
        estimate.map_or(unknown, |estimate| Self { mean, ..estimate })
    }

    fn from_series<'a, S: Series + ?Sized + 'a>(runs: impl Iterator<Item = &'a S> + Clone) -> Option<Self> {
        let runs_with_values = runs.filter(|run| run.total_count() > 0);
        let (mut count, mut sum) = (0, 0.0);
        for run in runs_with_values.clone() {
            count += run.total_count();
            sum += (0..run.bucket_count()).map(|bucket| run.sum(bucket)).sum::<f64>();
        }
        (count > 0).then_some(())?;
        let has_enough_values = have_enough_values(runs_with_values.clone().map(S::total_count));
        let batches = runs_with_values.filter(|_| has_enough_values).flat_map(batch_means).collect();
        Some(Self { mean: sum / count as f64, has_enough_values, batches })
    }

    /// Returns the mean of all values.
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Returns whether each run with values has [`MIN_VALUES`] or more.
    pub(super) fn has_enough_values(&self) -> bool {
        self.has_enough_values
    }

    /// Returns the number of batches from which the interval of a difference is computed.
    pub fn batch_count(&self) -> usize {
        self.batches.len()
    }

    /// Returns the variance of the mean, computed from the batch means; `None` if there are too few batches.
    fn variance(&self) -> Option<MeanVariance> {
        let moments: Moments = self.batches.iter().copied().collect();
        let count = moments.count as f64;
        let variance = moments.variance().filter(|_| moments.count >= MIN_BATCHES as u64)? / count;
        Some(MeanVariance { variance, degrees_of_freedom: count - 1.0 })
    }
}

/// Returns whether each run has enough values for an interval, from the number of values of each run. Runs without
/// values are ignored.
pub(super) fn have_enough_values(counts: impl IntoIterator<Item = u64>) -> bool {
    counts.into_iter().all(|count| count == 0 || count >= MIN_VALUES as u64)
}

/// Returns the means of the batches of a run: at most 30 batches with at least ten values each. A run of fewer than 50
/// values is split into five batches, which are shorter than ten values.
fn batch_means<S: Series + ?Sized>(run: &S) -> Vec<f64> {
    let batches = (run.total_count() / MIN_BATCH_VALUES).clamp(MIN_BATCHES as u64, MAX_BATCHES);
    run.split_evenly(batches).into_iter().filter_map(|range| run.mean(range)).collect()
}

/// Variance of a mean, with its degrees of freedom.
struct MeanVariance {
    variance: f64,
    degrees_of_freedom: f64,
}

/// Returns half the width of the 95 % interval of the difference of two means.
fn half_width(a: &MeanVariance, b: &MeanVariance) -> Option<f64> {
    let variance = a.variance + b.variance;
    // Constant values have no variance. The formula below would divide zero by zero.
    if variance <= 0.0 {
        return Some(0.0);
    }
    // Welch's approximation of the degrees of freedom.
    let degrees_of_freedom = variance.powi(2)
        / (a.variance.powi(2) / a.degrees_of_freedom + b.variance.powi(2) / b.degrees_of_freedom);
    Some(StudentsT::new(0.0, 1.0, degrees_of_freedom).ok()?.inverse_cdf(0.975) * variance.sqrt())
}

#[cfg(test)]
mod tests {
    use super::super::testing::autocorrelated_values;
    use super::*;

    fn mean_estimate(runs: &[Vec<f64>]) -> MeanEstimate {
        MeanEstimate::from_values(runs).expect("values")
    }

    /// The expected values were calculated by hand: variances of the means 0.5 and 0.583, 8.989 degrees of freedom, so
    /// 2.5 ± 2.26255 × 1.04083.
    #[test]
    fn interval_is_that_of_welch() {
        let estimate = |values: &[f64]| MeanEstimate {
            mean: values.iter().sum::<f64>() / values.len() as f64,
            has_enough_values: true,
            batches: values.to_vec(),
        };
        let (first, second) =
            (estimate(&[1.0, 2.0, 3.0, 4.0, 5.0]), estimate(&[3.0, 5.0, 4.0, 6.0, 7.0, 8.0]));
        let difference = Difference::between_means(&first, &second);
        assert!((difference.value - 2.5).abs() < 1e-12 && difference.is_distinct() == Some(true));
        let (lo, hi) = difference.interval.expect("enough batches");
        assert!((lo - 0.145_05).abs() < 1e-4 && (hi - 4.854_95).abs() < 1e-4, "{lo} {hi}");
    }

    #[test]
    fn interval_contains_truth_as_often_as_it_says() {
        for (count, correlation) in [(30, 0.0), (300, 0.0), (300, 0.6), (4_000, 0.6)] {
            let contains = |seed: &u64| {
                let [a, b] = [(10.0, 2 * seed), (10.5, 2 * seed + 1)].map(|(mean, seed)| {
                    mean_estimate(&[autocorrelated_values(correlation, count, mean, seed)])
                });
                let (lo, hi) = Difference::between_means(&a, &b).interval.expect("enough values");
                lo <= 0.5 && 0.5 <= hi
            };
            let percent = (0..400_u64).filter(contains).count() / 4;
            assert!(
                (89..=99).contains(&percent),
                "{percent} % of the intervals of {count} values with correlation {correlation} contain the truth"
            );
        }
    }

    #[test]
    fn buckets_give_same_interval_as_values() {
        let runs = [autocorrelated_values(0.6, 3_000, 10.0, 1), autocorrelated_values(0.6, 1_000, 10.1, 2)];
        let buckets = runs.clone().map(|values| {
            let mean = |bucket: &[f64]| bucket.iter().sum::<f64>() / bucket.len() as f64;
            values.chunks(25).map(|bucket| (bucket.len() as u64, mean(bucket))).collect::<Vec<_>>()
        });
        let estimate_from = |buckets: &Vec<(u64, f64)>| {
            let (count, sum) = buckets
                .iter()
                .fold((0, 0.0), |(count, sum), (values, mean)| (count + values, sum + *values as f64 * mean));
            MeanEstimate::from_buckets(sum / count as f64, std::slice::from_ref(buckets))
        };
        let exact = Difference::between_means(&mean_estimate(&runs[..1]), &mean_estimate(&runs[1..]));
        let stored = Difference::between_means(&estimate_from(&buckets[0]), &estimate_from(&buckets[1]));
        assert!((exact.value - stored.value).abs() < 1e-9);
        let [exact, stored] = [exact, stored].map(|found| found.margin().expect("enough values"));
        assert!((exact / stored - 1.0).abs() < 0.1, "{exact} {stored}");
    }

    #[test]
    fn run_of_few_values_has_no_interval() {
        let long = autocorrelated_values(0.0, 300, 1.0, 1);
        for runs in [vec![vec![1.0; 29]], vec![long.clone(), vec![1.0; 29]]] {
            let found =
                Difference::between_means(&mean_estimate(std::slice::from_ref(&long)), &mean_estimate(&runs));
            assert_eq!((found.interval, found.is_distinct()), (None, None));
        }
        let with_empty = mean_estimate(&[long.clone(), Vec::new()]);
        assert_eq!(
            with_empty,
            mean_estimate(std::slice::from_ref(&long)),
            "a run without values does not change the estimate"
        );
        assert_eq!(MeanEstimate::from_values(&[Vec::new()]), None);
        let few_buckets = MeanEstimate::from_buckets(1.0, &[vec![(100, 1.0); 4]]);
        assert_eq!((few_buckets.batch_count(), few_buckets.mean()), (4, 1.0));
        assert_eq!(Difference::between_means(&few_buckets, &few_buckets).interval, None);
    }

    #[test]
    fn difference_of_means_survives_deleted_buckets() {
        let buckets = |mean: f64| (0..10).map(|index| (10, mean + f64::from(index % 3))).collect::<Vec<_>>();
        // The deleted first half of the second run was faster than the rest.
        let (first, second) = (
            MeanEstimate::from_buckets(16.0, &[buckets(15.0)]),
            MeanEstimate::from_buckets(20.0, &[buckets(22.0)]),
        );
        let found = Difference::between_means(&first, &second);
        let (lo, hi) = found.interval.expect("enough buckets");
        assert_eq!(found.value, 4.0);
        assert!(((lo + hi) / 2.0 - 4.0).abs() < 1e-9);
        let without_buckets = MeanEstimate::from_buckets(20.0, &[buckets(22.0), Vec::new()]);
        let found = Difference::between_means(&first, &without_buckets);
        assert_eq!((found.value, found.interval), (4.0, None));
    }

    #[test]
    fn equal_values_have_zero_difference() {
        let same = mean_estimate(&[vec![2.0; 40]]);
        let found = Difference::between_means(&same, &same);
        assert_eq!((found.interval, found.is_distinct()), (Some((0.0, 0.0)), Some(false)));
    }
}
