//! Hello and acceptance: the data that edge and cloud exchange when a session opens.

use std::fmt;

use peernet_clock::{ClockClaim, ClockFaults, ClockIdentity, Interval};
use peernet_logger::{HostId, Slug};
use peernet_stream::{Condition, Hardware, Release, VersionRange};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use uuid::Uuid;

use super::clock_socket::{ClockSocketName, deserialize_optional_socket_name};
use super::probe_key::ProbeKey;
use super::{deserialize_text, to_printable};

/// Versions of the session protocol that this release speaks, as an edge and as a cloud.
///
/// A release that changes messages raises the newest version, and keeps writing the older forms in sessions of an older
/// version. When a release drops the oldest version, the `Release` below becomes the first release that speaks the new
/// oldest version.
///
/// | release | versions |
/// | --- | --- |
/// | 0.1.0 | 4 |
/// | 0.2.0 | 4; from this release on, messages state a range of versions |
/// | 0.3.0 | 4 to 6 |
///
/// Version 5 adds stamps of the free-running clocks to departures, replies and clock states, and reports of the cloud's
/// statistics. Epochs count interruptions of the free-running clock in version 5 and steps of the wall clock in version
/// 4. Version 6 adds partial replies, their acknowledgement, and the cancellation of requests.
pub const SESSION_VERSIONS: VersionRange = VersionRange::new(4, 6, Release(0, 1, 0));

/// First version in which messages carry stamps of the free-running clocks.
pub const RAW_STAMPS_SINCE: u16 = 5;

/// First version with partial replies and cancellation.
pub(crate) const PARTIAL_REPLIES_SINCE: u16 = 6;

/// First version in which clouds report the statistics of their end of a session's connection.
pub(crate) const STATISTICS_SINCE: u16 = 5;

/// Maximum number of conditions of a host that a peer may send.
pub const MAX_CONDITIONS: usize = 32;
/// Maximum number of accelerators that are read of a peer's hardware; further accelerators are ignored.
const MAX_GPUS: usize = 16;
/// Maximum number of characters that are read of each text about a peer's hardware.
const MAX_TEXT_CHARS: usize = 128;

/// Random identifier of a session, chosen by the cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SessionId(Uuid);

impl SessionId {
    /// Returns a new random id.
    pub(crate) fn random() -> Self {
        Self(Uuid::new_v4())
    }

    /// Returns the 16 bytes of the id.
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

/// An edge's request to open a session: the edge's identity and the model that it needs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionHello {
    /// Versions of the protocol that the edge speaks, [`SESSION_VERSIONS`].
    #[serde(flatten)]
    pub versions: VersionRange,
    /// Id of the edge.
    pub host: HostId,
    /// Name of the edge.
    pub name: Slug,
    /// Identity of the clock that the edge's stamps come from.
    pub clock: ClockIdentity,
    /// Pipeline whose samples will be sent.
    pub pipeline: Slug,
    /// Requested model; `None` requests the only model of the cloud.
    pub model: Option<Slug>,
    /// Requested device, such as `cuda:0`; `None` leaves the choice to the cloud.
    #[serde(default, deserialize_with = "deserialize_optional_text")]
    pub device: Option<String>,
    /// Socket through which the cloud can prove that both hosts read one clock. `None` if the edge has no such socket,
    /// and from releases before 0.3.0. A name of another form is read as `None`.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "deserialize_optional_socket_name"
    )]
    pub clock_socket: Option<ClockSocketName>,
}

/// A cloud's acceptance of a session: the cloud's identity, model and state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionAccepted {
    /// Id of the cloud.
    pub host: HostId,
    /// Name of the cloud.
    pub name: Slug,
    /// Identity of the clock that the cloud's stamps come from.
    pub clock: ClockIdentity,
    /// Version of the cloud's program, for people.
    #[serde(deserialize_with = "deserialize_text")]
    pub version: String,
    /// Name of the model.
    pub model: Slug,
    /// Device on which the model runs.
    #[serde(deserialize_with = "deserialize_text")]
    pub device: String,
    /// Properties of the model as pairs of name and value, for the page of the run.
    #[serde(deserialize_with = "deserialize_text_pairs")]
    pub facts: Vec<(String, String)>,
    /// State of the cloud's clocks at the acceptance; [`Session::peer_clock`](crate::Session::peer_clock) returns later
    /// states.
    pub host_clock: PeerClock,
    /// UDP port of the cloud's probe reflector; `None` if it has none.
    pub probes: Option<u16>,
    /// Random number that the cloud's process chose at its start. Answers to probes carry it. Epochs of different
    /// processes cannot be compared.
    pub instance: u64,
    /// Key that authenticates probes of this session and their answers if neither end has a configured key. `None` in
    /// releases before 0.3.0 and for clouds with a configured key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probe_key: Option<ProbeKey>,
    /// Conditions that were found on the cloud before the session; at most [`MAX_CONDITIONS`]. A message with more
    /// conditions is refused.
    #[serde(deserialize_with = "deserialize_conditions")]
    pub conditions: Vec<Condition>,
    /// Hardware of the cloud. Deserialization shortens each text to 128 characters and the accelerators to the first
    /// 16.
    #[serde(deserialize_with = "deserialize_hardware")]
    pub hardware: Hardware,
}

/// State of a host's clocks, sent when a session opens and whenever it changes.
///
/// A message is refused if one of its intervals ends before it begins, or if the drift of the clock fault is not
/// finite.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PeerClock {
    /// Epoch of the wall clock, [`peernet_clock::Clock::wall_epoch`].
    pub epoch: u32,
    /// Claim of the host's time daemon about the wall clock.
    #[serde(rename = "discipline", deserialize_with = "deserialize_claim")]
    pub claim: Option<ClockClaim>,
    /// Description of the claim, for people.
    #[serde(deserialize_with = "deserialize_text")]
    pub text: String,
    /// Clock fault that is injected on this host, if any.
    #[serde(rename = "rehearsal", deserialize_with = "deserialize_clock_faults")]
    pub faults: Option<ClockFaults>,
    /// State of the free-running clock; `None` in versions before [`RAW_STAMPS_SINCE`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub raw: Option<RawClock>,
}

impl PeerClock {
    /// Returns the state in the form that a session of this version sends.
    #[must_use]
    pub fn in_version(mut self, version: u16) -> Self {
        if version < RAW_STAMPS_SINCE {
            self.raw = None;
            if let Some(faults) = &mut self.faults {
                // A peer of an older version knows only steps of the wall clock and would apply all steps to it.
                faults.steps.retain(|step| step.clock.is_wall());
            }
        }
        self
    }
}

/// State of a host's free-running clock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RawClock {
    /// Epoch of the free-running clock, [`peernet_clock::Clock::epoch`].
    pub epoch: u32,
    /// Difference wall clock minus free-running clock when the message was made, [`peernet_clock::Clock::wall_ahead`].
    #[serde(deserialize_with = "deserialize_interval")]
    pub wall_ahead: Interval,
    /// Clocksource of the kernel, such as `tsc` or `kvm-clock`; empty if unknown.
    #[serde(deserialize_with = "deserialize_text")]
    pub clocksource: String,
}

fn deserialize_optional_text<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<String>, D::Error> {
    Ok(Option::<String>::deserialize(deserializer)?.map(|text| to_printable(&text)))
}

fn deserialize_text_pairs<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<(String, String)>, D::Error> {
    let pairs: Vec<(String, String)> = Vec::deserialize(deserializer)?;
    Ok(pairs.into_iter().map(|(name, value)| (to_printable(&name), to_printable(&value))).collect())
}

/// Deserializes at most [`MAX_CONDITIONS`] conditions and makes their texts printable, because they are shown on
/// terminals and pages.
fn deserialize_conditions<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Condition>, D::Error> {
    // The conditions are counted after the list was read: the limit of the header already bounds the memory of the
    // list.
    let conditions: Vec<Condition> = Vec::deserialize(deserializer)?;
    if conditions.len() > MAX_CONDITIONS {
        return Err(D::Error::custom(format_args!("more than {MAX_CONDITIONS} conditions")));
    }
    let make_printable = |Condition { host, about, found, grade, advice }| Condition {
        host: to_printable(&host),
        about: to_printable(&about),
        found: to_printable(&found),
        grade,
        advice: to_printable(&advice),
    };
    Ok(conditions.into_iter().map(make_printable).collect())
}

/// Deserializes a peer's hardware and shortens its texts, because they are stored in files and shown on pages.
fn deserialize_hardware<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Hardware, D::Error> {
    let Hardware { cpu, cores, memory_bytes, gpus, system, architecture } =
        Hardware::deserialize(deserializer)?;
    let shorten = |text: String| to_printable(&text.chars().take(MAX_TEXT_CHARS).collect::<String>());
    Ok(Hardware {
        // The texts are shortened and not refused, because an unusual text must not prevent a session.
        cpu: shorten(cpu),
        cores,
        memory_bytes,
        gpus: gpus.into_iter().take(MAX_GPUS).map(shorten).collect(),
        system: shorten(system),
        architecture: shorten(architecture),
    })
}

/// Deserializes an interval. Refuses an interval that ends before it begins, because offsets are computed from it.
fn deserialize_interval<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Interval, D::Error> {
    let interval = Interval::deserialize(deserializer)?;
    if interval.hi < interval.lo {
        return Err(D::Error::custom("the interval ends before it begins"));
    }
    Ok(interval)
}

/// Deserializes a time daemon's claim. Refuses a claim whose interval ends before it begins, because the intervals of
/// delays are computed from the claim.
fn deserialize_claim<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<ClockClaim>, D::Error> {
    let claim: Option<ClockClaim> = Option::deserialize(deserializer)?;
    match claim {
        Some(ClockClaim { error, .. }) if error.hi < error.lo => {
            Err(D::Error::custom("the interval ends before it begins"))
        }
        claim => Ok(claim),
    }
}

/// Deserializes clock faults. Refuses a drift that is not finite, because no clock can have it.
fn deserialize_clock_faults<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<ClockFaults>, D::Error> {
    let faults: Option<ClockFaults> = Option::deserialize(deserializer)?;
    match faults {
        Some(faults) if !faults.drift_ppm.is_finite() => {
            Err(D::Error::custom("the clock drift is not a finite number"))
        }
        faults => Ok(faults),
    }
}
