//! `[agent]`

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
    /// Name for people, unique among the agents of one aggregator: 1 to 64 letters, digits, dots, underscores
    /// and hyphens. Default: the machine's host name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<Slug>,
    /// Folder for what must outlive a restart, such as the host id; made when missing. Each agent needs its
    /// own. Default: `/var/lib/peernet/agent`, which the package makes.
    pub state_dir: PathBuf,
    /// Where finished iterations and live figures are sent: `tcp://host:port`, usually port 5550. Without it
    /// the agent measures and serves, and nothing is stored.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "event_stream_address")]
    pub aggregator: Option<Address>,
    /// Which clock this agent reads: agents of one machine with equal names may prove that they read one, so that one-way delays
    /// between them are exact. Another name makes peers treat it as a clock of its own, which is for tests and
    /// rehearsals. Default: `system`.
    pub clock_identity: String,
    /// Threads on which samples travel between hosts, for all pipelines and peers together; sensors and models have
    /// their own. One carries some gigabytes each second, and is quicker than several where it suffices. At most 64.
    /// Default: 1.
    pub io_threads: NonZeroUsize,
    /// Events that may wait in memory because they are not in the spool yet, which takes milliseconds unless its disk
    /// is slow, full or broken; when they are this many the newest are dropped, counted and reported as a gap. At most
    /// 10000000. Default: 50000.
    pub queue_events: NonZeroUsize,
    /// Bytes that those events may take; the same happens beyond. At most 16 GiB. Default: 33554432
    /// (32 MiB).
    pub queue_bytes: NonZeroUsize,
    /// Nodes per batch at most; up to 1000000. Default: 8192.
    pub batch_nodes: NonZeroUsize,
    /// Bytes per batch at most. Small batches keep live figures prompt on slow links, because a live update
    /// waits for the batches under way. Up to 2 MiB. Default: 131072 (128 KiB).
    pub batch_bytes: NonZeroUsize,
    /// How long the first event of a batch may wait for more; milliseconds, up to a minute. Default: 200.
    pub batch_delay_ms: u32,
    /// How long stopping may take, iterations in flight and unsent events together; milliseconds, up to a
    /// minute. What the aggregator does not take in time stays in the spool. Default: 5000.
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

/// Reads the address of an aggregator, whose network is one of those that carry the event stream.
fn event_stream_address<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Address>, D::Error> {
    let text: Option<String> = Deserialize::deserialize(deserializer)?;
    let address = text.map(|text| text.parse()).transpose();
    address.map_err(|error| D::Error::custom(InvalidEventStreamAddress(error)))
}

impl HostConfig {
    /// The configured name, or the machine's.
    ///
    /// # Errors
    /// When the machine's own name cannot be an agent's.
    pub fn host_name(&self) -> Result<Slug, InvalidName> {
        match &self.name {
            Some(name) => Ok(name.clone()),
            None => sysinfo::System::host_name().unwrap_or_default().parse(),
        }
    }

    /// How long stopping may take.
    pub fn stop_timeout(&self) -> Duration {
        Duration::from_millis(self.stop_timeout_ms)
    }
}
