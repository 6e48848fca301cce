//! Schema of links: the relation between two hosts' clocks, and the state of the network between them.

use peernet_aggregator::LinkSnapshot;
use peernet_clock::{ExchangeCounts, Span};
use peernet_store::{ClockPoint, ClockSeries, DelayAssumptions, LinkRow};
use serde::Serialize;
use utoipa::ToSchema;

use super::clock::{ClockOffset, Delay, Probes, RoundTrip};
use super::connections::LinkConnection;
use super::probing::{Probing, Reflector};
use crate::api::schema::{Assumptions, HostClock, time};
use crate::view::link::Subject;
use crate::view::link::basis::promise;

/// All links that report or are stored.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct LinkList {
    pub links: Vec<Link>,
}

/// One link: an edge and a cloud over one network.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Link {
    /// `EDGE~CLOUD` over `zmq-tcp`, else `EDGE~CLOUD~NETWORK`.
    pub name: String,
    pub edge: String,
    pub edge_id: String,
    pub cloud: String,
    pub cloud_id: String,
    /// Kind of network, such as `zmq-tcp`.
    pub network: String,
    /// `true` if the edge reports the link now.
    pub connected: bool,
    /// Time of the newest sample, on the edge's wall clock.
    pub last_sample: String,
    /// Sentence that states the conditions under which the bounds contain the true delays; null if both hosts read one clock.
    pub promise: Option<String>,
    /// Assumptions as figures, by the newest sample.
    pub assumptions: Option<Assumptions>,
    /// Current state; null for a link that is not in the live state.
    pub now: Option<LinkNow>,
}

/// Current state of a link.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct LinkNow {
    /// Kinds of network in use: always one, that of the link.
    pub networks: Vec<String>,
    pub pipelines: Vec<String>,
    /// `true` if it is proven now that the processes of both hosts read one clock; the offset is then exactly zero.
    pub same_clock: bool,
    /// Worst of the verdicts of the offset and of the delays of the last ten seconds in both directions;
    /// `unsynchronised` without an offset, and `ok` if both hosts read one clock.
    pub verdict: Option<&'static str>,
    pub probing: Probing,
    pub edge_clock: Option<HostClock>,
    pub cloud_clock: Option<HostClock>,
    /// Limit of drift that the bounds assume, parts per million.
    pub max_drift_ppm: f64,
    pub exchanges: Exchanges,
    /// Open connections, one for each pipeline.
    pub connections: Vec<LinkConnection>,
    /// The reflector that the edge's configuration names for the cloud (`[probes] reflectors`); null if it names none.
    pub reflector: Option<Reflector>,
    /// Statistics of the last second.
    #[serde(flatten)]
    pub second: LinkPoint,
}

/// Counts of all exchanges so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Exchanges {
    /// Number of exchanges that were accepted.
    pub taken: u64,
    /// Number of exchanges rejected because no pair of clocks can produce them.
    pub impossible: u64,
    /// Number of exchanges rejected because they contradict all other exchanges.
    pub outliers: u64,
    /// Number of exchanges rejected because a clock was stepped during the exchange.
    pub stepped: u64,
    /// Number of relation periods that began after a step or a suspected jump of a clock.
    pub restarts: u32,
}

impl From<ExchangeCounts> for Exchanges {
    fn from(counts: ExchangeCounts) -> Self {
        let ExchangeCounts { accepted: taken, impossible, outliers, stepped, restarts } = counts;
        Self { taken, impossible, outliers, stepped, restarts }
    }
}

/// Clock relation at one time, and network statistics of the time around it.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct LinkPoint {
    /// The end of the second or bucket, on the edge's wall clock.
    pub at: String,
    /// Offset; null while it is unknown. For a bucket, the offset with the widest bounds.
    pub offset: Option<ClockOffset>,
    pub probes: Probes,
    /// Null when no probe came back.
    pub round_trip: Option<RoundTrip>,
    /// Delays of data, edge to cloud; null when there were none.
    pub up: Option<Delay>,
    /// Delays of data, cloud to edge; null when there were none.
    pub down: Option<Delay>,
    /// Clocks that the offset relates: `raw`, `raw-to-wall` or `wall`. A free-running (`raw`) clock counts from the boot of its machine.
    pub clocks: &'static str,
    /// Interval in which the exchanges place the relative rate of the two clocks; null while the rate is not bounded.
    pub proven_skew: Option<ProvenSkew>,
    /// Age of the oldest exchange that bounds the offset, seconds, if exchanges are so rare that the window grew beyond
    /// `[clock] window_s`; else null.
    #[serde(rename = "grown_window_s")]
    pub oldest_exchange_age_s: Option<f64>,
}

/// Interval in which the exchanges place the relative rate of two clocks, parts per million.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ProvenSkew {
    pub min_ppm: f64,
    pub max_ppm: f64,
}

impl From<(f64, f64)> for ProvenSkew {
    fn from((min_ppm, max_ppm): (f64, f64)) -> Self {
        Self { min_ppm, max_ppm }
    }
}

/// The clock relation of a link over time.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct LinkSeries {
    /// Width of a bucket, seconds.
    pub bucket_s: u32,
    /// Oldest first; buckets without samples are absent.
    pub points: Vec<TimedPoint>,
}

/// One bucket.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct TimedPoint {
    /// Identifier of the relation period, which changes when a clock is stepped. Offsets of different relation periods
    /// cannot be compared. The identifier is text, because it can exceed 2⁵³.
    #[serde(rename = "window")]
    pub relation_period: String,
    #[serde(flatten)]
    pub point: LinkPoint,
}

impl From<&ClockPoint> for TimedPoint {
    fn from(point: &ClockPoint) -> Self {
        Self {
            relation_period: point.relation_period.to_string(),
            point: LinkPoint {
                at: time(point.at),
                offset: point.offset.as_ref().map(ClockOffset::from),
                probes: point.probes.into(),
                round_trip: point.round_trip.map(RoundTrip::from),
                up: point.up.as_ref().map(Delay::from),
                down: point.down.as_ref().map(Delay::from),
                clocks: point.clocks.name(),
                proven_skew: point.proven_skew_ppm.map(ProvenSkew::from),
                oldest_exchange_age_s: point.oldest_exchange_age.map(Span::seconds),
            },
        }
    }
}

impl From<&ClockSeries> for LinkSeries {
    fn from(series: &ClockSeries) -> Self {
        Self { bucket_s: series.bucket_s, points: series.points.iter().map(TimedPoint::from).collect() }
    }
}

impl From<&LinkSnapshot> for Link {
    fn from(link: &LinkSnapshot) -> Self {
        let live = &link.live;
        let subject = Subject::live(link);
        let basis = live.latest_sample.basis;
        let assumptions = subject.assumptions;
        Self {
            promise: assumptions.as_ref().map(promise),
            assumptions: assumptions.as_ref().map(Assumptions::from),
            name: subject.name(),
            network: subject.key.network.to_string(),
            edge_id: link.edge.to_string(),
            cloud_id: live.peer.to_string(),
            connected: link.connected,
            last_sample: time(live.latest_sample.at),
            now: Some(LinkNow {
                networks: live.networks.clone(),
                pipelines: live.pipelines.iter().map(ToString::to_string).collect(),
                same_clock: live.same_clock,
                verdict: subject.verdict().map(peernet_clock::Verdict::name),
                probing: Probing::from(&live.probing),
                edge_clock: live.edge.as_ref().map(HostClock::from),
                cloud_clock: live.cloud.as_ref().map(HostClock::from),
                max_drift_ppm: live.latest_sample.max_drift_ppm,
                exchanges: live.latest_sample.exchanges.into(),
                connections: live.connections.iter().map(LinkConnection::from).collect(),
                reflector: live.reflector.as_ref().map(Reflector::from),
                second: LinkPoint {
                    at: time(live.latest_sample.at),
                    offset: live.latest_sample.offset.as_ref().map(ClockOffset::from),
                    probes: live.latest_sample.probes.into(),
                    round_trip: live.latest_sample.round_trip.map(RoundTrip::from),
                    up: live.latest_sample.up.as_ref().map(Delay::from),
                    down: live.latest_sample.down.as_ref().map(Delay::from),
                    clocks: live.latest_sample.clocks().name(),
                    proven_skew: basis.and_then(|basis| basis.proven_skew_ppm).map(ProvenSkew::from),
                    oldest_exchange_age_s: basis
                        .and_then(|basis| basis.oldest_exchange_age)
                        .map(Span::seconds),
                },
            }),
            edge: subject.edge,
            cloud: subject.cloud,
        }
    }
}

impl Link {
    /// Returns a link that is stored and not in the live state.
    pub(super) fn past(row: &LinkRow, assumptions: Option<&DelayAssumptions>) -> Self {
        let subject = Subject::past(row);
        Self {
            promise: assumptions.map(promise),
            assumptions: assumptions.map(Assumptions::from),
            name: subject.name(),
            network: row.network.to_string(),
            edge: subject.edge,
            edge_id: row.edge.to_string(),
            cloud: subject.cloud,
            cloud_id: row.cloud.to_string(),
            connected: false,
            last_sample: time(row.last),
            now: None,
        }
    }
}
