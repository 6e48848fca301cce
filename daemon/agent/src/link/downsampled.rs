//! Downsampling to a bounded number of values.

/// Largest number of values that are kept.
const MAX_VALUES: usize = 256;

/// Every n-th of the values, with n as small as the bound allows, so that the choice is even over the whole time.
#[derive(Debug)]
pub(super) struct Downsampled<T> {
    kept: Vec<T>,
    /// Distance between two values that are kept.
    stride: u64,
    seen: u64,
}

impl<T> Default for Downsampled<T> {
    fn default() -> Self {
        Self { kept: Vec::new(), stride: 1, seen: 0 }
    }
}

impl<T: Copy> Downsampled<T> {
    pub(super) fn push(&mut self, value: T) {
        if self.seen.is_multiple_of(self.stride) {
            if self.kept.len() == MAX_VALUES {
                let mut place = 0;
                self.kept.retain(|_| {
                    place += 1;
                    place % 2 == 1
                });
                self.stride *= 2;
            }
            if self.seen.is_multiple_of(self.stride) {
                self.kept.push(value);
            }
        }
        self.seen += 1;
    }

    /// Returns the median of the kept values by `key`; the upper one of two.
    pub(super) fn median<K: Ord>(&self, key: impl Fn(&T) -> K) -> Option<T> {
        let mut sorted = self.kept.clone();
        sorted.sort_unstable_by_key(key);
        sorted.get(sorted.len() / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_values_are_all_kept() {
        let mut few = Downsampled::default();
        assert_eq!(few.median(|value: &i32| *value), None);
        for value in [9, 1, 5] {
            few.push(value);
        }
        assert_eq!(few.median(|value| *value), Some(5));
    }

    #[test]
    fn many_values_are_downsampled_evenly() {
        let mut many = Downsampled::default();
        for value in 0..100_000_i64 {
            many.push(value);
            assert!(many.kept.len() <= MAX_VALUES);
        }
        assert!(many.kept.len() > MAX_VALUES / 2);
        let steps: Vec<i64> = many.kept.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| *step == steps[0]), "{steps:?}");
        let median = many.median(|value| *value).expect("not empty");
        assert!((49_000..51_000).contains(&median), "{median}");
    }
}
