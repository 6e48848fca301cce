//! Configuration of the agent.
//!
//! The doc comments here are the reference of the configuration: one per key, with unit and default.

mod clock;
mod host;
mod listen;
mod observe;
mod pipeline;
mod probes;
mod reflector;
mod rehearsal;
mod serve;
mod spool;

pub use clock::{ClockConfig, DisciplineSource, Timestamps};
pub use host::HostConfig;
pub use listen::{ListenAddresses, ListenAddressesError};
pub use observe::{ObserveConfig, ObserveError, PairBy};
pub use pipeline::{Limit, LoadConfig, PipelineConfig, PlacementConfig, RemoteConfig, StartMode, WarmUp};
pub use probes::ProbesConfig;
pub use reflector::{ReflectorAddress, ReflectorAddressError};
pub use rehearsal::{RehearsalConfig, RehearsedDiscipline, RehearsedStepConfig};
pub use serve::ServeConfig;
pub use spool::{CompressionMode, SpoolConfig};

use peernet_inference::{BankConfig, ModelConfig, OnnxRuntimeConfig};
use serde::{Deserialize, Serialize};

/// The tables of a configuration file that belong to the agent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AgentConfig {
    /// `[agent]`: the host itself and its connection to the aggregator.
    #[serde(default)]
    pub agent: HostConfig,
    /// `[spool]`: where events wait for the aggregator.
    #[serde(default)]
    pub spool: SpoolConfig,
    /// `[clock]`: what one-way delays rest on.
    #[serde(default)]
    pub clock: ClockConfig,
    /// `[probes]`: small packets that relate two hosts' clocks.
    #[serde(default)]
    pub probes: ProbesConfig,
    /// `[rehearsal]`: makes this host's clocks wrong on purpose: the wall clock, and by its drift or a step the free-running one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rehearsal: Option<RehearsalConfig>,
    /// `[serve]`: where peers may ask for this host's models; without it they may not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serve: Option<ServeConfig>,
    /// `[[model]]`: the models that this host offers to its own pipelines and, with `[serve]`, to its peers.
    #[serde(default, rename = "model", skip_serializing_if = "Vec::is_empty")]
    pub models: Vec<ModelConfig>,
    /// `[bank]`: folders of further models, which are offered as well and loaded when they are asked for.
    #[serde(default)]
    pub bank: BankConfig,
    /// `[onnxruntime]`: the library that runs models of kind `onnx`.
    #[serde(default)]
    pub onnxruntime: OnnxRuntimeConfig,
    /// `[[pipeline]]`: what this host measures.
    #[serde(default, rename = "pipeline", skip_serializing_if = "Vec::is_empty")]
    pub pipelines: Vec<PipelineConfig>,
}

impl AgentConfig {
    /// Without the values of `env`, which may be secret, for `run.json`. The arguments of programs, which may be secret as well, are still
    /// there and are written within [`with_arguments`](peernet_external::exec::with_arguments) alone.
    pub fn publishable(&self) -> Self {
        let mut told = self.clone();
        told.models.iter_mut().for_each(ModelConfig::hide_secrets);
        told.pipelines = told.pipelines.iter().map(PipelineConfig::publishable).collect();
        told
    }
}
