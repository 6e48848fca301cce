//! What the links of an agent have in common, and the sessions that they stand for.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use peernet_clock::{RelationSettings, SharedClock};
use peernet_logger::Slug;
use peernet_networks::{PeerClock, ProbeKey, StatisticsReader};
use peernet_probes::{Key, KeyError, Stamps};
use peernet_stream::NetworkName;
use tokio::sync::watch;

use crate::config::{ClockConfig, ProbesConfig, ReflectorAddress, Timestamps};
use crate::event_queue::EventQueue;
use crate::incidents::Incidents;
use crate::same_clock::ClockPeers;

/// What links need of their host.
#[derive(Clone, Debug)]
pub(crate) struct Near {
    pub(crate) name: Slug,
    pub(crate) clock: SharedClock,
    /// What is known of this host's clocks.
    pub(crate) own: watch::Receiver<PeerClock>,
    pub(crate) event_queue: EventQueue,
    pub(crate) incidents: Incidents,
}

/// What all links have in common.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) host: Near,
    pub(super) relation: RelationSettings,
    pub(super) probes: ProbeSettings,
}

/// How links are probed.
#[derive(Clone, Debug)]
pub(crate) struct ProbeSettings {
    pub(super) send: bool,
    pub(super) rate_hz: f64,
    pub(super) idle_rate_hz: f64,
    pub(crate) key: Option<Key>,
    pub(super) padding_bytes: u16,
    pub(crate) stamps: Stamps,
    /// Reflectors that are named for clouds, by their names.
    pub(super) reflectors: BTreeMap<Slug, ReflectorAddress>,
}

impl ProbeSettings {
    /// What the configuration says; reads the file of the key.
    ///
    /// # Errors
    /// When the key cannot be read.
    pub(crate) fn read(probes: &ProbesConfig, clock: &ClockConfig) -> Result<Self, KeyError> {
        let key = probes.key_file.as_deref().map(Key::read).transpose()?;
        let stamps = match clock.timestamps {
            Timestamps::Kernel => Stamps::Kernel,
            Timestamps::User => Stamps::Program,
        };
        Ok(Self {
            send: probes.send,
            rate_hz: probes.rate_hz,
            idle_rate_hz: probes.idle_rate_hz,
            key,
            padding_bytes: probes.padding_bytes,
            stamps,
            reflectors: probes.reflectors.clone(),
        })
    }

    /// The key for probes of a session: the configured one, else the one that came with the session.
    pub(super) fn key_for(&self, session: &Session) -> Option<Key> {
        let given = || session.probe_key.map(|key| Key::from_bytes(key.as_bytes()));
        self.key.clone().or_else(given)
    }
}

/// A session with a cloud, as its link sees it.
#[derive(Clone, Debug)]
pub(super) struct Session {
    pub(super) id: u64,
    pub(super) pipeline: Slug,
    pub(super) network: NetworkName,
    /// Where the cloud is found.
    pub(super) host: String,
    /// UDP port of its probe reflector.
    pub(super) probes: Option<u16>,
    /// The process that serves it.
    pub(super) instance: u64,
    /// What it gave to authenticate probes.
    pub(super) probe_key: Option<ProbeKey>,
    /// What it tells of its clock.
    pub(super) clock: watch::Receiver<PeerClock>,
    /// Who may prove that the process which serves it reads this host's clock.
    pub(super) clock_peers: ClockPeers,
    /// What was sent and received on its connection.
    pub(super) statistics: StatisticsReader,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic under the lock leaves figures that are at worst incomplete.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
