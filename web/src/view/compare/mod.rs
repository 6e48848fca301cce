//! Several runs side by side, from their roll-ups, and from so few single rows that the length of a run does not matter.

mod ask;
mod choice;
mod differing;
mod distributions;
mod done;
pub(crate) mod gather;
pub(crate) mod lengths;
mod median;
mod order;
mod payload;
mod pictures;
mod series;
mod spread;
mod table;
#[cfg(test)]
pub(crate) mod tests;
mod throughput;
mod users;

pub(crate) use ask::{commands, doubts, unknown_labels};
pub(crate) use distributions::{Address, Distributions, distributions};
pub(crate) use gather::{Courses, MOST_RUNS, Which, courses, gather};
pub(crate) use lengths::{Lengths, answers, lengths};
pub(crate) use payload::{accuracy, payload};
pub(crate) use pictures::{Axes, Pair, StackRow, pairs, stacks};
pub(crate) use series::{OverTime, over_time, run_courses};
pub(crate) use spread::{BoxRow, boxes};
pub(crate) use table::{Changed, Table, difference, open, title, too_short};
pub(crate) use throughput::{Throughput, throughput};
pub(crate) use users::{UsersRow, users};

use std::collections::HashMap;
use std::sync::Arc;

use peernet_report::trust::Starts;
use peernet_statistics::Summary;
use peernet_store::{Bound, Figures, Kept, RunSummary, StageStatistics};
use peernet_stream::PlacementKind;

use crate::view::trust;

/// What is compared.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Comparison {
    /// The experiment that all runs belong to, name and id, where one was asked for.
    pub experiment: Option<(String, String)>,
    /// What the configurations differ in.
    pub axes: Vec<String>,
    /// Names of what chosen runs differ in as well, in hashes, paths and lists that no table has room for.
    pub also: Vec<String>,
    /// An experiment's by their labels, axis by axis; runs as they were asked for.
    pub configurations: Vec<Configuration>,
    /// All that is kept of each run, by its number.
    pub kept: HashMap<i64, Arc<Kept>>,
    /// Runs of the experiment that do not count, oldest first.
    pub left_out: Vec<LeftOut>,
    /// Whether there were more runs than are compared.
    pub cut: bool,
}

/// A run that is not compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LeftOut {
    /// Its number.
    pub run: i64,
    /// How it ended, or as which one it was done again.
    pub why: String,
}

/// Runs of one configuration, taken together.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Configuration {
    /// `A`, `B` and so on: what pictures call it.
    pub letter: String,
    /// Its value on each axis.
    pub values: Vec<String>,
    /// Oldest first.
    pub runs: Vec<RunSummary>,
    /// Of all its runs together.
    pub stages: Vec<StageStatistics>,
    /// How well the one-way delays are known.
    pub bounds: Vec<Bound>,
    /// All that is kept of its runs together.
    pub kept: Arc<Kept>,
}

impl Configuration {
    /// Figures of a node by its name.
    pub(crate) fn figures(&self, name: &str) -> Option<&Figures> {
        self.stages.iter().find(|stage| stage.stage == *name).map(|stage| &stage.figures)
    }

    /// The values of a node in all its runs together, in its SI unit.
    pub(crate) fn known(&self, name: &str) -> Option<&Summary> {
        self.kept.known(name)
    }

    /// Figures of the total, seconds; of the sensor alone where there is no more.
    pub(crate) fn total(&self) -> Option<&Figures> {
        self.figures("total").or_else(|| self.figures("sensing"))
    }

    /// What became of the starts that an open loop ordered.
    pub(crate) fn starts(&self) -> Starts {
        let of_runs = self.runs.iter().map(trust::starts);
        of_runs.fold(Starts::default(), |all, run| Starts {
            kept: all.kept + run.kept,
            skipped: all.skipped + run.skipped,
            ..all
        })
    }

    fn placement(&self) -> Option<&peernet_stream::Placement> {
        self.runs.first().map(|run| &run.placement)
    }

    fn kind(&self) -> Option<PlacementKind> {
        self.placement().map(|placement| placement.kind)
    }
}

impl Comparison {
    /// The place of the configuration with the lowest mean of the total; `None` where there is nothing to compare.
    pub(crate) fn best(&self) -> Option<usize> {
        let measured: Vec<(usize, f64)> = self
            .configurations
            .iter()
            .enumerate()
            .filter_map(|(at, one)| Some((at, one.total()?.mean)))
            .collect();
        let best = measured.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
        (measured.len() > 1).then_some(best.0)
    }

    /// The values of a node in one run, by its number.
    pub(crate) fn known(&self, run: i64, name: &str) -> Option<&Summary> {
        self.kept.get(&run)?.known(name)
    }

    /// All runs, configuration by configuration.
    pub(crate) fn runs(&self) -> impl Iterator<Item = &RunSummary> {
        self.configurations.iter().flat_map(|one| &one.runs)
    }
}

/// `A` to `Z`, then `AA`.
pub(crate) fn letter(mut at: usize) -> String {
    let mut text = String::new();
    loop {
        text.insert(0, char::from(b'A' + (at % 26) as u8));
        at = match (at / 26).checked_sub(1) {
            Some(rest) => rest,
            None => return text,
        };
    }
}
