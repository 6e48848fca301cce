//! What is told of clocks: the relation of two hosts' clocks, and what each host's time daemon says.

use peernet_clock::{
    Discipline, Exchange, ExchangeCounts, Interval, Offset, RehearsalDescription, RelatedClocks, Span,
    Verdict, WallTime,
};
use serde::ser::SerializeStruct;
use serde::{Deserialize, Serialize, Serializer};

use super::bounded::at_most;
use super::{Connection, EstimateBasis, NetworkName};
use crate::limits::{MAX_NETWORKS, MAX_PIPELINES};
use peernet_logger::{HostId, Slug};

/// One second of a link: the relation between a clock of an edge and one of a cloud, and the delays of data over one network.
/// Stored, so that the delays of a past run can be computed again with what was learnt after it.
///
/// The relation belongs to the pair of hosts. Where two hosts use several networks in a second, the sample of each has the
/// same window, exchanges, offset and probes, and delays of its own.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct ClockSample {
    /// The cloud.
    pub peer: HostId,
    /// Its name.
    pub peer_name: Slug,
    /// The end of the second, on the edge's wall clock.
    pub at: WallTime,
    /// A random number per relation, which changes when either clock is stepped: exchanges of different windows
    /// say nothing about each other.
    pub window: u64,
    /// The limit of drift that the bounds rest on, parts per million.
    pub max_drift_ppm: f64,
    /// Of this second's exchanges the one that bounds the offset best from above; `None` when there was none.
    pub upper: Option<Exchange>,
    /// The one that bounds it best from below.
    pub lower: Option<Exchange>,
    /// What was known at the end of the second; `None` while nothing is.
    pub offset: Option<Offset>,
    /// Probes of this second.
    pub probes: ProbeCounts,
    /// What became of all exchanges so far.
    pub exchanges: ExchangeCounts,
    /// Round trips of this second's probes; `None` when none came back.
    pub round_trip: Option<RoundTrip>,
    /// Delays of data from edge to cloud, judged in this second; `None` when there were none.
    pub up: Option<DelaySecond>,
    /// From cloud to edge.
    pub down: Option<DelaySecond>,
    /// The network of the link. Left out where it is `zmq-tcp` and nothing follows.
    #[serde(default)]
    pub network: NetworkName,
    /// What the bounds rest on; `None` in samples of releases before 0.3, which related wall clocks. Since version 7 of the event
    /// stream.
    #[serde(default)]
    pub basis: Option<EstimateBasis>,
}

impl ClockSample {
    /// The clocks that the stamps of the exchanges are of.
    pub fn clocks(&self) -> RelatedClocks {
        self.basis.map_or(RelatedClocks::Wall, |basis| basis.clocks)
    }
}

impl Serialize for ClockSample {
    /// Leaves out the last values where they say nothing, so that a sample of an earlier release keeps its bytes. Values of an array
    /// are known by their positions: the network can only be left out together with what follows.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let has_network = self.basis.is_some() || !self.network.is_default();
        let fields = 13 + usize::from(has_network) + usize::from(self.basis.is_some());
        let mut to = serializer.serialize_struct("ClockSample", fields)?;
        to.serialize_field("peer", &self.peer)?;
        to.serialize_field("peer_name", &self.peer_name)?;
        to.serialize_field("at", &self.at)?;
        to.serialize_field("window", &self.window)?;
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

/// The delays of data in one direction within a second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DelaySecond {
    /// How many were judged.
    pub count: u32,
    /// The median of those that have a value, with the bounds of that very one; `None` when none has.
    pub median: Option<DelayPoint>,
    /// The worst verdict that at least a twentieth of them were given.
    pub verdict: Verdict,
}

/// A delay as a point with its error bar.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DelayPoint {
    /// The estimate.
    pub value: Span,
    /// Contains the truth.
    pub bounds: Interval,
    /// Bits per second over the estimate; `None` when the size is not known.
    pub bits_per_second: Option<f64>,
}

/// What became of the probes of a second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProbeCounts {
    /// Sent.
    pub sent: u32,
    /// Came back.
    pub answered: u32,
    /// Did not come back in time.
    pub lost: u32,
    /// Packets that arrived and were refused as answers, and probes that could not be sent. Since version 7 of the event stream.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub refused: u32,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
const fn is_zero(count: &u32) -> bool {
    *count == 0
}

/// Round trips of probes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoundTrip {
    /// The shortest.
    pub min: Span,
    /// The median.
    pub median: Span,
}

/// A link of an agent, now: one cloud over one network. The relation of the clocks is that of the pair of hosts, fed by all
/// of the agent's pipelines and probes to the cloud.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct LinkLive {
    /// The cloud.
    pub peer: HostId,
    /// Its name.
    pub peer_name: Slug,
    /// Kinds of network in use: that of the link, which counts as [`network`](Self::network). At most [`MAX_NETWORKS`].
    #[serde(deserialize_with = "at_most::<MAX_NETWORKS, _, _>")]
    pub networks: Vec<String>,
    /// The pipelines that use it, at most [`MAX_PIPELINES`].
    #[serde(deserialize_with = "at_most::<MAX_PIPELINES, _, _>")]
    pub pipelines: Vec<Slug>,
    /// Whether it is proven that the processes of both hosts read one clock.
    pub same_clock: bool,
    /// How it is probed.
    pub probing: Probing,
    /// What the edge's time daemon says.
    pub edge: Option<HostClock>,
    /// What the cloud's says.
    pub cloud: Option<HostClock>,
    /// The last second, or as much of it as has passed.
    pub now: ClockSample,
    /// Open connections, one for each pipeline, at most [`MAX_PIPELINES`]; since version 6 of the event
    /// stream.
    #[serde(default, deserialize_with = "at_most::<MAX_PIPELINES, _, _>")]
    pub connections: Vec<Connection>,
    /// The reflector that the edge's configuration names for the cloud; since version 7 of the event stream.
    #[serde(default)]
    pub reflector: Option<ReflectorLive>,
}

impl Serialize for LinkLive {
    /// Leaves out the last values where they say nothing: older versions cannot read them.
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
        to.serialize_field("now", &self.now)?;
        if has_connections {
            to.serialize_field("connections", &self.connections)?;
        }
        if let Some(reflector) = &self.reflector {
            to.serialize_field("reflector", reflector)?;
        }
        to.end()
    }
}

/// A STAMP reflector that an edge's configuration names for a cloud, now. Its clock is its own: nothing says that it is the clock of the
/// cloud, and no delay of data rests on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReflectorLive {
    /// As it is configured: `udp://host:port`.
    pub address: String,
    /// How it is probed.
    pub probing: Probing,
    /// Probes since the link was opened.
    pub probes: ProbeCounts,
    /// Round trips of the newest hundred answers; `None` before the first.
    pub round_trip: Option<RoundTrip>,
    /// The reflector's wall clock minus that of the edge; `None` while nothing is known.
    pub offset: Option<Offset>,
}

impl LinkLive {
    /// The network of the link.
    pub const fn network(&self) -> &NetworkName {
        &self.now.network
    }
}

/// How a link is probed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Probing {
    /// Probes go out.
    On {
        /// Where to: `udp://host:port`.
        address: String,
        /// How many per second now.
        rate_hz: f64,
        /// Where the stamps are made, in words: `kernel, send and receive`, `kernel, receive only`, `program`.
        stamps: String,
    },
    /// Probes go out and none has come back lately: blocked, or the reflector is gone.
    Unanswered {
        /// Where to.
        address: String,
        /// What is known to be wrong, such as a key that only one end has; `None` when nothing is.
        #[serde(default)]
        reason: Option<String>,
    },
    /// No probes; the text says why.
    Off(String),
}

/// What is known of one host's wall clock.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HostClock {
    /// What the host's time daemon, or the kernel, claims; `None` when the clock is not synchronised or nobody says.
    pub discipline: Option<Discipline>,
    /// In words: `chrony, stratum 2, to 10.0.0.1`, `kernel, synchronised`, `not synchronised`.
    pub text: String,
    /// How often the clock was found stepped, run off or asleep, since the agent started.
    pub epoch: u32,
    /// How the clock is made wrong on purpose.
    pub rehearsal: Option<RehearsalDescription>,
    /// What the kernel reads the time from, such as `tsc` (Linux: `current_clocksource`); `None` where it does not tell. Since
    /// version 7 of the event stream.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clocksource: Option<String>,
}
