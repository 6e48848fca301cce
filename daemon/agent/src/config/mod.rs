//! Configuration of the agent.
//!
//! The doc comments in this module are the reference of the configuration: one per key, with unit, range and default.

mod clock;
mod clock_fault;
mod host;
mod listen;
mod observe;
mod pipeline;
mod probes;
mod reflector;
mod serve;
mod spool;

pub use clock::{ClaimSource, ClockConfig, Timestamps};
pub use clock_fault::{ClaimPolicy, ClockFaultConfig, ClockFaultStepConfig};
pub use host::HostConfig;
pub use listen::{ListenAddresses, ListenAddressesError};
pub use observe::{ObserveConfig, ObserveError, PairBy};
pub use pipeline::{Limit, LoadConfig, PipelineConfig, PlacementConfig, RemoteConfig, StartMode, WarmUp};
pub use probes::ProbesConfig;
pub use reflector::{ReflectorAddress, ReflectorAddressError};
pub use serve::ServeConfig;
pub use spool::{CompressionMode, SpoolConfig};

use peernet_inference::{BankConfig, ModelConfig, OnnxRuntimeConfig};
use serde::{Deserialize, Serialize};

/// The tables of a configuration file that belong to the agent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
// A misspelt key must not be ignored silently; the tables below refuse unknown keys, too.
#[serde(deny_unknown_fields)]
pub struct AgentConfig {
    /// `[agent]`: the host itself and its connection to the aggregator.
    #[serde(default)]
    pub agent: HostConfig,
    /// `[spool]`: where events wait for the aggregator.
    #[serde(default)]
    pub spool: SpoolConfig,
    /// `[clock]`: assumptions about the clocks, on which the intervals of one-way delays depend.
    #[serde(default)]
    pub clock: ClockConfig,
    /// `[probes]`: small packets from which the relation of two hosts' clocks is estimated.
    #[serde(default)]
    pub probes: ProbesConfig,
    /// `[clock_fault]`: faults that are injected into the wall clock and the free-running clock, for tests.
    #[serde(default, alias = "rehearsal", skip_serializing_if = "Option::is_none")]
    pub clock_fault: Option<ClockFaultConfig>,
    /// `[serve]`: addresses at which this host serves its models to peers; without this table the host does not serve.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serve: Option<ServeConfig>,
    /// `[[model]]`: the models that this host offers to its own pipelines and, with `[serve]`, to its peers.
    #[serde(default, rename = "model", skip_serializing_if = "Vec::is_empty")]
    pub models: Vec<ModelConfig>,
    /// `[bank]`: folders of further models, which are loaded when they are requested.
    #[serde(default)]
    pub bank: BankConfig,
    /// `[onnxruntime]`: the library that runs models of kind `onnx`.
    #[serde(default)]
    pub onnxruntime: OnnxRuntimeConfig,
    /// `[[pipeline]]`: the pipelines that this host runs or observes.
    #[serde(default, rename = "pipeline", skip_serializing_if = "Vec::is_empty")]
    pub pipelines: Vec<PipelineConfig>,
}

impl AgentConfig {
    /// Returns a copy without the values of `env`, which may be secret, for `run.json`. The copy still contains the
    /// arguments of programs, which may be secret as well: they are serialised only within
    /// [`with_arguments`](peernet_external::exec::with_arguments).
    pub fn redacted(&self) -> Self {
        let mut redacted = self.clone();
        redacted.models.iter_mut().for_each(ModelConfig::hide_secrets);
        redacted.pipelines = redacted.pipelines.iter().map(PipelineConfig::redacted).collect();
        redacted
    }
}
