//! Position of a run in an experiment, and conditions of the hosts before a run.

use serde::{Deserialize, Serialize};

/// Position of a run in an experiment: the configuration and the repeat that it measures.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExperimentPosition {
    /// Name of the experiment in its file.
    pub name: String,
    /// Random id of the execution of the experiment; all runs of the execution have this id.
    pub id: String,
    /// Difference between this configuration and the others: for each axis, its name and the label of this
    /// configuration's value on the axis, in the order of the file.
    pub configuration: Vec<(String, String)>,
    /// Repetition of the configuration, from 0.
    pub repeat: u32,
    /// Index of the configuration in the experiment's file, from 0; `None` if an earlier version ran the experiment.
    #[serde(default, rename = "position", skip_serializing_if = "Option::is_none")]
    pub configuration_index: Option<u32>,
    /// Number of edges that measure the repeat at the same time; `None` if an earlier version ran the experiment.
    // The wire form is a list of values without names. `edges` may therefore be present only if `configuration_index`,
    // which precedes it, is present.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edges: Option<u32>,
}

/// A finding about a host that affects how far a measurement on it can be trusted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Condition {
    /// Name of the host.
    pub host: String,
    /// Subject, such as `CPU governor` or `competing load`.
    pub about: String,
    /// Finding for people, with unit.
    pub found: String,
    /// Effect on the measurement.
    pub grade: Grade,
    /// Advice to the user; empty if nothing needs to be done.
    pub advice: String,
}

/// Effect of a finding on a measurement, ordered from harmless to harmful.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grade {
    /// The finding is as recommended.
    Good,
    /// The effect is unknown; there is no sign of a problem.
    Unknown,
    /// The results may be affected.
    Doubtful,
    /// The results are not valid for their purpose.
    Bad,
}
