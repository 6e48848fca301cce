//! State that the links of an agent share, and their sessions.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use peernet_clock::{RelationSettings, SharedClock};
use peernet_logger::Slug;
use peernet_networks::{PeerClock, ProbeKey, StatisticsReader};
use peernet_probes::{Key, KeyError, TimestampSource};
use peernet_stream::NetworkName;
use tokio::sync::watch;

use crate::config::{ClockConfig, ProbesConfig, ReflectorAddress, Timestamps};
use crate::event_queue::EventQueue;
use crate::incidents::Incidents;
use crate::same_clock::ClockPeers;

/// The parts of the agent that links use.
#[derive(Clone, Debug)]
pub(crate) struct LinkContext {
    /// Name of this host.
    pub(crate) name: Slug,
    pub(crate) clock: SharedClock,
    /// State of this host's clocks.
    pub(crate) host_clock: watch::Receiver<PeerClock>,
    pub(crate) event_queue: EventQueue,
    pub(crate) incidents: Incidents,
}

/// State that all links share.
#[derive(Debug)]
pub(super) struct SharedLinkState {
    /// The parts of this host's agent that links use.
    pub(super) host: LinkContext,
    pub(super) relation: RelationSettings,
    pub(super) probes: ProbeSettings,
}

/// Settings of the probes.
#[derive(Clone, Debug)]
pub(crate) struct ProbeSettings {
    pub(super) send: bool,
    pub(super) rate_hz: f64,
    pub(super) idle_rate_hz: f64,
    pub(crate) key: Option<Key>,
    pub(super) padding_bytes: u16,
    pub(crate) stamps: TimestampSource,
    /// Reflectors that are named for clouds, by the names of the clouds.
    pub(super) reflectors: BTreeMap<Slug, ReflectorAddress>,
}

impl ProbeSettings {
    /// Returns the configured settings; reads the file of the key.
    ///
    /// # Errors
    /// When the key cannot be read.
    pub(crate) fn read(probes: &ProbesConfig, clock: &ClockConfig) -> Result<Self, KeyError> {
        let key = probes.key_file.as_deref().map(Key::read).transpose()?;
        let stamps = match clock.timestamps {
            Timestamps::Kernel => TimestampSource::Kernel,
            Timestamps::User => TimestampSource::Program,
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

    /// Returns the key for the probes of a session: the configured key, or else the key that came with the session.
    pub(super) fn key_for(&self, session: &Session) -> Option<Key> {
        let session_key = || session.probe_key.map(|key| Key::from_bytes(key.as_bytes()));
        self.key.clone().or_else(session_key)
    }
}

/// A session with a cloud, as its link uses it.
#[derive(Clone, Debug)]
pub(super) struct Session {
    pub(super) id: u64,
    pub(super) pipeline: Slug,
    pub(super) network: NetworkName,
    /// Host name or address of the cloud.
    pub(super) host: String,
    /// UDP port of the cloud's probe reflector.
    pub(super) probe_port: Option<u16>,
    /// Random number of the process that serves the session.
    pub(super) instance: u64,
    /// Key from the cloud to authenticate probes.
    pub(super) probe_key: Option<ProbeKey>,
    /// Announcements of the cloud about its clocks.
    pub(super) clock: watch::Receiver<PeerClock>,
    /// Processes that may prove that they read this host's clock.
    pub(super) clock_peers: ClockPeers,
    /// Statistics of the session's connection.
    pub(super) statistics: StatisticsReader,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A poisoned lock is used, too: a panic of the thread that held the lock leaves the values incomplete at worst.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
