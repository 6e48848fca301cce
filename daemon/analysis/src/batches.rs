//! Batches of consecutive values.
//!
//! Consecutive latencies are correlated: a queue empties slowly, a processor stays warm. The means of batches that are longer than this
//! correlation are nearly independent, unlike single values (non-overlapping batch means, Schmeiser, *Batch size effects in the analysis of
//! simulation output*, Operations Research 30, 1982).

use std::ops::Range;

use peernet_statistics::Summary;

/// Maximum number of batches of a run: more add nothing (Schmeiser 1982).
pub(crate) const MAX_BATCHES: u64 = 30;

/// Minimum number of values in a batch.
pub(crate) const MIN_BATCH_VALUES: u64 = 10;

/// Values in the order of time, in buckets. A list of single values has one value in each bucket.
pub(crate) trait Series {
    /// Returns the number of buckets.
    fn bucket_count(&self) -> usize;

    /// Returns the number of values in a bucket.
    fn count(&self, at: usize) -> u64;

    /// Returns the sum of the values in a bucket.
    fn sum(&self, at: usize) -> f64;

    /// Returns the number of values in all buckets.
    fn total_count(&self) -> u64 {
        (0..self.bucket_count()).map(|at| self.count(at)).sum()
    }

    /// Returns the mean of the values in a range of buckets; `None` if it has no values.
    fn mean(&self, range: Range<usize>) -> Option<f64> {
        let add = |(count, sum): (u64, f64), at| (count + self.count(at), sum + self.sum(at));
        let (count, sum) = range.fold((0, 0.0), add);
        (count > 0).then(|| sum / count as f64)
    }

    /// Splits the series into at most `parts` non-empty ranges of about the same number of values. Buckets are not divided.
    fn parts(&self, parts: u64) -> Vec<Range<usize>> {
        let all = self.total_count();
        let (mut ranges, mut from, mut count) = (Vec::new(), 0, 0);
        for at in 0..self.bucket_count() {
            count += self.count(at);
            // The current part ends at this share of all values.
            let end = u128::from(all) * (ranges.len() as u128 + 1);
            if u128::from(count) * u128::from(parts) >= end && (ranges.len() as u64) < parts {
                ranges.push(from..at + 1);
                from = at + 1;
            }
        }
        ranges
    }
}

impl Series for [f64] {
    fn bucket_count(&self) -> usize {
        self.len()
    }

    fn count(&self, _at: usize) -> u64 {
        1
    }

    fn sum(&self, at: usize) -> f64 {
        self[at]
    }
}

/// Counts and means of buckets.
impl Series for [(u64, f64)] {
    fn bucket_count(&self) -> usize {
        self.len()
    }

    fn count(&self, at: usize) -> u64 {
        self[at].0
    }

    fn sum(&self, at: usize) -> f64 {
        let (count, mean) = self[at];
        count as f64 * mean
    }
}

impl Series for [Summary] {
    fn bucket_count(&self) -> usize {
        self.len()
    }

    fn count(&self, at: usize) -> u64 {
        Summary::count(&self[at])
    }

    fn sum(&self, at: usize) -> f64 {
        self[at].moments.mean * self.count(at) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_similar_counts_and_cover_series() {
        let values = vec![1.0; 103];
        let ranges = values.as_slice().parts(10);
        assert_eq!((ranges.len(), ranges[0].start, ranges[9].end), (10, 0, 103));
        assert!(ranges.iter().all(|range| (10..=11).contains(&range.len())), "{ranges:?}");
        let buckets = [5, 50, 1, 1, 1].map(|count| (count, 1.0));
        assert_eq!(buckets.as_slice().parts(2), [0..2, 2..5]);
        assert!(values.as_slice().parts(0).is_empty());
    }

    #[test]
    fn mean_weighs_buckets_by_their_counts() {
        let buckets = [(1, 4.0), (3, 8.0), (0, 100.0)];
        assert_eq!((buckets.as_slice().mean(0..2), buckets.as_slice().mean(2..3)), (Some(7.0), None));
        assert_eq!([1.0, 2.0, 6.0].as_slice().mean(0..3), Some(3.0));
    }
}
