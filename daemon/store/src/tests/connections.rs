//! Statistics of connections. Their times are limited to the times of the clock samples of the same link, because
//! retention deletes clock samples and the statistics of connections together.

use peernet_clock::{Span, WallTime};
use peernet_logger::HostId;
use peernet_stream::{
    Connection, ConnectionStatistics, DirectionStatistics, Event, NetworkInterface, NetworkName,
    TransportRoundTrip,
};

use super::clocks::sample;
use super::{TestStore, generate};
use crate::write::ConnectionSample;

fn connection_report(test_store: &TestStore, cloud: HostId, at: WallTime, bytes: u64) -> ConnectionSample {
    let sent = DirectionStatistics {
        bytes,
        messages: 3,
        datagrams: Some(40),
        lost: None,
        duplicated: Some(0),
        reordered: Some(5),
        retransmitted: Some(6),
    };
    let round_trip =
        TransportRoundTrip { min: None, smoothed: Span::from_micros(520), variation: Span::from_micros(33) };
    ConnectionSample {
        edge: test_store.edge,
        cloud,
        at,
        connection: Connection {
            pipeline: "line".parse().expect("a name"),
            network: NetworkName::default(),
            local: Some("10.0.0.2:40112".into()),
            remote: Some("10.0.0.1:5551".into()),
            interface: Some(NetworkInterface {
                name: "wlan0".into(),
                kind: Some("wireless".into()),
                mtu_bytes: Some(1_500),
            }),
            statistics: ConnectionStatistics {
                sent,
                received: DirectionStatistics { bytes: u64::MAX, ..DirectionStatistics::default() },
                lost_messages: 7,
                round_trip: Some(round_trip),
                ..ConnectionStatistics::default()
            },
            cloud: None,
        },
    }
}

#[tokio::test]
async fn connections_are_stored_within_time_of_clock_samples() {
    let mut test_store = TestStore::new().await;
    let (reported_at, cloud) = (generate::at(2.0), test_store.cloud);
    let report_before_link = connection_report(&test_store, cloud, reported_at, 1);
    test_store.writer.store_connections(&[report_before_link]).await.expect("stores");
    assert_eq!(
        test_store.count("SELECT count(*) FROM connection_sample").await,
        0,
        "the link is not stored yet"
    );

    let clocks = (1..=3).map(|second| Event::Clock(Box::new(sample(test_store.cloud, second, 40)))).collect();
    let work = test_store.batch(clocks);
    test_store.commit(&[work]).await;
    let unknown_host = HostId::random();
    let samples = [
        connection_report(&test_store, cloud, reported_at, 2),
        connection_report(&test_store, unknown_host, reported_at, 3),
        connection_report(&test_store, cloud, WallTime::from_unix_nanos(i64::MAX), 4),
        connection_report(&test_store, cloud, WallTime::from_unix_nanos(i64::MIN), 5),
    ];
    test_store.writer.store_connections(&samples).await.expect("stores");
    assert_eq!(
        test_store.count("SELECT count(*) FROM connection_sample").await,
        3,
        "the unknown host has no link"
    );
    assert_eq!(
        test_store.count(
            "SELECT count(*) FROM connection_total WHERE edge = 'edge' AND cloud = 'cloud' AND network = 'zmq-tcp' AND pipeline = 'line' \
             AND at_utc = '2025-01-01 00:00:02.000' AND sent_bytes = 2 AND sent_datagrams = 40 AND sent_retransmitted = 6 \
             AND received_bytes = 9223372036854775807 AND received_datagrams IS NULL AND round_trip_ms = 0.52 \
             AND round_trip_min_ms IS NULL AND (interface, interface_type, mtu_bytes) = ('wlan0', 'wireless', 1500)"
        )
        .await,
        1
    );
    let without_cloud_counts = "SELECT count(*) FROM connection_sample WHERE coalesce(cloud_received_bytes, cloud_sent_messages, \
                  cloud_lost_messages, cloud_round_trip_ns) IS NULL";
    assert_eq!(test_store.count(without_cloud_counts).await, 3, "the cloud reported no counts");
    let within_clock_samples = "SELECT count(*) FROM connection_sample WHERE at_ns BETWEEN (SELECT min(at_ns) FROM clock_sample) \
                  AND (SELECT max(at_ns) FROM clock_sample)";
    assert_eq!(test_store.count(within_clock_samples).await, 3, "reported times are limited");
}

#[tokio::test]
async fn connection_reports_of_cloud_and_edge_are_both_stored() {
    let mut test_store = TestStore::new().await;
    let work = test_store.batch(vec![Event::Clock(Box::new(sample(test_store.cloud, 1, 40)))]);
    test_store.commit(&[work]).await;
    let mut report_of_both_hosts = connection_report(&test_store, test_store.cloud, generate::at(2.0), 900);
    let direction = |bytes, messages, lost, retransmitted| DirectionStatistics {
        bytes,
        messages,
        lost,
        retransmitted,
        ..DirectionStatistics::default()
    };
    report_of_both_hosts.connection.cloud = Some(ConnectionStatistics {
        sent: direction(500, 5, None, Some(12)),
        received: direction(800, 8, Some(9), None),
        malformed_messages: 1,
        late_messages: 0,
        lost_messages: 2,
        round_trip: Some(TransportRoundTrip {
            min: Some(Span::from_micros(400)),
            smoothed: Span::from_micros(620),
            variation: Span::from_micros(44),
        }),
    });
    test_store.writer.store_connections(&[report_of_both_hosts]).await.expect("stores");
    let stored = "SELECT count(*) FROM connection_sample WHERE (sent_bytes, cloud_received_bytes, cloud_received_messages, \
                  cloud_received_lost, cloud_sent_bytes, cloud_sent_messages, cloud_sent_retransmitted) \
                  = (900, 800, 8, 9, 500, 5, 12) AND cloud_received_retransmitted IS NULL AND cloud_sent_lost IS NULL \
                  AND (cloud_malformed_messages, cloud_lost_messages) = (1, 2) \
                  AND (cloud_round_trip_min_ns, cloud_round_trip_ns, cloud_round_trip_variation_ns) = (400000, 620000, 44000)";
    assert_eq!(test_store.count(stored).await, 1);
    let shown = "SELECT count(*) FROM connection_total WHERE (sent_bytes, cloud_received_bytes, cloud_sent_bytes, \
                 cloud_sent_retransmitted, cloud_round_trip_min_ms, cloud_round_trip_ms) = (900, 800, 500, 12, 0.4, 0.62)";
    assert_eq!(test_store.count(shown).await, 1);
}

#[tokio::test]
async fn writer_continues_after_sqlite_rollback() {
    let mut test_store = TestStore::new().await;
    let clocks = (1..=3).map(|second| Event::Clock(Box::new(sample(test_store.cloud, second, 40)))).collect();
    let work = test_store.batch(clocks);
    test_store.commit(&[work]).await;
    let samples = [connection_report(&test_store, test_store.cloud, generate::at(2.0), 2)];

    // The trigger rolls the whole transaction back, as SQLite does when the disk is full.
    let full =
        "CREATE TRIGGER full BEFORE INSERT ON connection_sample BEGIN SELECT RAISE(ROLLBACK, 'undone'); END";
    let mut other = test_store.second_connection().await;
    sqlx::raw_sql(full).execute(&mut other).await.expect("makes the trigger");
    test_store.writer.store_connections(&samples).await.expect_err("the transaction is rolled back");
    sqlx::raw_sql("DROP TRIGGER full").execute(&mut other).await.expect("removes the trigger");
    test_store.writer.store_connections(&samples).await.expect("stores");
    assert_eq!(test_store.count("SELECT count(*) FROM connection_sample").await, 1);
}
