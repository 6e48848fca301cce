//! Missed deadlines of iterations.

use peernet_statistics::number::{SPACE, count, counted, duration, percent};
use serde::{Deserialize, Serialize};

use crate::rows::RowRef;

/// Name of the node, and of the column, with the value 1 if an iteration took longer than the deadline of its pipeline
/// or failed, else 0. Iterations of a pipeline without a deadline do not have the node.
pub const DEADLINE_MISSED: &str = "deadline-missed";

/// Numbers of iterations that missed their deadline and of all iterations, without the warm-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Misses {
    /// Number of iterations that took longer than the deadline or failed.
    pub missed: u64,
    /// Number of all iterations, without the warm-up.
    #[serde(rename = "of")]
    pub iterations: u64,
}

impl Misses {
    /// Returns the misses of a run in which `late` of the `successful` iterations took longer than the deadline. All
    /// `failed` iterations count as misses, too.
    pub fn new(successful: u64, late: u64, failed: u64) -> Self {
        // Stored statistics have `late` as a rounded sum, which must not exceed the number of iterations.
        Self { missed: late.min(successful) + failed, iterations: successful + failed }
    }

    /// Returns the sum over several runs; `None` without runs.
    pub fn sum(runs: impl IntoIterator<Item = Self>) -> Option<Self> {
        runs.into_iter()
            .reduce(|a, b| Self { missed: a.missed + b.missed, iterations: a.iterations + b.iterations })
    }

    /// Returns the misses in these rows; `None` if no row has a value in the column [`DEADLINE_MISSED`].
    pub fn from_rows<'a>(rows: impl IntoIterator<Item = RowRef<'a>>) -> Option<Self> {
        let mut has_deadline = false;
        let (mut successful, mut late, mut failed) = (0, 0, 0);
        for row in rows.into_iter().filter(|row| !row.warm_up()) {
            let missed_value = row.value(DEADLINE_MISSED);
            has_deadline |= missed_value.is_some();
            if row.is_in_statistics() {
                successful += 1;
                late += u64::from(missed_value == Some(1.0));
            } else {
                failed += 1;
            }
        }
        has_deadline.then(|| Self::new(successful, late, failed))
    }

    /// Returns the miss rate: the share of iterations that missed their deadline, 0 to 1. `None` without iterations.
    pub fn rate(self) -> Option<f64> {
        (self.iterations > 0).then(|| self.missed as f64 / self.iterations as f64)
    }

    /// Returns the misses as text, such as `Deadline of 100 ms: missed by 12 of 1,000 iterations (1.2 %)`; `None`
    /// without iterations. `deadline_s` is `None` if the deadline is not known.
    pub fn text(self, deadline_s: Option<f64>) -> Option<String> {
        let deadline = deadline_s.map_or_else(String::new, |seconds| format!(" of {}", duration(seconds)));
        let [missed, iterations] = [count(self.missed), counted(self.iterations, "iteration")];
        let share = percent(self.rate()?);
        Some(format!("Deadline{deadline}: missed by {missed} of {iterations} ({share}{SPACE}%)"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::{Outcome, Row, Rows};

    /// Returns a row; the first iteration is the warm-up. `missed` is the value of
    /// [`DEADLINE_MISSED`].
    fn row(iteration: u64, outcome: Outcome, missed: Option<f64>) -> Row {
        Row {
            iteration,
            at: iteration as f64,
            episode: 0,
            step: 0,
            warm_up: iteration == 1,
            outcome,
            reason: None,
            values: missed.map(|missed| (DEADLINE_MISSED.into(), missed)).into_iter().collect(),
            upload: None,
            download: None,
        }
    }

    #[test]
    fn late_and_failed_rows_miss_deadline() {
        let outcomes = [(Outcome::Ok, 1.0), (Outcome::Ok, 0.0), (Outcome::Ok, 1.0), (Outcome::Lost, 1.0)];
        let rows: Rows = (1..)
            .zip(outcomes)
            .map(|(iteration, (outcome, missed))| row(iteration, outcome, Some(missed)))
            .collect();
        let misses = Misses::from_rows(&rows).expect("there is a deadline");
        assert_eq!((misses, misses.rate()), (Misses { missed: 2, iterations: 3 }, Some(2.0 / 3.0)));
    }

    #[test]
    fn rows_without_deadline_have_no_miss_rate() {
        let rows: Rows = (1..5).map(|iteration| row(iteration, Outcome::Timeout, None)).collect();
        assert_eq!(Misses::from_rows(&rows), None);
        assert_eq!(Misses::new(0, 0, 0).rate(), None);
        assert_eq!(Misses::new(0, 0, 0).text(Some(0.1)), None);
        assert_eq!(Misses::sum([]), None);
    }

    #[test]
    fn text_has_deadline_number_and_share() {
        let text = Misses { missed: 12, iterations: 1_000 }.text(Some(0.1));
        let expected = "Deadline of 100\u{202f}ms: missed by 12 of 1,000 iterations (1.2\u{202f}%)";
        assert_eq!(text.as_deref(), Some(expected));
    }

    #[test]
    fn misses_of_several_runs_add_up() {
        let runs = [Misses { missed: 1, iterations: 10 }, Misses { missed: 3, iterations: 30 }];
        assert_eq!(Misses::sum(runs), Some(Misses { missed: 4, iterations: 40 }));
    }
}
