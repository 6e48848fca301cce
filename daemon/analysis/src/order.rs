//! Order statistics: the median and other quantiles. They describe delays better than means do, because the
//! distribution of delays has a long tail.

use std::cmp::Ordering;

use peernet_statistics::histogram::OrderedValues;
use peernet_statistics::{MIN_VALUES_FOR_P95, MIN_VALUES_FOR_P99};

/// 97.5 % quantile of the standard normal distribution: half the width of a 95 % interval in standard errors.
pub(crate) const Z95: f64 = 1.959_963_984_540_054;

/// Values in ascending order, without NaN.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SortedValues(Vec<f64>);

impl FromIterator<f64> for SortedValues {
    /// Collects and sorts the values. NaN is left out.
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut values: Vec<f64> = values.into_iter().filter(|value| !value.is_nan()).collect();
        values.sort_unstable_by(f64::total_cmp);
        Self(values)
    }
}

impl SortedValues {
    /// Returns the values, smallest first.
    pub fn values(&self) -> &[f64] {
        &self.0
    }

    /// Returns the number of values.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the quantile at `p` from 0 to 1, by linear interpolation between neighbours (definition 7 of Hyndman and
    /// Fan 1996). `None` without values.
    pub fn quantile(&self, p: f64) -> Option<f64> {
        self.0.interpolated_quantile(p)
    }

    /// Returns the median; `None` without values.
    pub fn median(&self) -> Option<f64> {
        self.quantile(0.5)
    }

    /// Returns the 5th and the 95th percentile; `None` with fewer than 60 values.
    pub fn tails(&self) -> Option<(f64, f64)> {
        Some((self.quantile(0.05)?, self.p95()?))
    }

    /// Returns the 95th percentile; `None` with fewer than 60 values.
    pub fn p95(&self) -> Option<f64> {
        self.quantile(0.95).filter(|_| self.0.len() as u64 >= MIN_VALUES_FOR_P95)
    }

    /// Returns the 99th percentile; `None` with fewer than 300 values.
    pub fn p99(&self) -> Option<f64> {
        self.quantile(0.99).filter(|_| self.0.len() as u64 >= MIN_VALUES_FOR_P99)
    }

    /// Returns the upper end of an axis for these values: the largest finite value, but at most `factor` times the
    /// quantile at `p`. A quantile of 0 does not limit the axis. `None` without finite values.
    // If the axis reached up to an extreme outlier, all other values would be drawn at almost the same place.
    pub fn scale_end(&self, p: f64, factor: f64) -> Option<f64> {
        let finite: Self = self.0.iter().copied().filter(|value| value.is_finite()).collect();
        let (largest, limit) = (finite.0.last().copied()?, finite.quantile(p)? * factor);
        Some(if limit > 0.0 { largest.min(limit) } else { largest })
    }

    /// Returns the standard error of the median, from the two values that bound the median with
    /// about 95 % confidence (McKean and Schrader 1984). The method makes no assumption about the
    /// shape of the distribution. `None` with fewer than 6 values.
    pub fn median_error(&self) -> Option<f64> {
        let [lower, upper] = ranks_around_median(self.0.len() as u64)?.map(|rank| self.0[rank as usize - 1]);
        Some((upper - lower) / (2.0 * Z95))
    }
}

/// Returns the mean; `None` without values.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u64), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Returns the lower median of items that each count as often as their weight says. `None` without items.
pub(crate) fn weighted_median<T>(
    mut items: Vec<(T, u64)>,
    compare: impl Fn(&T, &T) -> Ordering,
) -> Option<T> {
    items.sort_unstable_by(|(a, _), (b, _)| compare(a, b));
    let half = items.iter().map(|(_, weight)| weight).sum::<u64>().div_ceil(2);
    let mut cumulative_weight = 0;
    let median = items.into_iter().find(|(_, weight)| {
        cumulative_weight += weight;
        cumulative_weight >= half
    });
    median.map(|(item, _)| item)
}

/// Returns two ranks, counted from 1: of `n` sorted values, the values with these ranks bound the
/// median with about 95 % confidence. The confidence is 92 to 98 %, because a rank is a whole
/// number. `None` with fewer than 6 values, because no ranks of 5 values give 95 % confidence: even
/// the smallest and the largest value bound the median only with 94 % confidence.
pub(crate) fn ranks_around_median(n: u64) -> Option<[u64; 2]> {
    (n >= 6).then_some(())?;
    let lower = ((n as f64 + 1.0) / 2.0 - Z95 * (n as f64 / 4.0).sqrt()).round().max(1.0) as u64;
    // The upper rank is as far from the largest rank as the lower rank is from the smallest.
    Some([lower, n + 1 - lower])
}

/// Returns the variance of Kendall's statistic if there is no trend (Kendall 1975). `group_sizes` are the sizes of all
/// groups of equal values; a value without an equal one is a group of one.
pub(crate) fn kendall_variance(group_sizes: impl Iterator<Item = usize>) -> f64 {
    let term = |size: usize| {
        let n = size as f64;
        n * (n - 1.0) * (2.0 * n + 5.0)
    };
    // Equal values are neither a rise nor a fall, so they reduce the variance.
    let (count, ties) = group_sizes.fold((0, 0.0), |(count, ties), size| (count + size, ties + term(size)));
    (term(count) - ties) / 18.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_follow_definition_seven() {
        let values: SortedValues = [4.0, 1.0, f64::NAN, 3.0, 2.0].into_iter().collect();
        assert_eq!(
            (values.median(), values.quantile(0.1), values.quantile(1.0)),
            (Some(2.5), Some(1.3), Some(4.0))
        );
        assert_eq!(SortedValues::default().median(), None);
        assert_eq!(
            [1.0, f64::INFINITY, f64::INFINITY].into_iter().collect::<SortedValues>().median(),
            Some(f64::INFINITY)
        );
    }

    #[test]
    fn few_values_have_no_tails() {
        let few: SortedValues = (0..59).map(f64::from).collect();
        let enough: SortedValues = (0..=100).map(f64::from).collect();
        assert_eq!((few.tails(), enough.tails()), (None, Some((5.0, 95.0))));
        assert_eq!((0..5).map(f64::from).collect::<SortedValues>().median_error(), None);
    }

    #[test]
    fn median_error_matches_uniform_density() {
        // 1 / (2 f √n) with density f = 1/101: 5.05.
        let error = (0..=100).map(f64::from).collect::<SortedValues>().median_error().expect("enough");
        assert!((4.5..5.6).contains(&error), "{error}");
    }
}
