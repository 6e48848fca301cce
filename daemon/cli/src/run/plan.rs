//! Plan of an experiment: its runs, their order and their configurations.
//!
//! The plan depends on the file and the seed only. A killed experiment is continued if the plan of the file and the
//! seed equals the recorded plan.

use std::collections::BTreeMap;

use peernet_actuators::ActuatorKind;
use peernet_agent::AgentConfig;
use peernet_analysis::compare::describe_labels;
use peernet_external::exec::with_arguments;
use peernet_external::{REPEAT_VARIABLE, SEED_VARIABLE, USER_VARIABLE};
use peernet_logger::Slug;
use peernet_sensors::SensorKind;
use peernet_statistics::SplitMix64;
use peernet_stream::ExperimentPosition;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::file::{Configuration, Experiment, Order};

/// Maximum length of a label in a folder's name, characters.
const MAX_LABEL_CHARS: usize = 24;
/// Maximum length of a folder's name without number and repeat, characters.
const MAX_NAME_CHARS: usize = 120;

/// The runs in order, and all data from which they are derived.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Plan {
    /// The experiment's name.
    pub(super) name: Slug,
    /// Seed of order and payloads.
    pub(super) seed: u64,
    /// Order of the runs.
    pub(super) order: Order,
    /// Number of times that each configuration is measured.
    pub(super) repeats: u32,
    /// Configurations in the order of the file.
    pub(super) configurations: Vec<Configuration>,
    /// Runs in the order of their execution.
    pub(super) runs: Vec<Run>,
}

/// One run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Run {
    /// Number of the run, from 1.
    pub(super) number: usize,
    /// Index of the run's configuration in the plan.
    pub(super) configuration: usize,
    /// Index of the run among the repeats of its configuration, from 0.
    pub(super) repeat: u32,
    /// Name of the run's folder below `runs`.
    pub(super) folder: String,
}

impl Plan {
    /// Makes the plan of an experiment with these configurations.
    pub(super) fn new(
        experiment: &Experiment,
        seed: Option<u64>,
        configurations: Vec<Configuration>,
    ) -> Self {
        let seed = seed.unwrap_or(experiment.seed);
        let mut random = StdRng::seed_from_u64(seed);
        let (repeats, count) = (experiment.repeats.get(), configurations.len());
        let mut order: Vec<(u32, usize)> = Vec::new();
        for repeat in 0..repeats {
            let mut block: Vec<usize> = (0..count).collect();
            // Each repeat is shuffled separately, so that a slow change of the network affects all configurations
            // alike.
            if experiment.order == Order::Random {
                block.shuffle(&mut random);
            }
            order.extend(block.into_iter().map(|configuration| (repeat, configuration)));
        }
        // With equal numbers of digits, the folders are in the order of their numbers.
        let width = order.len().to_string().len().max(3);
        let runs = order.into_iter().enumerate().map(|(index, (repeat, configuration))| {
            let number = index + 1;
            let name = name_suffix(&configurations[configuration].labels);
            Run { number, configuration, repeat, folder: format!("{number:0width$}{name}-r{}", repeat + 1) }
        });
        Self {
            name: experiment.name.clone(),
            seed,
            order: experiment.order,
            repeats,
            runs: runs.collect(),
            configurations,
        }
    }

    /// Returns the configuration of a run.
    pub(super) fn configuration(&self, run: &Run) -> &Configuration {
        &self.configurations[run.configuration]
    }

    /// Returns the configuration of the agent of a user, counted from 0, for a run. A *user* of the experiment is one
    /// of the edges that use the cloud at the same time.
    pub(super) fn agent(&self, run: &Run, user: u32, id: &str) -> AgentConfig {
        let mut agent = self.seeded_agent(self.configuration(run), run.repeat, user);
        agent.agent.name = self.agent_name(run, user);
        for pipeline in &mut agent.pipelines {
            pipeline.experiment = Some(self.experiment_position(run, id));
        }
        agent
    }

    /// Returns the configuration of the agent of a user, counted from 0, with the seeds of a repeat. Environment
    /// variables tell custom code the seed, the repeat and the user.
    pub(super) fn seeded_agent(&self, configuration: &Configuration, repeat: u32, user: u32) -> AgentConfig {
        let mut agent = configuration.agent.clone();
        // Repeats and users get different payloads and draws. Configurations get the same ones, so that they can be
        // compared. The purposes are 1 for the sensor, 2 for the load, 3 for the actuator and 4 for the models.
        let seed = |purpose: u64| derive_seed(&[self.seed, purpose, repeat.into(), user.into()]);
        let set_variables = |env: Option<&mut BTreeMap<String, String>>, seed: u64| {
            let Some(env) = env else { return };
            let numbers = [
                (SEED_VARIABLE, seed),
                (REPEAT_VARIABLE, u64::from(repeat) + 1),
                (USER_VARIABLE, u64::from(user) + 1),
            ];
            for (name, number) in numbers {
                env.entry(name.to_owned()).or_insert_with(|| number.to_string());
            }
        };
        for pipeline in &mut agent.pipelines {
            if configuration.seeds.sensor {
                pipeline.sensor = pipeline.sensor.take().map(|sensor| with_seed(&sensor, seed(1)));
            }
            if configuration.seeds.load {
                pipeline.load = with_seed(&pipeline.load, seed(2));
            }
            set_variables(pipeline.sensor.as_mut().and_then(SensorKind::env_mut), seed(1));
            set_variables(pipeline.actuator.env_mut(), seed(3));
        }
        for model in &mut agent.models {
            if let Some(model_seed) = model.seed_mut() {
                model_seed.get_or_insert(seed(4));
            }
            set_variables(model.env_mut(), seed(4));
        }
        agent
    }

    /// Returns the position of a run in the execution of the experiment with this `id`.
    pub(super) fn experiment_position(&self, run: &Run, id: &str) -> ExperimentPosition {
        ExperimentPosition {
            name: self.name.to_string(),
            id: id.to_owned(),
            configuration: self.configuration(run).labels.clone(),
            repeat: run.repeat,
            configuration_index: u32::try_from(run.configuration).ok(),
            edges: Some(self.configuration(run).users),
        }
    }

    /// Returns the name of the agent of a user, numbered if there are several users. `None` if the file has no name and
    /// a single agent takes the name of the machine.
    pub(super) fn agent_name(&self, run: &Run, user: u32) -> Option<Slug> {
        let configuration = self.configuration(run);
        let agent = &configuration.agent.agent;
        if configuration.users == 1 {
            return agent.name.clone();
        }
        let (name, number) = (agent.host_name().ok()?, format!("-{}", user + 1));
        // The end of a long name is omitted, so that the number fits. All characters of a name are ASCII.
        let name = name.as_str().get(..Slug::MAX_CHARS - number.len()).unwrap_or(name.as_str());
        format!("{name}{number}").parse().ok()
    }

    /// Describes the run: `Where = cloud, Model = S, repeat 2`.
    pub(super) fn describe(&self, run: &Run) -> String {
        let repeat = (self.repeats > 1).then_some(run.repeat);
        let description = describe_labels(&self.configuration(run).labels, repeat);
        if description.is_empty() { self.name.to_string() } else { description }
    }

    /// Describes the run with its experiment: `demo: Where = cloud, repeat 2`.
    pub(super) fn title(&self, run: &Run) -> String {
        let (name, description) = (self.name.as_str(), self.describe(run));
        // A run without axes and repeats already has the experiment's name.
        if description == name { description } else { format!("{name}: {description}") }
    }
}

/// Returns the labels as a part of a folder's name, each after a hyphen.
fn name_suffix(labels: &[(String, String)]) -> String {
    let plain_char =
        |char: char| if char.is_ascii_alphanumeric() || "._".contains(char) { char } else { '-' };
    let label = |label: &String| label.chars().take(MAX_LABEL_CHARS).map(plain_char).collect::<String>();
    let mut name: String = labels.iter().map(|(_, text)| format!("-{}", label(text))).collect();
    name.truncate(MAX_NAME_CHARS);
    name
}

/// Derives a seed from the numbers that identify its purpose. The seed has at most 53 bits, so that
/// programs that read JSON numbers as `f64` do not round it.
fn derive_seed(numbers: &[u64]) -> u64 {
    numbers.iter().fold(0, |state, number| SplitMix64::new(state ^ number).bits()) >> 11
}

/// Sets the seed of a configuration. A configuration of a kind that has no seed stays unchanged.
fn with_seed<T: Clone + Serialize + serde::de::DeserializeOwned>(config: &T, seed: u64) -> T {
    // Without `with_arguments`, a program would lose its arguments.
    let seeded = with_arguments(|| serde_json::to_value(config)).ok().and_then(|mut value| {
        value.as_object_mut()?.insert("seed".to_owned(), Value::from(seed));
        serde_json::from_value(value).ok()
    });
    seeded.unwrap_or_else(|| config.clone())
}

#[cfg(test)]
mod tests;
