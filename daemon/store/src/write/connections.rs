//! Storing of statistics of connections: one row per sample. The aggregator selects one sample per
//! connection and minute, and the last sample of a connection that has ended.

use peernet_clock::{Span, WallTime};
use peernet_logger::HostId;
use peernet_stream::{Connection, ConnectionStatistics, DirectionStatistics};
use sqlx::error::BoxDynError;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, SqliteConnection};

use crate::column::column;

/// An edge's report on one of its connections.
#[derive(Clone, Debug, PartialEq)]
pub struct ConnectionSample {
    /// The edge.
    pub edge: HostId,
    /// The cloud.
    pub cloud: HostId,
    /// Time of the report on the edge's wall clock.
    pub at: WallTime,
    /// The connection with its totals so far.
    pub connection: Connection,
}

/// Stores a sample of a connection, if its link has clock samples. The time of the sample comes from a live update,
/// which may claim any time. The time is therefore moved into the range of the link's clock samples: retention deletes
/// samples of connections together with the clock samples of the same time.
const INSERT: &str = "INSERT OR REPLACE INTO connection_sample (link, at_ns, pipeline, local_address, remote_address, \
     interface, interface_type, mtu_bytes, \
     sent_bytes, sent_messages, sent_datagrams, sent_lost, sent_duplicated, sent_reordered, sent_retransmitted, \
     received_bytes, received_messages, received_datagrams, received_lost, received_duplicated, received_reordered, \
     received_retransmitted, malformed_messages, late_messages, lost_messages, \
     round_trip_min_ns, round_trip_ns, round_trip_variation_ns, \
     cloud_received_bytes, cloud_received_messages, cloud_received_datagrams, cloud_received_lost, cloud_received_duplicated, \
     cloud_received_reordered, cloud_received_retransmitted, cloud_sent_bytes, cloud_sent_messages, cloud_sent_datagrams, \
     cloud_sent_lost, cloud_sent_duplicated, cloud_sent_reordered, cloud_sent_retransmitted, cloud_malformed_messages, \
     cloud_lost_messages, cloud_round_trip_min_ns, cloud_round_trip_ns, cloud_round_trip_variation_ns) \
     SELECT link.id, max(min(?4, (SELECT max(at_ns) FROM clock_sample WHERE clock_sample.link = link.id)), \
       (SELECT min(at_ns) FROM clock_sample WHERE clock_sample.link = link.id)), ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19, ?20, ?21, ?22, ?23, ?24, \
     ?25, ?26, ?27, ?28, ?29, ?30, ?31, ?32, ?33, ?34, ?35, ?36, ?37, ?38, ?39, ?40, ?41, ?42, ?43, ?44, ?45, ?46, ?47, ?48, ?49 \
     FROM link JOIN host AS edge ON edge.id = link.edge JOIN host AS cloud ON cloud.id = link.cloud \
     WHERE edge.uuid = ?1 AND cloud.uuid = ?2 AND link.network = ?3 AND EXISTS (SELECT 1 FROM clock_sample WHERE clock_sample.link = link.id)";

/// Stores samples of connections. Samples of a link without stored clock samples are omitted.
pub(super) async fn store(
    connection: &mut SqliteConnection,
    samples: &[ConnectionSample],
) -> Result<(), sqlx::Error> {
    for sample in samples {
        let values = values(sample).map_err(sqlx::Error::Encode)?;
        sqlx::query_with(INSERT, values).execute(&mut *connection).await?;
    }
    Ok(())
}

fn values(sample: &ConnectionSample) -> Result<SqliteArguments, BoxDynError> {
    let ConnectionSample { edge, cloud, at, connection } = sample;
    let (interface, statistics) = (connection.interface.as_ref(), &connection.statistics);
    let mut to = SqliteArguments::default();
    to.add(edge.to_string())?;
    to.add(cloud.to_string())?;
    to.add(connection.network.to_string())?;
    to.add(at.unix_nanos())?;
    to.add(connection.pipeline.to_string())?;
    to.add(connection.local.clone())?;
    to.add(connection.remote.clone())?;
    to.add(interface.map(|interface| interface.name.clone()))?;
    to.add(interface.and_then(|interface| interface.kind.clone()))?;
    to.add(interface.and_then(|interface| interface.mtu_bytes))?;
    add_direction(Some(&statistics.sent), &mut to)?;
    add_direction(Some(&statistics.received), &mut to)?;
    for count in [statistics.malformed_messages, statistics.late_messages, statistics.lost_messages] {
        to.add(column(count))?;
    }
    add_round_trip(Some(statistics), &mut to)?;
    let cloud = connection.cloud.as_ref();
    // The upload comes first at both ends: the edge has sent it, and the cloud has received it.
    add_direction(cloud.map(|cloud| &cloud.received), &mut to)?;
    add_direction(cloud.map(|cloud| &cloud.sent), &mut to)?;
    to.add(cloud.map(|cloud| column(cloud.malformed_messages)))?;
    to.add(cloud.map(|cloud| column(cloud.lost_messages)))?;
    add_round_trip(cloud, &mut to)?;
    Ok(to)
}

/// Adds the seven totals of a direction; NULL for totals that were not reported.
fn add_direction(
    reported: Option<&DirectionStatistics>,
    to: &mut SqliteArguments,
) -> Result<(), BoxDynError> {
    to.add(reported.map(|reported| column(reported.bytes)))?;
    to.add(reported.map(|reported| column(reported.messages)))?;
    let totals = reported.copied().unwrap_or_default();
    let datagrams =
        [totals.datagrams, totals.lost, totals.duplicated, totals.reordered, totals.retransmitted];
    datagrams.into_iter().try_for_each(|count| to.add(count.map(column)))
}

/// Adds the three numbers of a transport's round trip.
fn add_round_trip(
    reported: Option<&ConnectionStatistics>,
    to: &mut SqliteArguments,
) -> Result<(), BoxDynError> {
    let trip = reported.and_then(|reported| reported.round_trip);
    to.add(trip.and_then(|trip| trip.min).map(Span::nanos))?;
    to.add(trip.map(|trip| trip.smoothed.nanos()))?;
    to.add(trip.map(|trip| trip.variation.nanos()))
}
