//! How often a model was right.

use crate::order::Z95;
use crate::results::Loaded;

/// The columns of accuracies: a row has 1 where the labelled class was the first answer, or among the first five, else 0.
pub const ACCURACIES: [&str; 2] = ["top-1", "top-5"];

/// The share of iterations in which a model was right, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// The share.
    pub share: f64,
    /// Its 95 % confidence interval.
    pub interval: (f64, f64),
    /// Of how many iterations.
    pub count: u64,
}

impl Accuracy {
    /// A column of [`ACCURACIES`] over the iterations of some runs that count; `None` where none of them has it.
    pub fn of<'a>(runs: impl IntoIterator<Item = &'a Loaded>, column: &str) -> Option<Self> {
        let rows = runs.into_iter().flat_map(|run| &run.rows).filter(|row| row.counts());
        let (mut right, mut count) = (0.0, 0_u64);
        for value in rows.filter_map(|row| row.value(column)).filter(|value| value.is_finite()) {
            right += value;
            count += 1;
        }
        let share = right / count as f64;
        (count > 0).then(|| Self { share, interval: wilson(share, count), count })
    }
}

/// The score interval of a proportion (E. B. Wilson, *Probable inference, the law of succession, and statistical inference*,
/// JASA 22, 1927): it stays between 0 and 1 and holds near the ends, where the usual one does not.
fn wilson(share: f64, count: u64) -> (f64, f64) {
    let n = count as f64;
    let z2 = Z95 * Z95;
    let middle = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z95 / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
    // At the ends the arithmetic may leave 1e-17 over.
    let lo = if share == 0.0 { 0.0 } else { (middle - half).max(0.0) };
    let hi = if share == 1.0 { 1.0 } else { (middle + half).min(1.0) };
    (lo, hi)
}

#[cfg(test)]
mod tests {
    use super::*;

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
            let found = wilson(f64::from(right) / count as f64, count);
            assert!(
                (found.0 - lo).abs() < 5e-5 && (found.1 - hi).abs() < 5e-5,
                "{right} of {count}: {found:?}"
            );
        }
        assert_eq!(wilson(1.0, 20).1, 1.0);
    }
}
