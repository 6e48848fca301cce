//! Accuracy of a model in words.

use peernet_analysis::accuracy::Accuracy;
use peernet_statistics::number::{join_ends, share};
use peernet_store::QuantityStatistics;

/// Returns the 95 % interval of an accuracy in percent: `79.1 – 88.2`. `scores` are the statistics of scores that are 0
/// or 1.
pub(crate) fn interval(scores: &QuantityStatistics) -> Option<String> {
    // The interval does not depend on the number of answers, so the number of scores replaces it.
    let answered = scores.count;
    let (lo, hi) = Accuracy::from_mean(scores.mean, scores.count, answered)?.interval;
    Some(join_ends([share(lo), share(hi)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::samples;

    #[test]
    fn interval_is_formatted_in_percent() {
        // Newcombe 1998, table I: the interval of 81 of 263 is 0.2553 to 0.3662.
        let scores = QuantityStatistics { mean: 81.0 / 263.0, ..samples::figures(1.0, 263) };
        assert_eq!(interval(&scores).as_deref(), Some("25.5 – 36.6"));
    }
}
