//! Conversion of one combination of the axes' values to an agent's configuration.

use std::num::NonZeroU64;
use std::path::PathBuf;

use peernet_actuators::ActuatorKind;
use peernet_agent::AgentConfig;
use peernet_agent::config::{PipelineConfig, PlacementConfig};
use peernet_analysis::record::NetworkConfig;
use peernet_inference::bank::ModelFolders;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::experiment::{Experiment, LimitError, Network, RangeError, describe_warm_up};
use super::field::{Field, FieldError};
use super::matrix::Combination;
use super::peers::PeerError;
use super::{AGENT_TABLES, File, KeyError, convert, peers};
use crate::run::check::with_experiment_keys;

/// Keys that an experiment's pipeline must not contain, with what to do instead.
const REPLACED_KEYS: [(&str, &str); 6] = [
    ("name", "use experiment.name instead"),
    ("limit", "use experiment.iterations, experiment.duration_s or experiment.episodes instead"),
    ("warm_up", "use experiment.warm_up instead"),
    ("episode_steps", "use experiment.episode_steps instead"),
    ("start", "a run starts when its turn comes"),
    ("experiment", "the program sets this key itself"),
];

/// A configuration that is measured in some runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::run) struct Configuration {
    /// Axes with their labels, in the order of the file.
    pub(in crate::run) labels: Vec<(String, String)>,
    /// Number of users: edges that use the cloud at the same time.
    pub(in crate::run) users: u32,
    /// The agent's configuration with its pipeline.
    pub(in crate::run) agent: AgentConfig,
    /// Description of the iterations that are warm-up.
    pub(in crate::run) warm_up: String,
    /// Timeout for an unreachable peer; seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(in crate::run) patience_s: Option<f64>,
    /// Seeds that follow from the experiment's seed.
    pub(in crate::run) seeds: Seeds,
}

/// Seeds that the file leaves to the experiment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(in crate::run) struct Seeds {
    /// `true` if the experiment sets the seed of the sensor.
    pub(in crate::run) sensor: bool,
    /// `true` if the experiment sets the seed of random starts.
    pub(in crate::run) load: bool,
}

/// Reason why a combination is not a valid configuration of an agent. The text begins with the key.
#[derive(Debug, thiserror::Error)]
pub(super) enum ConfigurationError {
    #[error("axis {axis} = {label}: {source}")]
    Axis { axis: String, label: String, source: FieldError },
    #[error("experiment.{0}")]
    Experiment(#[source] KeyError),
    #[error(transparent)]
    Range(#[from] RangeError),
    #[error("network.{0}")]
    Network(#[source] KeyError),
    #[error("pipeline: the table [pipeline] is missing")]
    NoPipeline,
    #[error("pipeline.{key}: an experiment does not accept this key: {instead}")]
    DecidedElsewhere { key: &'static str, instead: &'static str },
    #[error(transparent)]
    Peer(#[from] PeerError),
    #[error("{}", with_experiment_keys(&.0.to_string()))]
    Agent(#[source] KeyError),
    #[error("experiment.users: several edges need one spool each, and get one if [spool] file is omitted")]
    SharedSpool,
    #[error("experiment: {0}")]
    Limit(#[from] LimitError),
    #[error(
        "experiment.warm_up: all iterations of a run would be warm-up ({0}), so that it would have no statistics"
    )]
    AllWarmUp(String),
    /// Some axes may have set the invalid value.
    #[error("{problem} (with {})", .axes.join(", "))]
    OfAxes { problem: Box<Self>, axes: Vec<String> },
}

impl File {
    /// Returns the configuration of a combination, and the file that names its peer.
    ///
    /// # Errors
    /// When a value is invalid. The text begins with the key and ends with the axes that may have set the value.
    pub(super) fn configuration(
        &self,
        combination: &Combination<'_>,
        model_folders: &[PathBuf],
        files: &mut peers::DeviceFiles,
    ) -> Result<(Configuration, Option<NetworkConfig>), ConfigurationError> {
        let mut document = self.document.clone();
        for (axis, value) in combination {
            for (field, field_value) in &value.sets {
                let result = field.set(&mut document, field_value.clone());
                let (axis, label) = (&axis.name, &value.label);
                result.map_err(|source| ConfigurationError::Axis {
                    axis: axis.clone(),
                    label: label.clone(),
                    source,
                })?;
            }
        }
        read(document, model_folders, files)
            .map(|(configuration, network)| {
                let labels = combination.iter().map(|(axis, value)| (axis.name.clone(), value.label.clone()));
                (Configuration { labels: labels.collect(), ..configuration }, network)
            })
            .map_err(|problem| name_axes(problem, combination))
    }
}

fn read(
    mut document: Table,
    model_folders: &[PathBuf],
    files: &mut peers::DeviceFiles,
) -> Result<(Configuration, Option<NetworkConfig>), ConfigurationError> {
    let experiment = document.remove("experiment").unwrap_or_else(|| Value::Table(Table::new()));
    let experiment: Experiment = convert(experiment).map_err(ConfigurationError::Experiment)?;
    experiment.check()?;
    let network = document.remove("network").map(convert::<Network>).transpose();
    let network = network.map_err(ConfigurationError::Network)?;
    let Some(Value::Table(mut pipeline)) = document.remove("pipeline") else {
        return Err(ConfigurationError::NoPipeline);
    };
    if let Some((key, instead)) = REPLACED_KEYS.into_iter().find(|(key, _)| pipeline.contains_key(*key)) {
        return Err(ConfigurationError::DecidedElsewhere { key, instead });
    }
    // Names of devices are replaced by addresses here, because an agent's configuration knows addresses only.
    let network = peers::resolve(&mut pipeline, network.as_ref(), files)?;
    let seeds = Seeds { sensor: lacks_seed(&pipeline, "sensor"), load: lacks_seed(&pipeline, "load") };
    pipeline.insert("name".to_owned(), Value::String(experiment.name.to_string()));
    // This is checked before the conversion, which fills in the default folders of a daemon.
    let has_bank = document.contains_key("bank");
    document.retain(|key, _| AGENT_TABLES.contains(&key));
    document.insert("pipeline".to_owned(), Value::Array(vec![Value::Table(pipeline)]));
    let mut agent: AgentConfig = convert(document).map_err(ConfigurationError::Agent)?;
    if has_bank {
        // A folder on the command line precedes the folders of the file, as it precedes the default folders below.
        let folders = model_folders.iter().chain(&agent.bank.folders).cloned();
        agent.bank.folders = ModelFolders::new(folders).paths().to_vec();
    } else {
        agent.bank.folders = ModelFolders::search(model_folders).paths().to_vec();
    }
    agent.agent.aggregator = experiment.aggregator.clone().or(agent.agent.aggregator);
    // Two agents cannot write to one spool.
    if experiment.users.get() > 1 && agent.spool.file.is_some() {
        return Err(ConfigurationError::SharedSpool);
    }
    let (limit, warm_up) = (experiment.limit()?, experiment.warm_up());
    for pipeline in &mut agent.pipelines {
        pipeline.limit = limit;
        // Without feedback no episode ends early, so `limit.total` (episodes × steps) ends the run after the last
        // episode. Then `limit.episodes` stays unset, as in the plans of earlier releases.
        pipeline.limit.episodes = experiment.episodes().filter(|_| pipeline.actuator.ends_episodes());
        pipeline.warm_up = warm_up;
        pipeline.episode_steps = experiment.episode_steps;
        if let PlacementConfig::Remote(remote) = &mut pipeline.placement {
            // Plans of earlier releases contain the network, and an experiment can only be continued with an
            // unchanged plan.
            remote.network.get_or_insert(remote.peer.network());
        }
    }
    if agent.pipelines.iter().any(has_only_warm_up) {
        return Err(ConfigurationError::AllWarmUp(describe_warm_up(&warm_up)));
    }
    let configuration = Configuration {
        labels: Vec::new(),
        users: experiment.users.get(),
        agent,
        warm_up: describe_warm_up(&warm_up),
        patience_s: experiment.patience_s,
        seeds,
    };
    Ok((configuration, network))
}

/// Returns whether all iterations of a run are warm-up.
fn has_only_warm_up(pipeline: &PipelineConfig) -> bool {
    let first_measured = pipeline.iterations_until_measured(NonZeroU64::MIN);
    first_measured.is_none_or(|first| pipeline.limit.total.is_some_and(|total| total.get() < first))
}

/// Returns whether a table of the pipeline could have a seed and has none.
fn lacks_seed(pipeline: &Table, key: &str) -> bool {
    let Some(Value::Table(table)) = pipeline.get(key) else { return false };
    // Only the type of the table knows which kinds have a seed, so a seed is inserted and the table is read.
    let mut seeded = table.clone();
    let has_no_seed = seeded.insert("seed".to_owned(), Value::Integer(1)).is_none();
    has_no_seed
        && match key {
            "sensor" => parses_as::<peernet_sensors::SensorConfig>(seeded),
            _ => parses_as::<peernet_agent::config::LoadConfig>(seeded),
        }
}

fn parses_as<T: DeserializeOwned>(table: Table) -> bool {
    Value::Table(table).try_into::<T>().is_ok()
}

/// Adds to an error the axes that may have set the invalid value.
fn name_axes(problem: ConfigurationError, combination: &Combination<'_>) -> ConfigurationError {
    let text = problem.to_string();
    // The text of every error begins with the key.
    let key = text.split(": ").next().unwrap_or_default();
    let Ok(field) = Field::read(key) else { return problem };
    let axes: Vec<String> = combination
        .iter()
        .filter(|(_, value)| {
            value
                .sets
                .iter()
                // The key of an error about an unknown field is the table. Only the text names the field, in backticks.
                .any(|(set, _)| set.overlaps(&field) || text.contains(&format!("`{}`", set.key())))
        })
        .map(|(axis, value)| format!("{} = {}", axis.name, value.label))
        .collect();
    if axes.is_empty() { problem } else { ConfigurationError::OfAxes { problem: Box::new(problem), axes } }
}
