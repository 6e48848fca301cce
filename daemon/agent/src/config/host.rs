//! The table `[agent]`.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

use peernet_clock::ClockIdentity;
use peernet_logger::{InvalidName, Slug};
use peernet_networks::{Address, InvalidEventStreamAddress};
use serde::{Deserialize, Deserializer, Serialize, de::Error as _};

/// `[agent]`: the host itself and its connection to the aggregator.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HostConfig {
    /// Name for people, unique among the agents of one aggregator: 1 to 64 letters, digits, dots, underscores and
    /// hyphens. Default: the machine's host name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<Slug>,
    /// Folder for files that survive a restart, such as the host id; created if missing. Each agent needs its own.
    /// Default: `/var/lib/peernet/agent`, which the package creates.
    pub state_dir: PathBuf,
    /// Address of the aggregator, to which finished iterations and live statistics are sent: `tcp://host:port`, usually
    /// port 5550. Without this key the agent measures and serves, and nothing is stored.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "event_stream_address")]
    pub aggregator: Option<Address>,
    /// Name of the clock that this agent reads. Agents of one machine whose clocks have equal names can prove that
    /// they read the same clock; one-way delays between them are then exact. Peers treat a clock with another name as a
    /// separate clock, for tests and clock fault injection. Default: `system`.
    pub clock_identity: String,
    /// Number of threads that send and receive samples, for all pipelines and peers together; sensors and models have
    /// separate threads. One thread carries some gigabytes per second. Where one thread suffices, more threads only add
    /// latency. At most 64. Default: 1.
    pub io_threads: NonZeroUsize,
    /// Maximum number of events that wait in memory until they are in the spool. They wait some milliseconds, unless
    /// the spool's disk is slow, full or failing. Beyond this number the newest events are dropped, counted and
    /// reported as a gap. At most 10000000. Default: 50000.
    pub queue_events: NonZeroUsize,
    /// Maximum number of bytes of the events that wait in memory; beyond this number the newest events are dropped,
    /// too. At most 16 GiB. Default: 33554432 (32 MiB).
    pub queue_bytes: NonZeroUsize,
    /// Maximum number of nodes per batch; up to 1000000. Default: 8192.
    pub batch_nodes: NonZeroUsize,
    /// Maximum number of bytes per batch. Small batches keep live statistics prompt on slow links, because a live
    /// update waits for the batches being sent. Up to 2 MiB. Default: 131072 (128 KiB).
    pub batch_bytes: NonZeroUsize,
    /// Longest time that the first event of a batch waits for further events; milliseconds, up to a minute. Default:
    /// 200.
    pub batch_delay_ms: u32,
    /// Longest time that stopping takes, for iterations in flight and unsent events together; milliseconds, up to a
    /// minute. Events that the aggregator does not acknowledge in time stay in the spool. Default: 5000.
    pub stop_timeout_ms: u64,
}

impl Default for HostConfig {
    fn default() -> Self {
        Self {
            name: None,
            state_dir: PathBuf::from("/var/lib/peernet/agent"),
            aggregator: None,
            clock_identity: ClockIdentity::SYSTEM.to_owned(),
            io_threads: NonZeroUsize::MIN,
            queue_events: const { NonZeroUsize::new(50_000).expect("above 0") },
            queue_bytes: const { NonZeroUsize::new(32 << 20).expect("above 0") },
            batch_nodes: const { NonZeroUsize::new(8192).expect("above 0") },
            batch_bytes: const { NonZeroUsize::new(128 << 10).expect("above 0") },
            batch_delay_ms: 200,
            stop_timeout_ms: 5000,
        }
    }
}

/// Deserialises the address of an aggregator. The error for an invalid address recommends only networks that carry the
/// event stream. The check of the configuration refuses a valid address of another network.
fn event_stream_address<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Address>, D::Error> {
    let text: Option<String> = Deserialize::deserialize(deserializer)?;
    let address = text.map(|text| text.parse()).transpose();
    address.map_err(|error| D::Error::custom(InvalidEventStreamAddress(error)))
}

impl HostConfig {
    /// Returns the configured name, or the machine's.
    ///
    /// # Errors
    /// When the machine's own name is not a valid agent name.
    pub fn host_name(&self) -> Result<Slug, InvalidName> {
        match &self.name {
            Some(name) => Ok(name.clone()),
            None => sysinfo::System::host_name().unwrap_or_default().parse(),
        }
    }

    /// Returns the time that stopping may take.
    pub fn stop_timeout(&self) -> Duration {
        Duration::from_millis(self.stop_timeout_ms)
    }
}
