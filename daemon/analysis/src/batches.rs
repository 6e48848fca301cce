//! Batches of consecutive values of a run.
//!
//! Consecutive latencies are correlated: a queue empties slowly, a processor stays warm. Single values are therefore
//! not independent. The means of batches are nearly independent if a batch lasts longer than the correlation (non-overlapping
//! batch means, Schmeiser, *Batch size effects in the analysis of simulation output*, Operations Research 30, 1982).

use std::ops::Range;

use peernet_statistics::Summary;

/// Maximum number of batches of a run. More batches would not improve the estimate (Schmeiser 1982).
pub(crate) const MAX_BATCHES: u64 = 30;

/// Minimum number of values in a batch.
pub(crate) const MIN_BATCH_VALUES: u64 = 10;

/// Values in order of time, grouped into buckets. A batch is a range of consecutive buckets. In a list of single values,
/// each value is a bucket.
pub(crate) trait Series {
    /// Returns the number of buckets.
    fn bucket_count(&self) -> usize;

    /// Returns the number of values in a bucket.
    fn count(&self, bucket: usize) -> u64;

    /// Returns the sum of the values in a bucket.
    fn sum(&self, bucket: usize) -> f64;

    /// Returns the number of values in all buckets.
    fn total_count(&self) -> u64 {
        (0..self.bucket_count()).map(|bucket| self.count(bucket)).sum()
    }

    /// Returns the mean of the values in a range of buckets; `None` if the range has no values.
    fn mean(&self, range: Range<usize>) -> Option<f64> {
        let add = |(count, sum): (u64, f64), bucket| (count + self.count(bucket), sum + self.sum(bucket));
        let (count, sum) = range.fold((0, 0.0), add);
        (count > 0).then(|| sum / count as f64)
    }

    /// Splits the series into at most `max_ranges` non-empty ranges of buckets, each with about the same number of values.
    /// Buckets are not divided.
    fn split_evenly(&self, max_ranges: u64) -> Vec<Range<usize>> {
        let total_count = self.total_count();
        let (mut ranges, mut start, mut count) = (Vec::new(), 0, 0);
        for bucket in 0..self.bucket_count() {
            count += self.count(bucket);
            // Range number k ends where the count reaches the share k / `max_ranges` of all values. Both sides of the
            // comparison are multiplied by `max_ranges`.
            let end = u128::from(total_count) * (ranges.len() as u128 + 1);
            if u128::from(count) * u128::from(max_ranges) >= end && (ranges.len() as u64) < max_ranges {
                ranges.push(start..bucket + 1);
                start = bucket + 1;
            }
        }
        ranges
    }
}

impl Series for [f64] {
    fn bucket_count(&self) -> usize {
        self.len()
    }

    fn count(&self, _bucket: usize) -> u64 {
        1
    }

    fn sum(&self, bucket: usize) -> f64 {
        self[bucket]
    }
}

/// Each item is a bucket: the number of its values and their mean.
impl Series for [(u64, f64)] {
    fn bucket_count(&self) -> usize {
        self.len()
    }

    fn count(&self, bucket: usize) -> u64 {
        self[bucket].0
    }

    fn sum(&self, bucket: usize) -> f64 {
        let (count, mean) = self[bucket];
        count as f64 * mean
    }
}

impl Series for [Summary] {
    fn bucket_count(&self) -> usize {
        self.len()
    }

    fn count(&self, bucket: usize) -> u64 {
        Summary::count(&self[bucket])
    }

    fn sum(&self, bucket: usize) -> f64 {
        self[bucket].moments.sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_have_similar_counts_and_cover_series() {
        let values = vec![1.0; 103];
        let ranges = values.as_slice().split_evenly(10);
        assert_eq!((ranges.len(), ranges[0].start, ranges[9].end), (10, 0, 103));
        assert!(ranges.iter().all(|range| (10..=11).contains(&range.len())), "{ranges:?}");
        let buckets = [5, 50, 1, 1, 1].map(|count| (count, 1.0));
        assert_eq!(buckets.as_slice().split_evenly(2), [0..2, 2..5]);
        assert!(values.as_slice().split_evenly(0).is_empty());
    }

    #[test]
    fn mean_weighs_buckets_by_their_counts() {
        let buckets = [(1, 4.0), (3, 8.0), (0, 100.0)];
        assert_eq!((buckets.as_slice().mean(0..2), buckets.as_slice().mean(2..3)), (Some(7.0), None));
        assert_eq!([1.0, 2.0, 6.0].as_slice().mean(0..3), Some(3.0));
    }
}
