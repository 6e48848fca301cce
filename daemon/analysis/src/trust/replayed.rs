//! Latencies that were not measured but drawn from a distribution, and the time by which the host exceeded them.

use std::collections::BTreeSet;

use peernet_logger::fact;
use peernet_statistics::Moments;
use peernet_statistics::number::milliseconds;

use crate::order::mean;
use crate::rows::Rows;

/// Text before the seed. The description of a distribution ends with the seed.
const SEED: &str = ", seed ";

/// Column of the drawn latency in `data.csv`.
pub(crate) const DRAWN_LATENCY_COLUMN: &str = "inference_drawn-latency";
/// Column of the overrun in `data.csv`.
pub(crate) const OVERRUN_COLUMN: &str = "inference_overrun";

/// The mean overrun is reported if it is above this share of the mean drawn latency.
const MIN_REPORTED_OVERRUN_SHARE: f64 = 0.05;

/// Latencies of a run's model that are drawn from a distribution.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayedLatencies {
    /// Description of the distribution with the seed, from the model.
    pub distribution: String,
    /// Mean drawn latency, seconds; `None` if it is not known.
    pub drawn: Option<f64>,
    /// Mean overrun, seconds; `None` if it is not known.
    pub overrun: Option<f64>,
}

impl ReplayedLatencies {
    /// Returns the replayed latencies with the distribution from the facts of a run, without the means. `None` if the
    /// latencies are measured.
    pub fn from_facts(facts: &[(String, String)]) -> Option<Self> {
        let (_, text) = facts.iter().find(|(name, _)| name == fact::REPLAYED)?;
        Some(Self { distribution: text.clone(), drawn: None, overrun: None })
    }

    /// Returns the replayed latencies, with the distribution from the facts of a run and the means from its rows.
    /// `None` if the latencies are measured.
    pub fn from_run(facts: &[(String, String)], rows: &Rows) -> Option<Self> {
        let [drawn, overrun] = mean_drawn_and_overrun(rows);
        Some(Self { drawn, overrun, ..Self::from_facts(facts)? })
    }

    /// Describes the distribution, and the mean overrun if it is large.
    pub fn describe(&self) -> String {
        let overrun = self
            .drawn
            .zip(self.overrun)
            .filter(|(drawn, overrun)| *overrun > drawn * MIN_REPORTED_OVERRUN_SHARE);
        match overrun {
            None => self.distribution.clone(),
            Some((drawn, overrun)) => format!(
                "{}; inference took {} ms longer than drawn on average (mean drawn latency {} ms)",
                self.distribution,
                milliseconds(overrun),
                milliseconds(drawn)
            ),
        }
    }

    /// Describes the latencies of runs of one configuration, which may have different seeds and distributions; `None` if
    /// all are measured.
    pub fn describe_all(runs: impl IntoIterator<Item = Self>) -> Option<String> {
        let runs: Vec<Self> = runs.into_iter().collect();
        let first = runs.first()?;
        let without_seed = |run: &Self| match run.distribution.rsplit_once(SEED) {
            Some((distribution, _)) => distribution.to_owned(),
            None => run.distribution.clone(),
        };
        let distributions: BTreeSet<String> = runs.iter().map(without_seed).collect();
        let distributions: Vec<String> = distributions.into_iter().collect();
        let with_seeds: BTreeSet<&str> = runs.iter().map(|run| run.distribution.as_str()).collect();
        let distribution = match distributions.as_slice() {
            _ if with_seeds.len() == 1 => first.distribution.clone(),
            [shared] if with_seeds.len() == runs.len() => format!("{shared}, a seed of its own for each run"),
            [shared] => format!("{shared}, {} different seeds in {} runs", with_seeds.len(), runs.len()),
            several => several.join(" or "),
        };
        let mean = |value: fn(&Self) -> Option<f64>| mean(runs.iter().filter_map(value));
        Some(Self { distribution, drawn: mean(|run| run.drawn), overrun: mean(|run| run.overrun) }.describe())
    }
}

/// Returns the mean drawn latency and the mean overrun of the rows in the statistics, seconds. A mean is `None` without
/// values.
pub(super) fn mean_drawn_and_overrun(rows: &Rows) -> [Option<f64>; 2] {
    [DRAWN_LATENCY_COLUMN, OVERRUN_COLUMN].map(|column| {
        let moments: Moments = rows.values_in_statistics(column).collect();
        (moments.count > 0).then_some(moments.mean)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn replayed(distribution: &str, drawn: f64, overrun: f64) -> ReplayedLatencies {
        let (drawn, overrun) = (Some(drawn), Some(overrun));
        ReplayedLatencies { distribution: distribution.to_owned(), drawn, overrun }
    }

    #[test]
    fn overrun_is_stated_above_five_percent() {
        assert_eq!(replayed("x, seed 3", 0.00684, 0.0003).describe(), "x, seed 3");
        assert_eq!(
            replayed("x, seed 3", 0.00684, 0.00276).describe(),
            "x, seed 3; inference took 2.76 ms longer than drawn on average (mean drawn latency 6.84 ms)"
        );
        let unknown = ReplayedLatencies { drawn: None, ..replayed("x, seed 3", 0.0, 1.0) };
        assert_eq!(unknown.describe(), "x, seed 3");
    }

    #[test]
    fn runs_with_different_seeds_are_described_together() {
        let description_of = |runs: &[(&str, f64)]| {
            let runs = runs.iter().map(|(text, overrun)| replayed(text, 0.01, *overrun));
            ReplayedLatencies::describe_all(runs)
        };
        assert_eq!(description_of(&[]), None);
        assert_eq!(description_of(&[("x, seed 3", 0.0), ("x, seed 3", 0.0)]).as_deref(), Some("x, seed 3"));
        assert_eq!(description_of(&[("y, seed 3", 0.0), ("x, seed 3", 0.0)]).as_deref(), Some("x or y"));
        assert_eq!(
            description_of(&[("x, seed 3", 0.0), ("x, seed 3", 0.0), ("x, seed 4", 0.0)]).as_deref(),
            Some("x, 2 different seeds in 3 runs")
        );
        assert_eq!(
            description_of(&[("x, seed 3", 0.0), ("x, seed 4", 0.004)]).as_deref(),
            Some(
                "x, a seed of its own for each run; inference took 2.00 ms longer than drawn on average (mean drawn latency 10.0 ms)"
            )
        );
    }
}
