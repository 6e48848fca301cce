//! Runs that were declared together, and what was found of the hosts before one began.

use serde::{Deserialize, Serialize};

/// The place of a run in an experiment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExperimentPlace {
    /// The experiment, by the name in its file.
    pub name: String,
    /// Which execution of it: all runs of one have the same random id.
    pub id: String,
    /// What distinguishes this configuration from the others: pairs of an axis' name and the value's label, in the
    /// order of the file.
    pub configuration: Vec<(String, String)>,
    /// Which repetition of the configuration, from 0.
    pub repeat: u32,
}

/// Something about a host that decides how far a measurement on it can be trusted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Condition {
    /// The host's name.
    pub host: String,
    /// What was looked at: `CPU governor`, `Wi-Fi power save`, `competing load`.
    pub about: String,
    /// What was found, in words, with unit.
    pub found: String,
    /// What that means for the measurement.
    pub grade: Grade,
    /// What to do about it; empty when there is nothing to do.
    pub advice: String,
}

/// What a finding means for a measurement. The order is from harmless to harmful.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grade {
    /// As it should be.
    Good,
    /// Could not be found out; nothing speaks against it.
    Unknown,
    /// To be mentioned beside the figures.
    Doubtful,
    /// The figures do not show what they are meant to show.
    Bad,
}
