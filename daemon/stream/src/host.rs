//! Messages of a host about itself.

use peernet_clock::ClockIdentity;
use serde::{Deserialize, Serialize};

use peernet_logger::{HostId, Slug};

/// Description of a host in its hello.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HostDescription {
    /// Random identifier of the host; it stays the same when the host is renamed.
    pub id: HostId,
    /// Name for people, unique among the agents of one aggregator.
    pub name: Slug,
    /// Clocks from which the host takes its stamps.
    pub clock: ClockIdentity,
    /// Version of the agent.
    pub version: String,
    /// Hardware of the host.
    pub hardware: Hardware,
    /// Addresses at which the host serves models, separated by `, `; `None` if it serves none.
    pub serves: Option<String>,
    /// Models that the host serves.
    pub models: Vec<Slug>,
}

/// Hardware and operating system of a host.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Hardware {
    /// Model name of the processor.
    pub cpu: String,
    /// Number of logical cores.
    pub cores: u32,
    /// Bytes of main memory.
    pub memory_bytes: u64,
    /// Names of the accelerators.
    pub gpus: Vec<String>,
    /// Operating system and its version.
    pub system: String,
    /// Instruction set.
    pub architecture: String,
}

/// Load and state of a host. Metrics that the host cannot read are `None`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HostMetrics {
    /// Utilisation of all cores, 0 to 1.
    pub cpu: Option<f64>,
    /// Bytes of main memory in use.
    pub memory_used_bytes: Option<u64>,
    /// Utilisation of the accelerators, 0 to 1.
    pub gpu: Option<f64>,
    /// Highest temperature of processor and board, °C.
    pub temperature_celsius: Option<f64>,
    /// Power consumption of the board, watts.
    pub power_watts: Option<f64>,
    /// CPU time of the agent itself as a share of one core.
    pub agent_cpu: Option<f64>,
    /// Bytes of memory that the agent itself uses.
    pub agent_memory_bytes: Option<u64>,
    /// Models that the agent has loaded; `None` before the first reading. Since version 7 of the event stream.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub models: Option<ModelMetrics>,
}

/// Models that an agent has loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelMetrics {
    /// Number of loaded models, of all kinds.
    pub loaded: u32,
    /// Bytes by which the agent's resident memory grew during the loading of a model, summed over the loaded models.
    pub memory_bytes: u64,
}
