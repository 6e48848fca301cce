//! Arguments of `peernet run`.

use std::path::PathBuf;

use crate::short::shorten_value;

use super::file::FieldOverride;
use super::plan::{Plan, Run};

/// Arguments of `peernet run`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// File of the experiment, TOML; docs/experiments.md describes it, configs/experiments has examples. The file may
    /// be a pipe: `/dev/stdin`.
    #[arg(value_name = "FILE")]
    pub(super) file: PathBuf,
    /// Replace a value of the file, such as experiment.iterations=100; may be given several times. Values of an axis
    /// take precedence.
    #[arg(long, value_name = "FIELD=VALUE", value_parser = FieldOverride::read)]
    pub(super) set: Vec<FieldOverride>,
    /// Folder for the results. If it has an unfinished experiment, that experiment continues [default: results/NAME].
    #[arg(long, value_name = "DIR")]
    pub(super) result_loc: Option<PathBuf>,
    /// Only check the file: contact no peer, load no model, write nothing.
    #[arg(long, conflicts_with = "dry_run")]
    pub(super) check: bool,
    /// Contact all peers, load all models, and show the runs with their expected duration, without measuring.
    #[arg(long)]
    pub(super) dry_run: bool,
    /// Seed of the order of the runs and of the payloads, instead of the file's.
    #[arg(long)]
    pub(super) seed: Option<u64>,
    /// Execute only the runs with this label, or the run with this number; may be given several times. A run must match
    /// one of the labels of each axis that is named. The other runs can be executed later.
    #[arg(long, value_name = "AXIS=LABEL|NUMBER", value_parser = RunSelection::read)]
    pub(super) only: Vec<RunSelection>,
    /// Start without asking for confirmation.
    #[arg(long, short)]
    pub(super) yes: bool,
    /// Remove the results in the folder, and start again.
    #[arg(long)]
    pub(super) restart: bool,
    /// Folder of models that is searched before the others; may be given several times.
    #[arg(long, value_name = "DIR")]
    pub(super) models_dir: Vec<PathBuf>,
    /// Do not show the progress.
    #[arg(long, short)]
    pub(super) quiet: bool,
}

/// Selection of runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum RunSelection {
    /// Axis and label: the runs that have this label on this axis.
    Label(String, String),
    /// The run with this number.
    Number(usize),
}

/// A text that is not a valid selection of runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("write AXIS=LABEL or the number of a run")]
pub(super) struct InvalidRunSelection;

impl RunSelection {
    fn read(text: &str) -> Result<Self, InvalidRunSelection> {
        match (text.split_once('='), text.parse()) {
            (Some((axis, label)), _) => Ok(Self::Label(axis.trim().to_owned(), label.trim().to_owned())),
            (None, Ok(number)) => Ok(Self::Number(number)),
            (None, Err(_)) => Err(InvalidRunSelection),
        }
    }

    /// Returns whether a run is selected. Without selections all runs are selected.
    pub(super) fn selects(selections: &[Self], plan: &Plan, run: &Run) -> bool {
        let numbers: Vec<usize> = selections
            .iter()
            .filter_map(|selection| match selection {
                Self::Number(number) => Some(*number),
                Self::Label(..) => None,
            })
            .collect();
        let labels = &plan.configuration(run).labels;
        let matches_axis = |axis: &str| {
            let has = |label: &str| labels.iter().any(|(name, value)| name == axis && value == label);
            selections
                .iter()
                .any(|selection| matches!(selection, Self::Label(name, label) if name == axis && has(label)))
        };
        let matches_all_axes = selections.iter().all(|selection| match selection {
            Self::Label(axis, _) => matches_axis(axis),
            Self::Number(_) => true,
        });
        matches_all_axes && (numbers.is_empty() || numbers.contains(&run.number))
    }

    /// Describes the first selection that matches no run; `None` if each selection matches a run.
    pub(super) fn describe_unknown(selections: &[Self], plan: &Plan) -> Option<String> {
        selections.iter().find_map(|selection| match selection {
            Self::Number(number) if (1..=plan.runs.len()).contains(number) => None,
            Self::Number(number) => Some(format!("there is no run {number}; there are {}", plan.runs.len())),
            Self::Label(axis, label) => {
                let all_labels =
                    || plan.configurations.iter().flat_map(|configuration| &configuration.labels);
                let mut labels: Vec<&str> = Vec::new();
                for (_, label) in all_labels().filter(|(name, _)| name == axis) {
                    if !labels.contains(&label.as_str()) {
                        labels.push(label);
                    }
                }
                match labels.as_slice() {
                    [] => Some(format!("there is no axis {}", shorten_value(axis))),
                    labels if labels.contains(&label.as_str()) => None,
                    labels => Some(format!(
                        "{axis} has no value {}, only {}",
                        shorten_value(label),
                        labels.join(", ")
                    )),
                }
            }
        })
    }
}
