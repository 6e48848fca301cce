//! Accuracy of a model: the share of answers that were right.

pub mod detection;
mod mean_score;
mod scored_answer;
pub mod segmentation;
mod unknown_labels;

pub use mean_score::MeanScore;
pub use scored_answer::ScoredAnswer;
pub use unknown_labels::UnknownLabels;

use std::collections::BTreeMap;
use std::fmt;

use peernet_statistics::number::{counted, join_ends, share};
use serde::{Deserialize, Serialize};

use crate::order::Z95;
use crate::rows::{RowRef, Rows};

/// Names of the columns with scores. The value is 1 if the labelled class is the best answer (`top-1`) or among the best five (`top-5`),
/// else 0.
pub const ACCURACIES: [&str; 2] = ["top-1", "top-5"];
/// Titles of the accuracies, in the order of [`ACCURACIES`].
pub const ACCURACY_TITLES: [&str; 2] = ["Top-1", "Top-5"];

/// Share of iterations in which a model was right, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// The share.
    pub share: f64,
    /// 95 % confidence interval of the share.
    pub interval: (f64, f64),
    /// Number of scored iterations.
    pub count: u64,
    /// Number of unscored iterations: they have an answer and are not warm-up, but have no score of 0 or 1. The reason
    /// is one of these: the sample has no label, the label is [not a class of the model](UnknownLabels), the answer
    /// names no class, or the score is not valid.
    pub unscored: u64,
}

impl Accuracy {
    /// Returns the accuracy from a column of [`ACCURACIES`] over the rows in the statistics; `None` if no row has a
    /// score.
    pub fn from_rows<'a>(rows: impl IntoIterator<Item = RowRef<'a>>, column: &str) -> Option<Self> {
        let (mut right, mut count, mut unscored) = (0, 0, 0);
        for row in rows.into_iter().filter(|row| row.is_in_statistics()) {
            match was_right(row, column) {
                Some(is_right) => (right, count) = (right + u64::from(is_right), count + 1),
                None => unscored += 1,
            }
        }
        Self::from_counts(right, count, unscored)
    }

    /// Returns the accuracy of each column of [`ACCURACIES`] that has scores.
    pub fn by_column(rows: &Rows) -> BTreeMap<String, Self> {
        let accuracy = |column: &str| Some((column.to_owned(), Self::from_rows(rows, column)?));
        ACCURACIES.into_iter().filter_map(accuracy).collect()
    }

    /// Returns the accuracy from the mean of `count` scores that are 0 or 1. `answered` is the number of iterations with an answer.
    /// `None` without a score, or if the mean is not between 0 and 1.
    pub fn from_mean(mean: f64, count: u64, answered: u64) -> Option<Self> {
        (0.0..=1.0).contains(&mean).then_some(())?;
        Self::from_counts((mean * count as f64).round() as u64, count, answered.saturating_sub(count))
    }

    /// Returns the accuracy of `right` answers out of `count` scored answers; `None` if `count` is 0.
    pub fn from_counts(right: u64, count: u64, unscored: u64) -> Option<Self> {
        (count > 0).then(|| {
            let share = right as f64 / count as f64;
            Self { share, interval: wilson(share, count), count, unscored }
        })
    }
}

/// Writes the share with its interval and its base: `75.0 % of 1,000 iterations (95 % confidence: 72.2 – 77.6 %)`.
impl fmt::Display for Accuracy {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [value, lo, hi] = [self.share, self.interval.0, self.interval.1].map(share);
        let iterations = counted(self.count, "iteration");
        write!(formatter, "{value} % of {iterations} (95 % confidence: {} %)", join_ends([lo, hi]))
    }
}

/// Returns whether the answer was right, from the score in a column of [`ACCURACIES`]; `None` without a valid score.
pub fn was_right(row: RowRef<'_>, column: &str) -> Option<bool> {
    match row.value(column)? {
        1.0 => Some(true),
        0.0 => Some(false),
        _ => None,
    }
}

/// Returns the 95 % score interval of a proportion (E. B. Wilson, *Probable inference, the law of succession, and
/// statistical inference*, JASA 22, 1927). Unlike the usual interval (share ± margin), it stays between 0 and 1 and is
/// valid for shares near 0 and 1.
fn wilson(share: f64, count: u64) -> (f64, f64) {
    let n = count as f64;
    let z2 = Z95 * Z95;
    let middle = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half_width = Z95 / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
    // The exact ends for shares of 0 and 1 are 0 and 1; rounding would change them by about 1e-17.
    let lo = if share == 0.0 { 0.0 } else { (middle - half_width).max(0.0) };
    let hi = if share == 1.0 { 1.0 } else { (middle + half_width).min(1.0) };
    (lo, hi)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::{Outcome, Row};

    fn row(score: Option<f64>) -> Row {
        Row {
            iteration: 1,
            at: 0.0,
            episode: 0,
            step: 0,
            warm_up: false,
            outcome: Outcome::Ok,
            reason: None,
            values: score.map(|score| ("top-1".into(), score)).into_iter().collect(),
            upload: None,
            download: None,
        }
    }

    #[test]
    fn intervals_are_those_of_the_literature() {
        // R. G. Newcombe, Two-sided confidence intervals for the single proportion, Statistics in Medicine 17, 1998,
        // table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
        let cases = [
            (81, 263, 0.2553, 0.3662),
            (15, 148, 0.0624, 0.1605),
            (0, 20, 0.0, 0.1611),
            (1, 29, 0.0061, 0.1718),
        ];
        for (right, count, lo, hi) in cases {
            let found = Accuracy::from_counts(right, count, 0).expect("there are answers").interval;
            assert!(
                (found.0 - lo).abs() < 5e-5 && (found.1 - hi).abs() < 5e-5,
                "{right} of {count}: {found:?}"
            );
        }
        assert_eq!(wilson(1.0, 20).1, 1.0);
        assert_eq!(Accuracy::from_counts(0, 0, 3), None);
    }

    #[test]
    fn mean_of_scores_gives_same_accuracy_as_scores() {
        let found = Accuracy::from_mean(81.0 / 263.0, 263, 300).expect("a share");
        assert_eq!(Some(found), Accuracy::from_counts(81, 263, 37));
        assert_eq!(Accuracy::from_mean(7.0, 263, 263), None, "7 is not the mean of scores that are 0 or 1");
    }

    #[test]
    fn iterations_without_valid_score_are_counted() {
        let scores = [Some(1.0), Some(0.0), Some(f64::NAN), Some(f64::INFINITY), Some(0.5), Some(7.0), None];
        let mut rows: Vec<Row> = scores.into_iter().map(row).collect();
        rows.push(Row { warm_up: true, ..row(None) });
        rows.push(Row { outcome: Outcome::Lost, ..row(None) });
        let rows: Rows = rows.into_iter().collect();
        let found = Accuracy::by_column(&rows);
        let top = found["top-1"];
        assert_eq!((top.share, top.count, top.unscored, found.len()), (0.5, 2, 5, 1));
        assert_eq!(Accuracy::from_rows(rows.iter().skip(2), "top-1"), None, "no score is valid");
    }
}
