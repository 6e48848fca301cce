//! `run.json`: the record of a run, complete enough to repeat it.

mod clocks;

pub use crate::outcomes::Counts;
pub use clocks::{BoundedEstimate, Clocks, DelayQuality};

use std::collections::BTreeMap;

use chrono::{DateTime, Utc};
use peernet_clock::WallTime;
use peernet_logger::{HostId, RunId};
use peernet_stream::{Condition, EndReason, ExperimentPosition, Hardware, PlacementKind};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::accuracy::Accuracy;
use crate::actuator_results::ActuatorResults;
use crate::deadline::Misses;
use crate::rows::Units;
use crate::trust;

/// Format version that this program writes.
pub const FORMAT: u32 = 1;

/// Everything about a run except its rows. Unknown values are `None` or empty, so that results of other programs and of
/// other versions can be read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RunRecord {
    /// Format of the record, [`FORMAT`]; 0 if there was no `run.json`.
    pub format: u32,
    /// The pipeline's name.
    pub name: String,
    /// Title of figures and tables.
    pub title: String,
    /// The run's id, as in a store.
    pub run: Option<RunId>,
    /// Start of the run, on the edge's wall clock.
    pub started: Option<DateTime<Utc>>,
    /// End of the run.
    pub ended: Option<DateTime<Utc>>,
    /// Reason for the end of the run.
    pub reason: EndReason,
    /// Version of the program that measured.
    pub version: String,
    /// Command line that started the run.
    pub command: String,
    /// Working directory of the command. Relative paths in the command and in the configuration start in this
    /// directory.
    pub folder: String,
    /// Environment variables that influence file lookup and speed, if they were set.
    pub environment: BTreeMap<String, String>,
    /// The file with the addresses of the devices that the command or the experiment names; `None` if neither names
    /// one.
    pub network_config: Option<NetworkConfig>,
    /// Edge host, which ran the sensor.
    pub edge: HostRecord,
    /// Cloud host, which ran the model; `None` if the run had no cloud host, or if the host was not reached.
    pub cloud: Option<HostRecord>,
    /// Place where the model ran.
    pub placement: Placement,
    /// Model of the run; `None` if a sensor ran alone.
    pub model: Option<ModelRecord>,
    /// Facts about sensor, transforms, load and so on, as pairs of name and text for display.
    pub facts: Vec<(String, String)>,
    /// The pipeline's table of the configuration.
    pub pipeline: Value,
    /// The other tables of the agent's configuration.
    pub agent: Value,
    /// Position of the run in an experiment; `None` if the run does not belong to an experiment.
    pub experiment: Option<ExperimentPosition>,
    /// Number of this edge among the edges that used the cloud at the same time; `None` if this edge was alone.
    pub user: Option<User>,
    /// Longest wait for a missing peer, before the run and during it; seconds.
    #[serde(rename = "patience_s")]
    pub peer_timeout_s: Option<f64>,
    /// Seeds of random quantities, by their purpose.
    pub seeds: BTreeMap<String, u64>,
    /// Text that says which iterations are warm-up.
    pub warm_up: String,
    /// Number of iterations by outcome.
    pub counts: Counts,
    /// Deadline of an iteration, seconds; `None` without a deadline.
    pub deadline_s: Option<f64>,
    /// Number of iterations that missed the deadline; `None` without a deadline.
    pub misses: Option<Misses>,
    /// Superseded answers, and success and return of the episodes.
    pub actuator: ActuatorResults,
    /// Quality of the delays: their verdicts, sources and bounds.
    pub clocks: Clocks,
    /// Accuracy of the model, by column: `top-1`, `top-5`; empty if the right answers are not known.
    pub accuracy: BTreeMap<String, Accuracy>,
    /// Units of the columns that the run logged in addition to the standard columns.
    pub units: Units,
    /// Report on whether the run can be published; `None` if it was not judged.
    pub trust: Option<trust::Report>,
}

impl RunRecord {
    /// Returns whether a sensor ran alone, without a model.
    pub fn is_sensor_only(&self) -> bool {
        self.placement.is(PlacementKind::None)
    }
}

/// File with the addresses of the devices (`net_config.yaml` in the paper), as it was when the command started.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct NetworkConfig {
    /// Path of the file, as given on the command line.
    pub file: String,
    /// Content of the file.
    pub text: String,
}

/// Number of an edge among several that use one cloud at the same time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct User {
    /// Number of this edge, from 1.
    pub number: u32,
    /// Number of edges that use the cloud at the same time.
    #[serde(rename = "of")]
    pub count: u32,
}

/// Host that took part in a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HostRecord {
    /// Name for people.
    pub name: String,
    /// Random identifier of the host, which stays the same when the host is renamed.
    pub id: Option<HostId>,
    /// Version of the program on this host.
    pub version: String,
    /// Hardware of the host.
    pub hardware: Option<Hardware>,
    /// Program that disciplines the clock, in words, such as `chrony, stratum 2, to 10.0.0.1`; empty if the clock
    /// was not inspected.
    pub clock: String,
    /// Conditions of the host, found before the run, that affect measurements.
    pub conditions: Vec<Condition>,
}

/// Place where the model of a run ran, if the run had a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Placement {
    /// Kind of placement: `local`, `remote` or `none`; empty, or another word, in results of other programs.
    pub kind: String,
    /// Kind of network of a remote placement, such as `zmq-tcp`.
    pub network: Option<String>,
    /// Address of the peer of a remote placement.
    pub address: Option<String>,
}

impl Placement {
    /// Returns whether the record names this kind.
    pub fn is(&self, kind: PlacementKind) -> bool {
        self.kind == kind.name()
    }
}

/// The model of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct ModelRecord {
    /// Name in the model bank.
    pub name: String,
    /// Device that the model ran on; `None` if it is not known.
    pub device: Option<String>,
    /// SHA-256 of the model's file, hexadecimal; `None` if the model has no file or the hash is not known.
    pub sha256: Option<String>,
}

/// Converts a wall time to the form in `run.json`.
pub fn to_utc(at: WallTime) -> DateTime<Utc> {
    DateTime::from_timestamp_nanos(at.unix_nanos())
}

#[cfg(test)]
mod tests;
