//! What two peers tell each other when a session opens.

use std::fmt;

use peernet_clock::{ClockFaults, ClockIdentity, Discipline, Interval};
use peernet_logger::{HostId, Slug};
use peernet_stream::{Condition, Hardware, Release, VersionRange};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use uuid::Uuid;

use super::clock_socket::{ClockSocketName, well_formed};
use super::probe_key::ProbeKey;
use super::{printable, words};

/// Versions of the session protocol that this release speaks, as an edge and as a cloud.
pub const SESSION_VERSIONS: VersionRange = VersionRange::new(4, 5, Release(0, 1, 0));

/// The first version in which messages carry stamps of the free-running clocks.
pub const RAW_STAMPS_SINCE: u16 = 5;

/// The version of the protocol from which on clouds tell what they counted on a session's connection.
pub(crate) const STATISTICS_SINCE: u16 = 5;

/// Most findings about a host that a peer may tell.
pub const MAX_CONDITIONS: usize = 32;
/// Most accelerators of a peer that are kept.
const MAX_GPUS: usize = 16;
/// Most characters of each of the peer's words about its hardware that are kept.
const MAX_WORDS: usize = 128;

/// A session, by the random id that the cloud gave it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SessionId(Uuid);

impl SessionId {
    /// A new random id.
    pub(crate) fn random() -> Self {
        Self(Uuid::new_v4())
    }

    /// What it is made of.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; 16] {
        self.0.as_bytes()
    }
}

impl fmt::Display for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.0, f)
    }
}

/// Who opens a session, and for what.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionHello {
    /// The versions of the protocol that the edge speaks, [`SESSION_VERSIONS`].
    #[serde(flatten)]
    pub versions: VersionRange,
    /// The edge's id.
    pub host: HostId,
    /// The edge's name.
    pub name: Slug,
    /// The clock that the edge's stamps come from.
    pub clock: ClockIdentity,
    /// The pipeline that samples will come from.
    pub pipeline: Slug,
    /// The model wanted; `None` is the cloud's only one.
    pub model: Option<Slug>,
    /// The device it must run on, such as `cuda:0`; `None` leaves it to the cloud.
    #[serde(default, deserialize_with = "perhaps_words")]
    pub device: Option<String>,
    /// Where the edge lets the cloud prove that both read one clock; `None` where that cannot be, and in edges before 0.3.0. On the wire
    /// a name of another form is none.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "well_formed")]
    pub clock_socket: Option<ClockSocketName>,
}

/// Who serves a session, and with what.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionAccepted {
    /// The cloud's id.
    pub host: HostId,
    /// The cloud's name.
    pub name: Slug,
    /// The clock that the cloud's stamps come from.
    pub clock: ClockIdentity,
    /// The version of the program that serves, for people.
    #[serde(deserialize_with = "words")]
    pub version: String,
    /// The model.
    pub model: Slug,
    /// The device it really runs on.
    #[serde(deserialize_with = "words")]
    pub device: String,
    /// What the model is, in words, for the run's page.
    #[serde(deserialize_with = "pairs")]
    pub facts: Vec<(String, String)>,
    /// What is known of the cloud's wall clock now; [`Session::peer_clock`](crate::Session::peer_clock) tells later.
    pub host_clock: PeerClock,
    /// UDP port of the cloud's probe reflector, if it has one.
    pub probes: Option<u16>,
    /// A number that the cloud's process chose at random when it began. Answers to probes carry it, and epochs of
    /// different processes cannot be compared.
    pub instance: u64,
    /// What authenticates probes of this session and their answers, where both ends have no key of their own. `None` in clouds
    /// before 0.3.0 and in those with a key of their own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probe_key: Option<ProbeKey>,
    /// What was found of the cloud before the session; at most [`MAX_CONDITIONS`]. On the wire a longer list makes the
    /// whole message unreadable.
    #[serde(deserialize_with = "few")]
    pub conditions: Vec<Condition>,
    /// What the cloud is made of. Of what comes over the wire the first 128 characters of each word and 16 accelerators
    /// are kept.
    #[serde(deserialize_with = "short")]
    pub hardware: Hardware,
}

/// What a host tells of its clocks: when a session opens, and whenever it changes. On the wire an interval that is none, or a drift
/// that is no number, makes the whole message unreadable.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PeerClock {
    /// [`peernet_clock::Clock::wall_epoch`].
    pub epoch: u32,
    /// What its time daemon claims of its wall clock.
    #[serde(deserialize_with = "ordered")]
    pub discipline: Option<Discipline>,
    /// The same in words.
    #[serde(deserialize_with = "words")]
    pub text: String,
    /// How it is made wrong on purpose.
    #[serde(deserialize_with = "finite")]
    pub rehearsal: Option<ClockFaults>,
    /// Its free-running clock; `None` in sessions of a version before [`RAW_STAMPS_SINCE`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub raw: Option<RawClock>,
}

impl PeerClock {
    /// Returns what a session of this version tells of it.
    #[must_use]
    pub fn in_version(mut self, version: u16) -> Self {
        if version < RAW_STAMPS_SINCE {
            self.raw = None;
            if let Some(rehearsal) = &mut self.rehearsal {
                // Such a peer would take them for steps of the wall clock.
                rehearsal.steps.retain(|step| step.clock.is_wall());
            }
        }
        self
    }
}

/// What a host tells of its free-running clock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RawClock {
    /// [`peernet_clock::Clock::epoch`].
    pub epoch: u32,
    /// How far the wall clock was ahead of it when the message was made, [`peernet_clock::Clock::wall_ahead`].
    #[serde(deserialize_with = "ordered_ends")]
    pub wall_ahead: Interval,
    /// What the kernel reads it from, such as `tsc` or `kvm-clock`; empty where that is not known.
    #[serde(deserialize_with = "words")]
    pub clocksource: String,
}

fn perhaps_words<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<String>, D::Error> {
    Ok(Option::<String>::deserialize(deserializer)?.map(|text| printable(&text)))
}

fn pairs<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<(String, String)>, D::Error> {
    let pairs: Vec<(String, String)> = Vec::deserialize(deserializer)?;
    Ok(pairs.into_iter().map(|(name, value)| (printable(&name), printable(&value))).collect())
}

/// A peer's findings, which end up on terminals and pages.
fn few<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Condition>, D::Error> {
    let conditions: Vec<Condition> = Vec::deserialize(deserializer)?;
    if conditions.len() > MAX_CONDITIONS {
        return Err(D::Error::custom(format_args!("more than {MAX_CONDITIONS} conditions")));
    }
    let clean = |Condition { host, about, found, grade, advice }| Condition {
        host: printable(&host),
        about: printable(&about),
        found: printable(&found),
        grade,
        advice: printable(&advice),
    };
    Ok(conditions.into_iter().map(clean).collect())
}

/// What a peer says it is made of, which ends up in files and on pages.
fn short<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Hardware, D::Error> {
    let Hardware { cpu, cores, memory_bytes, gpus, system, architecture } =
        Hardware::deserialize(deserializer)?;
    let short = |text: String| printable(&text.chars().take(MAX_WORDS).collect::<String>());
    Ok(Hardware {
        cpu: short(cpu),
        cores,
        memory_bytes,
        gpus: gpus.into_iter().take(MAX_GPUS).map(short).collect(),
        system: short(system),
        architecture: short(architecture),
    })
}

fn ordered_ends<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Interval, D::Error> {
    let interval = Interval::deserialize(deserializer)?;
    if interval.hi < interval.lo {
        return Err(D::Error::custom("an interval that ends before it begins"));
    }
    Ok(interval)
}

/// A peer's claim, from which intervals are computed here: one that ends before it begins is none.
fn ordered<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Discipline>, D::Error> {
    let discipline: Option<Discipline> = Option::deserialize(deserializer)?;
    match discipline {
        Some(Discipline { error, .. }) if error.hi < error.lo => {
            Err(D::Error::custom("an interval that ends before it begins"))
        }
        discipline => Ok(discipline),
    }
}

fn finite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<ClockFaults>, D::Error> {
    let rehearsal: Option<ClockFaults> = Option::deserialize(deserializer)?;
    match rehearsal {
        Some(rehearsal) if !rehearsal.drift_ppm.is_finite() => {
            Err(D::Error::custom("a drift that is no number"))
        }
        rehearsal => Ok(rehearsal),
    }
}
