//! The file of an experiment: settings that are common to all runs, and the axes along which they differ.
//!
//! Every combination of the axes' values is set in a copy of the document. The copy is then read as an agent's
//! configuration, so that any setting of an agent can be an axis, and an agent's code checks the setting.

mod axis;
mod configuration;
mod experiment;
mod field;
mod field_override;
mod matrix;
mod peers;

pub(super) use axis::Axis;
pub(super) use configuration::Configuration;
pub(super) use experiment::{Experiment, Order};
pub(super) use field_override::FieldOverride;

use std::fmt;
use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use crate::renamed_tables::rename_tables;
use crate::small_file;
use crate::toml_errors::describe_error;
use anyhow::{Context, anyhow};
use peernet_analysis::record::NetworkConfig;
use toml::{Table, Value};

use axis::{AxisError, AxisTable};
use matrix::MatrixError;

/// Tables of the file besides those of an agent.
const EXPERIMENT_TABLES: [&str; 4] = ["experiment", "network", "pipeline", "axis"];
/// Tables of an agent's configuration that an experiment may contain.
const AGENT_TABLES: [&str; 8] =
    ["agent", "spool", "clock", "probes", "clock_fault", "model", "bank", "onnxruntime"];

/// An experiment's file.
pub(super) struct File {
    /// Settings that are common to all runs.
    pub(super) experiment: Experiment,
    /// The axes.
    pub(super) axes: Vec<Axis>,
    path: PathBuf,
    /// The document without the axes.
    document: Table,
}

/// Reason why a document is not the file of an experiment. The text begins with the key.
#[derive(Debug, thiserror::Error)]
enum FileError {
    #[error("{0}: an experiment has no such table, only {own} and {agent}", own = EXPERIMENT_TABLES.join(", "), agent = AGENT_TABLES.join(", "))]
    UnknownTable(String),
    #[error("axis{0}")]
    Axes(#[source] KeyError),
    #[error("the table [experiment] is missing")]
    NoExperiment,
    #[error("experiment.{0}")]
    Experiment(#[source] KeyError),
    #[error("axis[{index}]: {source}")]
    Axis { index: usize, source: AxisError },
    #[error("axis[{index}].name: there is an axis {name} already")]
    SameName { index: usize, name: String },
    #[error(
        "axis[{index}]: {name} overwrites what {earlier} sets; an axis may only change a part of what an earlier axis sets, so put {name} first or give each axis separate fields"
    )]
    Overwrites { index: usize, name: String, earlier: String },
}

/// An invalid value; the text begins with the path of the key.
#[derive(Debug, thiserror::Error)]
struct KeyError {
    path: String,
    source: toml::de::Error,
}

impl fmt::Display for KeyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The path of the whole document is a dot.
        f.write_str(&format!("{}: {}", self.path, describe_error(&self.source)).replace(".: ", ": "))
    }
}

impl File {
    /// Reads a file and replaces the values that `sets` names.
    ///
    /// # Errors
    /// When it does not exist (exit code 66), something in it is wrong (exit code 78), or a replaced value has no
    /// effect (exit code 64).
    pub(super) fn read(path: &Path, sets: &[FieldOverride]) -> Result<Self, Failure> {
        let text = small_file::read(path, small_file::MAX_BYTES)
            .with_context(|| format!("cannot read the experiment {}", path.display()))
            .map_err(|error| Failure::new(Exit::NoInput, error))?;
        let invalid = |error: &dyn fmt::Display| {
            Failure::new(Exit::Configuration, anyhow!("{}: {error}", path.display()))
        };
        let mut document: Table = text.parse().map_err(|error: toml::de::Error| invalid(&error))?;
        rename_tables(&mut document).map_err(|error| invalid(&error))?;
        let usage = |error| Failure::new(Exit::Usage, anyhow!("--set: {error}"));
        sets.iter().try_for_each(|set| set.apply(&mut document)).map_err(usage)?;
        let file = Self::parse(document, path).map_err(|error| invalid(&error))?;
        sets.iter().try_for_each(|set| set.check(&file.axes)).map_err(usage)?;
        Ok(file)
    }

    /// Returns the configurations of the experiment with the files that name their peers: every combination of the
    /// axes' values that is not excluded, the last axis changing fastest. `model_folders` are the folders of models on
    /// the command line.
    ///
    /// # Errors
    /// When something is wrong, with the key of each error (exit code 78).
    pub(super) fn configurations(
        &self,
        model_folders: &[PathBuf],
    ) -> Result<(Vec<Configuration>, Vec<Option<NetworkConfig>>), Failure> {
        let invalid = |text: String| Failure::new(Exit::Configuration, anyhow!("{text}"));
        let with_path = |error| invalid(format!("{}: {error}", self.path.display()));
        let combinations = matrix::combinations(&self.axes, &self.experiment.exclude).map_err(with_path)?;
        self.check_run_count(combinations.len()).map_err(with_path)?;
        let (mut configurations, mut networks) = (Vec::new(), Vec::new());
        let (mut problems, mut files) = (Vec::<String>::new(), peers::DeviceFiles::default());
        for combination in combinations {
            match self.configuration(&combination, model_folders, &mut files) {
                Ok((configuration, network)) => {
                    configurations.push(configuration);
                    networks.push(network);
                }
                Err(problem) => {
                    let problem = problem.to_string();
                    // The same error in every combination is reported once.
                    if !problems.contains(&problem) {
                        problems.push(problem);
                    }
                }
            }
        }
        if problems.is_empty() {
            return Ok((configurations, networks));
        }
        let file = self.path.display();
        Err(invalid(
            problems.iter().map(|problem| format!("{file}: {problem}")).collect::<Vec<_>>().join("\n"),
        ))
    }

    /// Checks the number of runs before any is planned.
    fn check_run_count(&self, configuration_count: usize) -> Result<(), MatrixError> {
        let repeats = self.experiment.repeats.get();
        let run_count = configuration_count as u64 * u64::from(repeats);
        if run_count <= matrix::MAX_RUNS as u64 { Ok(()) } else { Err(MatrixError::TooManyRuns(run_count)) }
    }

    fn parse(mut document: Table, path: &Path) -> Result<Self, FileError> {
        if let Some(key) = document
            .keys()
            .find(|key| !EXPERIMENT_TABLES.contains(&key.as_str()) && !AGENT_TABLES.contains(&key.as_str()))
        {
            return Err(FileError::UnknownTable(key.clone()));
        }
        let axes = document.remove("axis").unwrap_or_else(|| Value::Array(Vec::new()));
        let tables: Vec<AxisTable> = convert(axes).map_err(FileError::Axes)?;
        let experiment = document.get("experiment").cloned();
        let experiment = experiment.ok_or(FileError::NoExperiment)?;
        let experiment = convert(experiment).map_err(FileError::Experiment)?;
        let mut axes: Vec<Axis> = Vec::new();
        for (index, table) in tables.into_iter().enumerate() {
            let axis = Axis::read(table).map_err(|source| FileError::Axis { index, source })?;
            if axes.iter().any(|other| other.name == axis.name) {
                return Err(FileError::SameName { index, name: axis.name });
            }
            if let Some(other) = axes.iter().find(|other| axis.overwrites(other)) {
                let earlier = other.name.clone();
                return Err(FileError::Overwrites { index, name: axis.name, earlier });
            }
            axes.push(axis);
        }
        Ok(Self { experiment, axes, path: path.to_owned(), document })
    }
}

/// Converts a value to its type.
fn convert<T: serde::de::DeserializeOwned>(value: impl Into<Value>) -> Result<T, KeyError> {
    serde_path_to_error::deserialize(value.into())
        .map_err(|error| KeyError { path: error.path().to_string(), source: error.into_inner() })
}

#[cfg(test)]
mod tests;
