//! How often a model was right, out of roll-ups.

use peernet_analysis::accuracy::Accuracy;
use peernet_statistics::number::{SPACE, share};
use peernet_store::Figures;

/// A share of right answers from the mean of scores that are 0 or 1, of so many answered iterations; `None` where the mean
/// is none of such scores.
pub(crate) fn of(scores: &Figures, answered: u64) -> Option<Accuracy> {
    let is_share = (0.0..=1.0).contains(&scores.mean);
    let right = (scores.mean * scores.count as f64).round() as u64;
    Accuracy::of_counts(right, scores.count, answered.saturating_sub(scores.count)).filter(|_| is_share)
}

/// Its 95 % interval in percent: `79.1 – 88.2`.
pub(crate) fn interval(scores: &Figures) -> Option<String> {
    let (lo, hi) = of(scores, scores.count)?.interval;
    Some(format!("{}{SPACE}–{SPACE}{}", share(lo), share(hi)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::samples;

    #[test]
    fn roll_ups_tell_a_share_its_interval_and_how_many_have_no_score() {
        // Newcombe 1998, table I: 81 of 263 is 0.2553 to 0.3662.
        let scores = Figures { mean: 81.0 / 263.0, ..samples::figures(1.0, 263) };
        assert_eq!(interval(&scores).as_deref(), Some("25.5\u{202f}–\u{202f}36.6"));
        let found = of(&scores, 300).expect("a share");
        assert_eq!((found.count, found.unscored), (263, 37));
        assert_eq!(of(&Figures { mean: 7.0, ..scores }, 263), None, "no score is 7");
    }
}
