//! Metrics of links.

use peernet_aggregator::LinkSnapshot;
use peernet_clock::Span;
use peernet_stream::{Connection, ConnectionStatistics, DirectionStatistics, ProbeCounts};

use super::scrape::Scrape;
use super::table::{Sample, Sink};

/// Length of the period whose probes are counted.
const WINDOW: Span = Span::from_seconds(60);

/// Writes a sample for each link for which `sample_of` returns one.
pub(super) fn write_each(
    scrape: &Scrape,
    sink: &mut Sink<'_>,
    sample_of: impl Fn(&LinkSnapshot) -> Option<Sample>,
) {
    for link in &scrape.links {
        if let Some(sample) = sample_of(link) {
            let live = &link.live;
            sink(&[link.edge_name.as_str(), live.peer_name.as_str(), live.network().as_str()], sample);
        }
    }
}

/// Returns half the width of the offset's interval, seconds; `None` without an interval, or if its sources contradict
/// each other.
pub(super) fn half_width(link: &LinkSnapshot) -> Option<Sample> {
    let offset = link.live.latest_sample.offset.as_ref()?;
    offset.is_consistent().then(|| Sample::Value(offset.bounds.width().seconds() / 2.0))
}

/// Returns the share of the probes of the last [`WINDOW`] that were lost, 0 to 1; `None` if no probe was sent.
pub(super) fn loss(link: &LinkSnapshot) -> Option<Sample> {
    recent_probes(link)?.lost_share().map(Sample::Value)
}

/// Returns the number of packets that were refused as answers to probes, and of probes that could not be sent, within
/// the last [`WINDOW`].
pub(super) fn refused(link: &LinkSnapshot) -> Option<Sample> {
    recent_probes(link).map(|probes| Sample::Value(f64::from(probes.refused)))
}

/// Returns the counts of the probes within the last [`WINDOW`]; `None` without history.
fn recent_probes(link: &LinkSnapshot) -> Option<ProbeCounts> {
    let newest = link.history.last()?.at;
    let recent = link.history.iter().filter(|point| newest - point.at < WINDOW);
    Some(recent.map(|point| point.probes).sum())
}

/// The end of a connection whose counts are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CountingHost {
    Edge,
    Cloud,
}

impl CountingHost {
    /// Returns the counts of this host; `None` if it reported none.
    const fn statistics(self, connection: &Connection) -> Option<&ConnectionStatistics> {
        match self {
            Self::Edge => Some(&connection.statistics),
            Self::Cloud => connection.cloud.as_ref(),
        }
    }

    /// Returns the directions: from edge to cloud, and from cloud to edge.
    const fn directions(
        self,
        statistics: &ConnectionStatistics,
    ) -> [(&'static str, &DirectionStatistics); 2] {
        let (upload, download) = match self {
            Self::Edge => (&statistics.sent, &statistics.received),
            Self::Cloud => (&statistics.received, &statistics.sent),
        };
        [("upload", upload), ("download", download)]
    }
}

/// Writes a total of each direction of each connection, as one of its two hosts counts it.
pub(super) fn write_directions(
    scrape: &Scrape,
    sink: &mut Sink<'_>,
    host: CountingHost,
    total_of: fn(&DirectionStatistics) -> Option<u64>,
) {
    for (link, connection) in scrape.connections() {
        let [edge, cloud, network, pipeline] = label_values(link, connection);
        let Some(connection_statistics) = host.statistics(connection) else { continue };
        for (direction, statistics) in host.directions(connection_statistics) {
            if let Some(total) = total_of(statistics) {
                sink(&[edge, cloud, network, pipeline, direction], Sample::Count(total));
            }
        }
    }
}

/// Writes the smoothed round trips of the transports' own packets, as one of the two hosts measures them.
pub(super) fn write_transport_round_trips(scrape: &Scrape, sink: &mut Sink<'_>, host: CountingHost) {
    for (link, connection) in scrape.connections() {
        if let Some(trip) = host.statistics(connection).and_then(|statistics| statistics.round_trip) {
            sink(&label_values(link, connection), Sample::Value(trip.smoothed.seconds()));
        }
    }
}

/// Writes the MTU of each interface that a connection uses.
pub(super) fn write_interfaces(scrape: &Scrape, sink: &mut Sink<'_>) {
    for (link, connection) in scrape.connections() {
        let Some(interface) = &connection.interface else { continue };
        let (Some(mtu), [edge, cloud, network, pipeline]) =
            (interface.mtu_bytes, label_values(link, connection))
        else {
            continue;
        };
        let kind = interface.kind.as_deref().unwrap_or_default();
        sink(&[edge, cloud, network, pipeline, &interface.name, kind], Sample::Size(mtu.into()));
    }
}

/// Returns the values of the labels `edge`, `cloud`, `network` and `pipeline` of a connection.
fn label_values<'a>(link: &'a LinkSnapshot, connection: &'a Connection) -> [&'a str; 4] {
    let (edge, cloud) = (link.edge_name.as_str(), link.live.peer_name.as_str());
    [edge, cloud, connection.network.as_str(), connection.pipeline.as_str()]
}
