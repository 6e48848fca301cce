//! Results of a run's actuator: superseded answers, and success and return of the episodes.

use peernet_statistics::number::{count, counted, decimals, fixed, join_ends, share};
use peernet_statistics::{Moments, Summary};
use serde::{Deserialize, Serialize};

use crate::accuracy::Accuracy;
use crate::rows::RowRef;

/// Name of the node, and of the column, that marks a superseded answer with the value 1. The actuator did not act on
/// this answer, because it had acted on the answer to a newer sample, or because the episode had ended. Iterations with
/// other answers have no such node.
pub const SUPERSEDED: &str = "superseded";
/// Name of the node, and of the column, that says whether the episode that ended with this iteration was a success: 1 or 0.
pub const EPISODE_SUCCESS: &str = "episode-success";
/// Name of the node, and of the column, with the return of the episode that ended with this iteration: the sum of the episode's rewards.
pub const EPISODE_RETURN: &str = "episode-return";
/// Names of the values that belong to an episode. The values are stored with the last iteration of the episode. They count even if that
/// iteration has no answer, or is warm-up as one of the first steps of its episode. Episodes that begin in the warm-up at the start of the run
/// have no such values.
pub const EPISODE_VALUES: [&str; 2] = [EPISODE_SUCCESS, EPISODE_RETURN];
/// Name of the node that is 1 if the actuator reported that the episode is a success so far, and 0 if it reported that
/// it is not.
pub const SUCCESS: &str = "success";
/// Name of the node that is 1 for the last action of an episode, and absent for all other actions.
pub const EPISODE_ENDED: &str = "episode-ended";
/// Names of the nodes in which the actuator describes each action. The means of these nodes over all actions say little;
/// the nodes in [`EPISODE_VALUES`] have the results of whole episodes.
pub const ACTION_REPORTS: [&str; 2] = [SUCCESS, EPISODE_ENDED];

/// Text that joins two numbers of episodes: "12 and 13".
pub const EPISODES_SEPARATOR: &str = " and ";

/// Returns whether statistics include the value that an iteration has under this name: the iteration is in the
/// statistics, or the value is one of the [`EPISODE_VALUES`].
pub fn is_value_in_statistics(name: &str, is_iteration_in_statistics: bool) -> bool {
    is_iteration_in_statistics || EPISODE_VALUES.contains(&name)
}

/// Results of the actuator of one or several runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ActuatorResults {
    /// Number of iterations in the statistics whose answer was not acted on, because it was superseded.
    pub superseded: u64,
    /// Success rate of the episodes; `None` if no success is reported.
    pub success: Option<SuccessRate>,
    /// Return per episode; `None` if no rewards are reported.
    #[serde(rename = "return")]
    pub episode_return: Option<EpisodeReturn>,
}

/// Share of the episodes that were a success.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SuccessRate {
    /// The share, from 0 to 1.
    pub rate: f64,
    /// 95 % confidence interval of the share (Wilson), which assumes that the episodes are independent.
    pub interval: (f64, f64),
    /// Number of episodes.
    pub episodes: u64,
}

/// Return per episode: the sum of the rewards of an episode, without a discount.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeReturn {
    /// The mean.
    pub mean: f64,
    /// Sample standard deviation; `None` below two episodes.
    pub std: Option<f64>,
    /// Number of episodes.
    pub episodes: u64,
}

impl ActuatorResults {
    /// Returns the results of these rows.
    pub fn from_rows<'a>(rows: impl IntoIterator<Item = RowRef<'a>>) -> Self {
        let (mut superseded, mut success, mut returns) = (0, Moments::default(), Moments::default());
        for row in rows {
            superseded += u64::from(row.is_in_statistics() && row.value(SUPERSEDED) == Some(1.0));
            // Episodes count even if their last iteration is not in the statistics.
            for (name, moments) in [(EPISODE_SUCCESS, &mut success), (EPISODE_RETURN, &mut returns)] {
                if let Some(value) = row.value(name).filter(|value| Summary::accepts(*value)) {
                    moments.record(value);
                }
            }
        }
        let results = Self::from_statistics(|name| {
            let moments = match name {
                EPISODE_SUCCESS => &success,
                EPISODE_RETURN => &returns,
                _ => return None,
            };
            (moments.count > 0).then(|| (moments.count, moments.mean, moments.std()))
        });
        Self { superseded, ..results }
    }

    /// Returns the results from statistics. `statistics_of` returns count, mean and sample standard deviation of the
    /// values of the node with this name; `None` without values. Counts and means of roll-ups are exact, so the number
    /// of superseded answers is exact, too.
    pub fn from_statistics(statistics_of: impl Fn(&str) -> Option<(u64, f64, Option<f64>)>) -> Self {
        let superseded =
            statistics_of(SUPERSEDED).map_or(0.0, |(count, mean, _)| (mean * count as f64).round());
        let success = statistics_of(EPISODE_SUCCESS)
            .and_then(|(count, mean, _)| Accuracy::from_mean(mean, count, count));
        let success = success.map(|Accuracy { share, interval, count, .. }| SuccessRate {
            rate: share,
            interval,
            episodes: count,
        });
        let episode_return = statistics_of(EPISODE_RETURN);
        Self {
            // The cast saturates: a negative value or NaN becomes 0, and a value above the largest count becomes the
            // largest count.
            superseded: superseded as u64,
            success,
            episode_return: episode_return.map(|(episodes, mean, std)| EpisodeReturn { mean, std, episodes }),
        }
    }

    /// Returns the number of episodes with a result, as text. The text has two numbers if the number of episodes with a
    /// reported success differs from the number of episodes with a return. `None` without episodes.
    pub fn episodes_text(&self) -> Option<String> {
        let counts =
            [self.success.map(|found| found.episodes), self.episode_return.map(|found| found.episodes)];
        let mut counts: Vec<u64> = counts.into_iter().flatten().collect();
        counts.dedup();
        let texts: Vec<String> = counts.into_iter().map(count).collect();
        (!texts.is_empty()).then(|| texts.join(EPISODES_SEPARATOR))
    }

    /// Returns sentences about the results. `answered` is the number of iterations in the statistics.
    pub fn sentences(&self, answered: u64) -> Vec<String> {
        let superseded = (self.superseded > 0).then(|| {
            let [superseded, answered] = [self.superseded, answered].map(count);
            format!("Superseded: {superseded} of {answered} answers were not acted on, because a newer answer had been acted on or the episode had ended.")
        });
        let success = self.success.map(|success| {
            let SuccessRate { rate, interval: (lo, hi), episodes } = success;
            let (rate, interval) = (share(rate), join_ends([lo, hi].map(share)));
            format!("Success: {rate} % of {} (95 % confidence: {interval} %).", counted(episodes, "episode"))
        });
        let episode_return = self.episode_return.map(|found| {
            format!("Return per episode: {} over {}.", found.text(), counted(found.episodes, "episode"))
        });
        [superseded, success, episode_return].into_iter().flatten().collect()
    }
}

/// Returns the number of decimals with which returns are written: as many as give the sample standard deviation three
/// significant digits, or the mean if there is no deviation.
pub(crate) fn return_decimals(mean: f64, std: Option<f64>) -> usize {
    decimals(std.unwrap_or(mean), 3)
}

impl EpisodeReturn {
    /// Returns mean and standard deviation as a text, in the unit of the rewards.
    pub fn text(&self) -> String {
        let decimals = return_decimals(self.mean, self.std);
        match self.std {
            Some(std) => format!("{} ± {}", fixed(self.mean, decimals), fixed(std, decimals)),
            None => fixed(self.mean, decimals),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::{Outcome, Row, Rows};

    fn row(iteration: u64, outcome: Outcome, values: &[(&'static str, f64)]) -> Row {
        Row {
            iteration,
            at: iteration as f64,
            episode: 0,
            step: 0,
            warm_up: iteration == 1,
            outcome,
            reason: None,
            values: values.iter().map(|(name, value)| ((*name).into(), *value)).collect(),
            upload: None,
            download: None,
        }
    }

    #[test]
    fn episode_counts_even_if_its_last_iteration_failed() {
        let rows: Rows = [
            row(1, Outcome::Ok, &[(EPISODE_SUCCESS, 1.0), (EPISODE_RETURN, 3.0)]),
            row(2, Outcome::Ok, &[(SUPERSEDED, 1.0)]),
            row(3, Outcome::Lost, &[(EPISODE_SUCCESS, 0.0), (EPISODE_RETURN, 1.0)]),
            row(4, Outcome::Failed, &[(SUPERSEDED, 1.0)]),
            row(5, Outcome::Ok, &[("reward", 9.0)]),
        ]
        .into_iter()
        .collect();
        let found = ActuatorResults::from_rows(&rows);
        let success = found.success.expect("a success rate");
        assert_eq!((found.superseded, success.rate, success.episodes), (1, 0.5, 2));
        let returns = found.episode_return.expect("a return");
        assert_eq!(found.episodes_text().as_deref(), Some("2"));
        let fewer_successes = found.success.map(|success| SuccessRate { episodes: 1, ..success });
        let with_two_numbers = ActuatorResults { success: fewer_successes, ..found };
        assert_eq!(with_two_numbers.episodes_text().as_deref(), Some("1 and 2"));
        assert_eq!(ActuatorResults::default().episodes_text(), None);
        assert_eq!((returns.mean, returns.episodes), (2.0, 2));
        assert_eq!(
            found.sentences(1_000),
            [
                "Superseded: 1 of 1,000 answers were not acted on, because a newer answer had been acted on or the episode had ended.",
                "Success: 50.0 % of 2 episodes (95 % confidence: 9.5 – 90.5 %).",
                "Return per episode: 2.00 ± 1.41 over 2 episodes."
            ]
        );
    }

    #[test]
    fn run_without_feedback_has_no_results() {
        let rows: Rows = (1..5).map(|at| row(at, Outcome::Ok, &[])).collect();
        let found = ActuatorResults::from_rows(&rows);
        assert_eq!((found, found.sentences(4)), (ActuatorResults::default(), Vec::new()));
        let from_statistics =
            ActuatorResults::from_statistics(|name| (name == SUPERSEDED).then_some((3, 1.0, Some(0.0))));
        assert_eq!(from_statistics, ActuatorResults { superseded: 3, ..ActuatorResults::default() });
    }
}
