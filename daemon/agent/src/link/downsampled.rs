//! Downsampling to a bounded number of values.

/// Maximum number of values that are kept.
const MAX_VALUES: usize = 256;

/// Every n-th of the pushed values; n is the smallest power of two for which at most [`MAX_VALUES`] values are kept.
#[derive(Debug)]
pub(super) struct DownsampledValues<T> {
    values: Vec<T>,
    /// Every n-th value is kept.
    stride: u64,
    /// Number of pushed values.
    count: u64,
}

impl<T> Default for DownsampledValues<T> {
    fn default() -> Self {
        Self { values: Vec::new(), stride: 1, count: 0 }
    }
}

impl<T: Copy> DownsampledValues<T> {
    /// Adds a value. If there are too many values, removes every other value.
    pub(super) fn push(&mut self, value: T) {
        if self.count.is_multiple_of(self.stride) {
            if self.values.len() == MAX_VALUES {
                let mut index = 0;
                // Exactly the multiples of the doubled stride remain, so the values stay evenly spaced.
                self.values.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.stride *= 2;
            }
            if self.count.is_multiple_of(self.stride) {
                self.values.push(value);
            }
        }
        self.count += 1;
    }

    /// Returns the median of the kept values by `key`: of an even number of values the upper of the two middle ones;
    /// `None` without values.
    pub(super) fn median<K: Ord>(&self, key: impl Fn(&T) -> K) -> Option<T> {
        let mut sorted = self.values.clone();
        sorted.sort_unstable_by_key(key);
        sorted.get(sorted.len() / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_values_are_all_kept() {
        let mut values = DownsampledValues::default();
        assert_eq!(values.median(|value: &i32| *value), None);
        for value in [9, 1, 5] {
            values.push(value);
        }
        assert_eq!(values.median(|value| *value), Some(5));
    }

    #[test]
    fn many_values_are_downsampled_evenly() {
        let mut values = DownsampledValues::default();
        for value in 0..100_000_i64 {
            values.push(value);
            assert!(values.values.len() <= MAX_VALUES);
        }
        assert!(values.values.len() > MAX_VALUES / 2);
        let steps: Vec<i64> = values.values.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| *step == steps[0]), "{steps:?}");
        let median = values.median(|value| *value).expect("not empty");
        assert!((49_000..51_000).contains(&median), "{median}");
    }
}
