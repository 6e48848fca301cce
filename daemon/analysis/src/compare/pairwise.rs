//! Distribution of the difference between iterations of two configurations.

use peernet_statistics::Summary;

/// Number of quantiles that stand for the iterations of a configuration. A [`Summary`] does not hold single values.
const QUANTILES: u32 = 100;

/// Distribution of the difference between an iteration of one configuration and an iteration of another. Both
/// iterations are taken at random, because no iteration of one run belongs to a certain iteration of another run.
#[derive(Clone, Debug, PartialEq)]
pub struct PairwiseDifference {
    /// Second duration minus first duration, for all pairs of a quantile of one distribution and a quantile of the
    /// other.
    pub differences: Summary,
    /// Share of all pairs of iterations in which the second duration is smaller, from 0 to 1. This is the statistic of
    /// Mann and Whitney (*On a test of whether one of two random variables is stochastically larger than the other*,
    /// Annals of Mathematical Statistics 18, 1947), divided by the number of pairs.
    pub share_smaller: f64,
}

impl PairwiseDifference {
    /// Returns the distribution of the difference from the distributions of both configurations; `None` if one of them
    /// has no values.
    pub fn between(first: &Summary, second: &Summary) -> Option<Self> {
        let quantiles = |values: &Summary| -> Option<Vec<f64>> {
            // The middle of each of the equal parts of the distribution stands for this part.
            let quantile = |index| values.quantile((f64::from(index) + 0.5) / f64::from(QUANTILES));
            (0..QUANTILES).map(quantile).collect()
        };
        let (a, b) = (quantiles(first)?, quantiles(second)?);
        let mut differences = Summary::default();
        a.iter().flat_map(|a| b.iter().map(move |b| b - a)).for_each(|value| differences.record(value));
        let first_count = first.sketch.count() as f64;
        // For each bin of the first distribution: its share of all values, times the share of the second distribution
        // below it.
        let shares = first.sketch.bins().filter_map(|(value, count)| {
            Some(second.sketch.fraction_below(value)? * count as f64 / first_count)
        });
        Some(Self { share_smaller: shares.sum::<f64>().clamp(0.0, 1.0), differences })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::autocorrelated_values;
    use super::*;

    fn summary(values: &[f64]) -> Summary {
        let mut summary = Summary::default();
        values.iter().for_each(|value| summary.record(*value));
        summary
    }

    #[test]
    fn quantile_pairs_match_pairs_of_values() {
        let (a, b) = (autocorrelated_values(0.0, 2_000, 10.0, 1), autocorrelated_values(0.0, 2_000, 9.5, 2));
        let difference = PairwiseDifference::between(&summary(&a), &summary(&b)).expect("values");
        let mut pairs: Vec<f64> = a.iter().flat_map(|a| b.iter().map(move |b| b - a)).collect();
        pairs.sort_unstable_by(f64::total_cmp);
        let smaller = pairs.iter().filter(|value| **value < 0.0).count() as f64 / pairs.len() as f64;
        assert!((difference.share_smaller - smaller).abs() < 0.02, "{} {smaller}", difference.share_smaller);
        for share in [0.1, 0.5, 0.9] {
            let exact = pairs[(share * pairs.len() as f64) as usize];
            let approximate = difference.differences.quantile(share).expect("values");
            assert!((approximate - exact).abs() < 0.1, "{share}: {approximate} {exact}");
        }
    }

    #[test]
    fn equal_distributions_are_smaller_in_half_of_pairs() {
        let summary_of_values = summary(&autocorrelated_values(0.0, 500, 10.0, 3));
        let difference = PairwiseDifference::between(&summary_of_values, &summary_of_values).expect("values");
        assert!((difference.share_smaller - 0.5).abs() < 0.02, "{}", difference.share_smaller);
        assert_eq!(PairwiseDifference::between(&summary_of_values, &Summary::default()), None);
    }
}
