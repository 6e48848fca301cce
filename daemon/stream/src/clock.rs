//! Messages about clocks: the relation between two hosts' clocks, and the claims of each host's time daemon.

use std::iter::Sum;

use peernet_clock::{
    ClockClaim, ClockFaults, Exchange, ExchangeCounts, Interval, Offset, RelatedClocks, Span, Verdict,
    WallTime,
};
use serde::ser::SerializeStruct;
use serde::{Deserialize, Serialize, Serializer};

use super::bounded::at_most;
use super::{Connection, EstimateBasis, NetworkName};
use crate::limits::{MAX_NETWORKS, MAX_PIPELINES};
use peernet_logger::{HostId, Slug};

/// State of a link in one second: the relation between a clock of the edge and a clock of the cloud, and the delays of
/// data over one network.
///
/// Clock samples are stored, so that the delays of a past run can be computed again with later exchanges.
///
/// The relation belongs to the pair of hosts. If two hosts use several networks in a second, the clock sample of each
/// network has the same relation period, exchanges, offset and probes, but its own delays.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct ClockSample {
    /// Id of the cloud.
    pub peer: HostId,
    /// Name of the cloud.
    pub peer_name: Slug,
    /// End of the second on the edge's wall clock.
    pub at: WallTime,
    /// Random number of the relation period, in which one clock relation holds. It changes when either clock is
    /// stepped. Exchanges of different relation periods cannot be combined.
    #[serde(rename = "window")]
    pub relation_period: u64,
    /// Limit of drift with which the bounds are computed, parts per million.
    pub max_drift_ppm: f64,
    /// Exchange of this second with the lowest upper bound of the offset; `None` without exchanges.
    pub upper: Option<Exchange>,
    /// Exchange of this second with the highest lower bound of the offset; `None` without exchanges.
    pub lower: Option<Exchange>,
    /// Offset at the end of the second; `None` if it is unknown.
    pub offset: Option<Offset>,
    /// Probes of this second.
    pub probes: ProbeCounts,
    /// Numbers of all accepted and refused exchanges so far.
    pub exchanges: ExchangeCounts,
    /// Round trips of this second's probes; `None` if no probe was answered.
    pub round_trip: Option<RoundTrip>,
    /// Delays of data from edge to cloud that were judged in this second; `None` if no delay was judged.
    pub up: Option<DelaySecond>,
    /// Delays of data from cloud to edge that were judged in this second; `None` if no delay was judged.
    pub down: Option<DelaySecond>,
    /// Network of the link. The serialised form lacks this field if the network is `zmq-tcp` and `basis` is `None`.
    #[serde(default)]
    pub network: NetworkName,
    /// Assumptions with which the bounds are computed; `None` in samples of releases before 0.3, which related wall
    /// clocks. Since version 7 of the event stream.
    #[serde(default)]
    pub basis: Option<EstimateBasis>,
}

impl ClockSample {
    /// Returns the clocks that stamped the exchanges.
    pub fn clocks(&self) -> RelatedClocks {
        self.basis.map_or(RelatedClocks::Wall, |basis| basis.clocks)
    }
}

impl Serialize for ClockSample {
    /// Omits the last fields if they have their defaults, so that a sample of an earlier release keeps its bytes.
    // The fields of an array are identified by position. The network can therefore be omitted only if the basis, which
    // follows the network, is omitted, too.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let has_network = self.basis.is_some() || !self.network.is_default();
        let fields = 13 + usize::from(has_network) + usize::from(self.basis.is_some());
        let mut to = serializer.serialize_struct("ClockSample", fields)?;
        to.serialize_field("peer", &self.peer)?;
        to.serialize_field("peer_name", &self.peer_name)?;
        to.serialize_field("at", &self.at)?;
        to.serialize_field("window", &self.relation_period)?;
        to.serialize_field("max_drift_ppm", &self.max_drift_ppm)?;
        to.serialize_field("upper", &self.upper)?;
        to.serialize_field("lower", &self.lower)?;
        to.serialize_field("offset", &self.offset)?;
        to.serialize_field("probes", &self.probes)?;
        to.serialize_field("exchanges", &self.exchanges)?;
        to.serialize_field("round_trip", &self.round_trip)?;
        to.serialize_field("up", &self.up)?;
        to.serialize_field("down", &self.down)?;
        if has_network {
            to.serialize_field("network", &self.network)?;
        }
        if let Some(basis) = &self.basis {
            to.serialize_field("basis", basis)?;
        }
        to.end()
    }
}

/// Delays of data in one direction within a second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DelaySecond {
    /// Number of delays that were judged.
    pub count: u32,
    /// Median of the delays that have a value, with the medians of their lower and of their upper bounds; `None` if no
    /// delay has a value. Agents before 0.3.0 send the bounds of the median delay.
    pub median: Option<DelayPoint>,
    /// 95th percentile of the verdicts, from the best to the worst: at least a twentieth of the judged delays have this
    /// verdict or a worse verdict.
    pub verdict: Verdict,
}

/// A delay with its interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DelayPoint {
    /// Estimate.
    pub value: Span,
    /// Interval that contains the true delay.
    pub bounds: Interval,
    /// Size of the message divided by the estimated delay, bits per second; `None` if the size is unknown.
    pub bits_per_second: Option<f64>,
}

/// Numbers of probes within a second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProbeCounts {
    /// Probes sent.
    pub sent: u32,
    /// Probes answered.
    pub answered: u32,
    /// Probes not answered in time.
    pub lost: u32,
    /// Packets that arrived and were refused as answers, plus probes that could not be sent. Since version 7 of the
    /// event stream.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub refused: u32,
}

impl ProbeCounts {
    /// Returns the number of probes that were answered or lost. Further probes are still on their way.
    pub const fn ended(&self) -> u32 {
        self.answered.saturating_add(self.lost)
    }

    /// Returns the share of lost probes among those that were answered or lost, 0 to 1; `None` without such probes.
    pub fn lost_share(&self) -> Option<f64> {
        (self.ended() > 0).then(|| f64::from(self.lost) / f64::from(self.ended()))
    }
}

impl Sum for ProbeCounts {
    /// Adds the counts up. A sum that does not fit is the largest `u32`.
    fn sum<I: Iterator<Item = Self>>(counts: I) -> Self {
        counts.fold(Self::default(), |sum, added| Self {
            sent: sum.sent.saturating_add(added.sent),
            answered: sum.answered.saturating_add(added.answered),
            lost: sum.lost.saturating_add(added.lost),
            refused: sum.refused.saturating_add(added.refused),
        })
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
const fn is_zero(count: &u32) -> bool {
    *count == 0
}

/// Round trips of probes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoundTrip {
    /// Shortest round trip.
    pub min: Span,
    /// Median round trip.
    pub median: Span,
}

/// Current state of a link of an agent: one cloud over one network. The relation of the clocks belongs to the pair of
/// hosts; all of the agent's pipelines and probes to the cloud contribute exchanges.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct LinkLive {
    /// Id of the cloud.
    pub peer: HostId,
    /// Name of the cloud.
    pub peer_name: Slug,
    /// Kinds of network that the link uses, at most [`MAX_NETWORKS`]. This version sends one:
    /// [`network`](Self::network).
    #[serde(deserialize_with = "at_most::<MAX_NETWORKS, _, _>")]
    pub networks: Vec<String>,
    /// Pipelines that use the link, at most [`MAX_PIPELINES`].
    #[serde(deserialize_with = "at_most::<MAX_PIPELINES, _, _>")]
    pub pipelines: Vec<Slug>,
    /// `true` if it is proven that the processes of both hosts read one clock.
    pub same_clock: bool,
    /// State of the probes.
    pub probing: Probing,
    /// Clock of the edge.
    pub edge: Option<HostClock>,
    /// Clock of the cloud.
    pub cloud: Option<HostClock>,
    /// Clock sample of the last complete second; of the current second so far if the last second has no clock sample.
    #[serde(rename = "now")]
    pub latest_sample: ClockSample,
    /// Open connections, one per pipeline, at most [`MAX_PIPELINES`]. Since version 6 of the event stream.
    #[serde(default, deserialize_with = "at_most::<MAX_PIPELINES, _, _>")]
    pub connections: Vec<Connection>,
    /// Reflector that the edge's configuration names for the cloud. Since version 7 of the event stream.
    #[serde(default)]
    pub reflector: Option<ReflectorLive>,
}

impl Serialize for LinkLive {
    /// Omits the last fields if they have their defaults, because older versions cannot read them.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let has_connections = self.reflector.is_some() || !self.connections.is_empty();
        let fields = 9 + usize::from(has_connections) + usize::from(self.reflector.is_some());
        let mut to = serializer.serialize_struct("LinkLive", fields)?;
        to.serialize_field("peer", &self.peer)?;
        to.serialize_field("peer_name", &self.peer_name)?;
        to.serialize_field("networks", &self.networks)?;
        to.serialize_field("pipelines", &self.pipelines)?;
        to.serialize_field("same_clock", &self.same_clock)?;
        to.serialize_field("probing", &self.probing)?;
        to.serialize_field("edge", &self.edge)?;
        to.serialize_field("cloud", &self.cloud)?;
        to.serialize_field("now", &self.latest_sample)?;
        if has_connections {
            to.serialize_field("connections", &self.connections)?;
        }
        if let Some(reflector) = &self.reflector {
            to.serialize_field("reflector", reflector)?;
        }
        to.end()
    }
}

/// Current state of a STAMP reflector that an edge's configuration names for a cloud. The reflector's clock may differ
/// from the cloud's clock. No delay of data is therefore computed with the reflector's clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReflectorLive {
    /// Configured address: `udp://host:port`.
    pub address: String,
    /// State of the probes.
    pub probing: Probing,
    /// Numbers of probes since the link was opened.
    pub probes: ProbeCounts,
    /// Round trips of the newest hundred answers; `None` before the first answer.
    pub round_trip: Option<RoundTrip>,
    /// Wall clock of the reflector minus the edge's wall clock; `None` if it is unknown.
    pub offset: Option<Offset>,
}

impl LinkLive {
    /// Returns the network of the link.
    pub const fn network(&self) -> &NetworkName {
        &self.latest_sample.network
    }
}

/// State of the probes of a link.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Probing {
    /// Probes are sent.
    On {
        /// Destination: `udp://host:port`.
        address: String,
        /// Current number of probes per second.
        rate_hz: f64,
        /// Origin of the stamps: `kernel, send and receive`, `kernel, receive only`, or `program`.
        stamps: String,
    },
    /// Probes are sent, but no probe was answered recently: the probes are blocked, or the reflector does not run.
    Unanswered {
        /// Destination: `udp://host:port`.
        address: String,
        /// Known cause, such as a key that only one end has; `None` if it is unknown.
        #[serde(default)]
        reason: Option<String>,
    },
    /// No probes are sent; the text gives the reason.
    Off(String),
}

/// State of a host's wall clock.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HostClock {
    /// Error bounds that the host's time daemon or its kernel claims; `None` if the clock is not synchronised or
    /// neither claims any bounds.
    #[serde(rename = "discipline")]
    pub claim: Option<ClockClaim>,
    /// Description for people, such as `chrony, stratum 2, to 10.0.0.1`, `kernel, synchronised`, `not synchronised`.
    pub text: String,
    /// Number of the clock's current epoch: the number of steps and slews of the clock and sleeps of the host since the
    /// agent started.
    pub epoch: u32,
    /// Faults that are injected into the clock.
    #[serde(rename = "rehearsal")]
    pub faults: Option<ClockFaults>,
    /// Clock hardware that the kernel reads, such as `tsc` (Linux: `current_clocksource`); `None` if the kernel does
    /// not state it. Since version 7 of the event stream.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clocksource: Option<String>,
}
