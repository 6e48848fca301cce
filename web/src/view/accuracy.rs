//! Accuracy of a model in words.

use peernet_analysis::accuracy::Accuracy;
use peernet_statistics::number::{join_ends, share};
use peernet_store::QuantityStatistics;

/// Returns an accuracy and its 95 % interval in percent: `84.0` and `79.1 – 88.2`. `None` if `scores` cannot be the
/// statistics of scores that are 0 or 1.
pub(crate) fn texts(scores: &QuantityStatistics) -> Option<(String, String)> {
    // Unscored answers are not shown, so the number of scores replaces the number of answers.
    let accuracy = Accuracy::from_mean(scores.mean, scores.count, scores.count)?;
    let (lo, hi) = accuracy.interval;
    Some((share(accuracy.share), join_ends([share(lo), share(hi)])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::samples;

    #[test]
    fn share_and_interval_are_formatted_in_percent() {
        // Newcombe 1998, table I: the interval of 81 of 263 is 0.2553 to 0.3662.
        let scores = QuantityStatistics { mean: 81.0 / 263.0, ..samples::figures(1.0, 263) };
        assert_eq!(texts(&scores), Some(("30.8".to_owned(), "25.5 – 36.6".to_owned())));
        assert_eq!(texts(&samples::figures(7.0, 263)), None);
    }
}
