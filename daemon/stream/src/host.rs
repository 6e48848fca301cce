//! What a host tells about itself.

use peernet_clock::ClockIdentity;
use serde::{Deserialize, Serialize};

use peernet_logger::{HostId, Slug};

/// A host as it introduces itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HostDescription {
    /// Decides.
    pub id: HostId,
    /// For people, unique among the agents of one aggregator.
    pub name: Slug,
    /// Which clock its stamps come from.
    pub clock: ClockIdentity,
    /// Version of its agent.
    pub version: String,
    /// What it is made of.
    pub hardware: Hardware,
    /// Addresses at which it serves models, with `, ` between them, if it does.
    pub serves: Option<String>,
    /// Models it offers.
    pub models: Vec<Slug>,
}

/// What a host is made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Hardware {
    /// Model name of the processor.
    pub cpu: String,
    /// Logical cores.
    pub cores: u32,
    /// Bytes of main memory.
    pub memory_bytes: u64,
    /// Accelerators by name.
    pub gpus: Vec<String>,
    /// Operating system and its version.
    pub system: String,
    /// Instruction set.
    pub architecture: String,
}

/// How a host fares; fields that the host cannot read are `None`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HostMetrics {
    /// Busy share of all cores, 0 to 1.
    pub cpu: Option<f64>,
    /// Bytes of main memory in use.
    pub memory_used_bytes: Option<u64>,
    /// Busy share of the accelerators, 0 to 1.
    pub gpu: Option<f64>,
    /// Hottest sensor of processor or board, °C.
    pub temperature_celsius: Option<f64>,
    /// Power drawn by the board, watts.
    pub power_watts: Option<f64>,
    /// CPU time of the agent itself as a share of one core.
    pub agent_cpu: Option<f64>,
    /// Bytes of memory the agent itself holds.
    pub agent_memory_bytes: Option<u64>,
}
