//! The connections of a link: sent and received messages, and the route.

use peernet_clock::Span;
use peernet_statistics::number::{self, NONE, SPACE, bytes, count, trip_ms};
use peernet_stream::{Connection, DirectionStatistics};

use super::Subject;

/// One direction of a connection: a row of the table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DirectionRow {
    pub pipeline: String,
    /// `upload` or `download`.
    pub direction: &'static str,
    /// Name of the host that counts.
    pub counted_by: String,
    pub bytes: String,
    /// The columns after the bytes: messages, datagrams, lost, duplicated, reordered, sent again.
    pub counts: Vec<Count>,
}

/// A cell of the table: a count, and the name of its column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Count {
    pub name: &'static str,
    /// `None` if the counting host does not know the count.
    pub value: Option<String>,
}

/// Way of the messages of a connection, in words: addresses, interface, round trip and losses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Route {
    pub pipeline: String,
    pub words: String,
}

/// Returns the rows of each connection. Each direction has a row with the counts of the edge, and a
/// row with the counts of the cloud if the cloud reported any.
pub(crate) fn rows(subject: &Subject<'_>) -> Vec<DirectionRow> {
    let (edge, cloud) = (subject.edge.as_str(), subject.cloud.as_str());
    let of_connection = |connection: &Connection| {
        let statistics = &connection.statistics;
        let mut rows = vec![
            row(connection, ("upload", edge), &statistics.sent),
            row(connection, ("download", edge), &statistics.received),
        ];
        if let Some(statistics) = &connection.cloud {
            rows.insert(1, row(connection, ("upload", cloud), &statistics.received));
            rows.push(row(connection, ("download", cloud), &statistics.sent));
        }
        rows
    };
    connections(subject).iter().flat_map(of_connection).collect()
}

/// Returns the route of each connection.
pub(crate) fn routes(subject: &Subject<'_>) -> Vec<Route> {
    let words = |connection: &Connection| Route {
        pipeline: connection.pipeline.to_string(),
        words: [
            Some(connection.network.to_string()),
            describe_endpoints(connection),
            describe_interface(connection),
            describe_round_trip(connection),
        ]
        .into_iter()
        .flatten()
        .chain(describe_losses(connection))
        .collect::<Vec<_>>()
        .join(" · "),
    };
    connections(subject).iter().map(words).collect()
}

fn connections<'a>(subject: &Subject<'a>) -> &'a [Connection] {
    subject.live.map_or(&[], |link| link.live.connections.as_slice())
}

fn row(
    connection: &Connection,
    (direction, counted_by): (&'static str, &str),
    statistics: &DirectionStatistics,
) -> DirectionRow {
    let counts = [
        ("messages", Some(statistics.messages)),
        ("datagrams", statistics.datagrams),
        ("lost", statistics.lost),
        ("duplicated", statistics.duplicated),
        ("reordered", statistics.reordered),
        ("sent again", statistics.retransmitted),
    ];
    DirectionRow {
        pipeline: connection.pipeline.to_string(),
        direction,
        counted_by: counted_by.to_owned(),
        bytes: bytes(statistics.bytes as f64).to_string(),
        counts: counts.map(|(name, value)| Count { name, value: value.map(count) }).to_vec(),
    }
}

/// Returns `10.0.0.2:40112 → 10.0.0.1:5551`.
fn describe_endpoints(connection: &Connection) -> Option<String> {
    Some(format!("{} → {}", connection.local.as_ref()?, connection.remote.as_ref()?))
}

/// Returns `by wlan0, wireless, MTU 1,500 bytes`.
fn describe_interface(connection: &Connection) -> Option<String> {
    let interface = connection.interface.as_ref()?;
    let kind = interface.kind.as_ref().map(|kind| format!(", {kind}")).unwrap_or_default();
    let mtu = interface.mtu_bytes.map(|mtu| format!(", MTU {}{SPACE}bytes", count(mtu.into())));
    Some(format!("by {}{kind}{}", interface.name, mtu.unwrap_or_default()))
}

/// Returns `round trip of the transport's packets 0.52 ms, at least 0.41 ms`.
fn describe_round_trip(connection: &Connection) -> Option<String> {
    let trip = connection.statistics.round_trip?;
    let ms = |span: Span| format!("{}{SPACE}ms", trip_ms(span.seconds()));
    let least = trip.min.map(|min| format!(", at least {}", ms(min))).unwrap_or_default();
    Some(format!("round trip of the transport's packets {}{least}", ms(trip.smoothed)))
}

/// Returns the numbers of lost, late and malformed messages in words, without numbers that are zero.
fn describe_losses(connection: &Connection) -> impl Iterator<Item = String> {
    let statistics = connection.statistics;
    let counts = [
        (statistics.lost_messages, "lost in transit or with the connection"),
        (statistics.late_messages, "answered too late"),
        (statistics.malformed_messages, "malformed"),
    ];
    counts
        .into_iter()
        .filter(|(number, _)| *number > 0)
        .map(|(number, what)| format!("{} {what}", number::counted(number, "message")))
}

impl Count {
    /// Returns the count, or a dash.
    pub(crate) fn text(&self) -> &str {
        self.value.as_deref().unwrap_or(NONE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::samples;

    #[test]
    fn only_unknown_counts_are_dashes() {
        let link = samples::link(Some(0.0005), &[]);
        let rows = rows(&Subject::live(&link));
        let [upload_by_edge, upload_by_cloud, download_by_edge, download_by_cloud] = &rows[..] else {
            panic!("{rows:?}")
        };
        let labels = rows.iter().map(|row| (row.direction, row.counted_by.as_str())).collect::<Vec<_>>();
        let (edge, cloud) = (link.edge_name.as_str(), link.live.peer_name.as_str());
        let expected = ["upload", "download"].map(|direction| [(direction, edge), (direction, cloud)]);
        assert_eq!(labels, expected.concat());
        assert_eq!(
            (upload_by_edge.pipeline.as_str(), upload_by_edge.bytes.as_str()),
            ("line", "1.25\u{202f}GB")
        );
        let texts =
            |row: &DirectionRow| row.counts.iter().map(|one| one.text().to_owned()).collect::<Vec<_>>();
        assert_eq!(texts(upload_by_edge), ["10,482", "863,204", NONE, "0", "0", "17"]);
        assert_eq!(texts(download_by_edge), ["10,480", "10,655", NONE, NONE, "3", NONE]);
        assert_eq!(texts(upload_by_cloud), ["10,481", "863,100", NONE, NONE, "12", NONE]);
        assert_eq!(texts(download_by_cloud), ["10,480", "10,655", NONE, "0", "0", "4"]);
    }

    #[test]
    fn route_names_interface_and_round_trip() {
        let mut link = samples::link(Some(0.0005), &[]);
        let words = |link: &_| routes(&Subject::live(link)).remove(0).words;
        assert_eq!(
            words(&link),
            format!(
                "zmq-tcp · 192.0.2.7:40112 → 192.0.2.5:5551 · by wlan0, wireless, MTU 1,500{SPACE}bytes · round trip of the transport's \
                 packets 2.31{SPACE}ms, at least 1.08{SPACE}ms · 2 messages lost in transit or with the connection"
            )
        );
        let connection = &mut link.live.connections[0];
        (connection.local, connection.interface) = (None, None);
        connection.statistics = peernet_stream::ConnectionStatistics::default();
        assert_eq!(words(&link), "zmq-tcp");
    }
}
