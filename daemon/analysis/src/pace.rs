//! Pace of a configuration, from the few iterations of a trial.

use crate::rows::{Outcome, Rows};

/// Durations that a trial of a configuration has measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Duration of an iteration in seconds, if only one iteration is in flight.
    pub iteration_s: f64,
    /// Duration of a run besides its iterations, seconds.
    pub overhead_s: f64,
    /// Time that the sensor takes for a sample, seconds; 0 if unknown.
    pub sensing_s: f64,
    /// Time that a worker of the model takes for a sample, seconds; 0 if unknown.
    pub computing_s: f64,
}

impl Pace {
    /// Returns the pace from the iterations of a trial and the duration of its process, seconds. `None` unless an
    /// iteration started after a successful one.
    pub fn from_trial(rows: &Rows, duration_s: f64) -> Option<Self> {
        let rows: Vec<_> = rows.iter().collect();
        // An iteration that failed may have ended at once.
        let pairs = rows.windows(2).filter(|pair| pair[0].outcome() == Outcome::Ok);
        let intervals = pairs.map(|pair| pair[1].at() - pair[0].at());
        // The smallest values are taken: the first iterations may include the loading of a model or a new connection.
        let iteration_s = intervals.filter(|interval| *interval > 0.0).reduce(f64::min)?;
        let smallest_sum = |stages: &[&str]| {
            let sums = rows.iter().map(|row| stages.iter().filter_map(|stage| row.value(stage)).sum::<f64>());
            // The sum is 0 if an iteration has none of the stages, for example because it was lost.
            sums.filter(|sum| sum.is_finite() && *sum > 0.0).reduce(f64::min).unwrap_or_default()
        };
        Some(Self {
            iteration_s,
            overhead_s: (duration_s - iteration_s * rows.len() as f64).max(0.0),
            sensing_s: smallest_sum(&["sensing"]),
            computing_s: smallest_sum(&["preprocessing", "inference", "postprocessing"]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::Row;
    use crate::testing::row_of_values;

    #[test]
    fn pace_ignores_first_iteration() {
        let rows = |starts: &[(f64, f64)]| -> Rows {
            let row = |(at, stage_s): &(f64, f64)| {
                let values = ["sensing", "preprocessing", "inference"].map(|name| (name, *stage_s));
                Row { at: *at, ..row_of_values(Outcome::Ok, &values) }
            };
            starts.iter().map(row).collect()
        };
        let pace = Pace::from_trial(&rows(&[(10.0, 1.0), (12.0, 0.125), (12.5, 0.125)]), 4.0);
        let expected = Pace { iteration_s: 0.5, overhead_s: 2.5, sensing_s: 0.125, computing_s: 0.25 };
        assert_eq!(pace, Some(expected));
        assert_eq!(Pace::from_trial(&rows(&[(10.0, 1.0)]), 1.0), None);
    }

    #[test]
    fn failed_iteration_does_not_shorten_interval() {
        let rows = |starts: &[(f64, Outcome)]| -> Rows {
            starts.iter().map(|(at, outcome)| Row { at: *at, ..row_of_values(*outcome, &[]) }).collect()
        };
        let (ok, failed) = (Outcome::Ok, Outcome::Failed);
        let pace = Pace::from_trial(&rows(&[(10.0, ok), (12.0, failed), (12.125, ok), (12.625, ok)]), 4.0);
        assert_eq!(pace.map(|pace| pace.iteration_s), Some(0.5));
        assert_eq!(Pace::from_trial(&rows(&[(10.0, failed), (10.125, ok)]), 4.0), None);
    }

    #[test]
    fn lost_iteration_does_not_shorten_stages() {
        let answered = row_of_values(Outcome::Ok, &[("sensing", 0.125), ("inference", 0.25)]);
        let lost = row_of_values(Outcome::Lost, &[("sensing", 0.125)]);
        let rows: Rows = [Row { at: 10.0, ..answered }, Row { at: 11.0, ..lost }].into_iter().collect();
        let pace = Pace::from_trial(&rows, 4.0).expect("two iterations");
        assert_eq!((pace.sensing_s, pace.computing_s), (0.125, 0.25));
    }
}
