//! Schema of a link's probing and of its configured reflector.

use peernet_stream as stream;
use serde::Serialize;
use utoipa::ToSchema;

use super::clock::{ClockOffset, Probes, RoundTrip};

/// Probing of a link.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Probing {
    /// `on`, `unanswered` or `off`.
    pub state: &'static str,
    /// Destination of the probes: `udp://host:port`; null when off.
    pub address: Option<String>,
    pub rate_hz: Option<f64>,
    /// Description of where the packets are stamped, such as in the kernel.
    pub stamps: Option<String>,
    /// Reason why probing is off, or a possible reason why no probe is answered.
    pub reason: Option<String>,
}

impl From<&stream::Probing> for Probing {
    fn from(probing: &stream::Probing) -> Self {
        let off = Self { state: "off", address: None, rate_hz: None, stamps: None, reason: None };
        match probing {
            stream::Probing::On { address, rate_hz, stamps } => Self {
                state: "on",
                address: Some(address.clone()),
                rate_hz: Some(*rate_hz),
                stamps: Some(stamps.clone()),
                ..off
            },
            stream::Probing::Unanswered { address, reason } => {
                Self { state: "unanswered", address: Some(address.clone()), reason: reason.clone(), ..off }
            }
            stream::Probing::Off(reason) => Self { reason: Some(reason.clone()), ..off },
        }
    }
}

/// A STAMP reflector that the edge's configuration names for the cloud.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Reflector {
    /// Configured address: `udp://host:port`.
    pub address: String,
    /// Always false. Nothing proves that the reflector reads the cloud's clock, so no delay of messages depends on it.
    pub tied_to_cloud: bool,
    pub probing: Probing,
    /// Counts of probes since the link was opened.
    pub probes: Probes,
    /// Round-trip times of the newest hundred answers; null before the first.
    pub round_trip: Option<RoundTrip>,
    /// The reflector's wall clock minus the edge's; null while nothing is known.
    pub offset: Option<ClockOffset>,
}

impl From<&stream::ReflectorLive> for Reflector {
    fn from(reflector: &stream::ReflectorLive) -> Self {
        Self {
            address: reflector.address.clone(),
            tied_to_cloud: false,
            probing: Probing::from(&reflector.probing),
            probes: reflector.probes.into(),
            round_trip: reflector.round_trip.map(RoundTrip::from),
            offset: reflector.offset.as_ref().map(ClockOffset::from),
        }
    }
}
