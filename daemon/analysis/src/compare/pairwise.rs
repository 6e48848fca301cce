//! Distribution of the difference between iterations of two configurations.

use peernet_statistics::Summary;

/// Number of quantiles that approximate the distribution of a configuration.
const POINTS: u32 = 100;

/// Distribution of the difference between an iteration of one configuration and one of another, each drawn at random: iterations of
/// different runs are not paired.
#[derive(Clone, Debug, PartialEq)]
pub struct PairwiseDifference {
    /// Second duration minus the first: quantiles of both, all pairs.
    pub differences: Summary,
    /// Share of the pairs in which the second is smaller, from 0 to 1 (the statistic of Mann and Whitney, *On a test of whether one of
    /// two random variables is stochastically larger than the other*, Annals of Mathematical Statistics 18, 1947, over the number of
    /// pairs).
    pub share_smaller: f64,
}

impl PairwiseDifference {
    /// Returns the distribution from the distributions of both; `None` if one has no values.
    pub fn between(first: &Summary, second: &Summary) -> Option<Self> {
        let points = |values: &Summary| -> Option<Vec<f64>> {
            (0..POINTS).map(|at| values.quantile((f64::from(at) + 0.5) / f64::from(POINTS))).collect()
        };
        let (a, b) = (points(first)?, points(second)?);
        let mut differences = Summary::default();
        a.iter().flat_map(|a| b.iter().map(move |b| b - a)).for_each(|value| differences.record(value));
        let all = first.sketch.count() as f64;
        let below = first
            .sketch
            .bins()
            .filter_map(|(value, count)| Some(second.sketch.fraction_below(value)? * count as f64 / all));
        Some(Self { share_smaller: below.sum::<f64>().clamp(0.0, 1.0), differences })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::run;
    use super::*;

    fn summary(values: &[f64]) -> Summary {
        let mut summary = Summary::default();
        values.iter().for_each(|value| summary.record(*value));
        summary
    }

    #[test]
    fn quantile_pairs_match_pairs_of_values() {
        let (a, b) = (run(0.0, 2_000, 10.0, 1), run(0.0, 2_000, 9.5, 2));
        let found = PairwiseDifference::between(&summary(&a), &summary(&b)).expect("values");
        let mut pairs: Vec<f64> = a.iter().flat_map(|a| b.iter().map(move |b| b - a)).collect();
        pairs.sort_unstable_by(f64::total_cmp);
        let smaller = pairs.iter().filter(|value| **value < 0.0).count() as f64 / pairs.len() as f64;
        assert!((found.share_smaller - smaller).abs() < 0.02, "{} {smaller}", found.share_smaller);
        for share in [0.1, 0.5, 0.9] {
            let exact = pairs[(share * pairs.len() as f64) as usize];
            let known = found.differences.quantile(share).expect("values");
            assert!((known - exact).abs() < 0.1, "{share}: {known} {exact}");
        }
    }

    #[test]
    fn equal_distributions_are_smaller_in_half_of_pairs() {
        let one = summary(&run(0.0, 500, 10.0, 3));
        let found = PairwiseDifference::between(&one, &one).expect("values");
        assert!((found.share_smaller - 0.5).abs() < 0.02, "{}", found.share_smaller);
        assert_eq!(PairwiseDifference::between(&one, &Summary::default()), None);
    }
}
