//! The storage clock, steps of the wall clock, and incidents of the aggregator itself. The storage clock counts the
//! time during which the aggregator runs and stores.

use peernet_clock::{Span, Stamp};
use sqlx::Connection;

use super::{NOW, STAMP, TestStore, database, generate, hello, open};
use crate::retention::StepResult;
use crate::types::{AggregatorIncidentKind, IncidentFilter};
use crate::write::{PendingIncidents, Writer};
use crate::{IncidentRow, RetentionConfig};

const ELAPSED_S: &str = "SELECT elapsed_ns / 1000000000 FROM storage_clock";

/// Returns the readings of the aggregator's clocks `seconds` after the start of the test.
fn stamp_after(seconds: i64) -> Stamp {
    STAMP + Span::from_seconds(seconds)
}

async fn incidents(test_store: &TestStore) -> Vec<IncidentRow> {
    test_store.store.incidents(&IncidentFilter::newest(100)).await.expect("answers")
}

#[tokio::test]
async fn storage_clock_ignores_wall_clock_and_pauses() {
    let mut test_store = TestStore::new().await;
    let mut pending = PendingIncidents::new(STAMP);
    for seconds in (1..=100).step_by(3) {
        test_store.writer.store_clock_readings(stamp_after(seconds), &mut pending).await.expect("stores");
    }
    // The stored reading is behind by at most 30 s, the interval between two stored readings.
    let elapsed = test_store.count(ELAPSED_S).await;
    assert!((70..=100).contains(&elapsed), "{elapsed}");
    // The transaction of a commit also stores the storage clock.
    let work = [hello(generate::host(test_store.edge, "edge"), 1)];
    test_store.writer.commit(&work, stamp_after(100)).await.expect("commits");
    assert_eq!(test_store.count(ELAPSED_S).await, 100);
    // After one more second, the wall clock is a month ahead, and then a month behind.
    let month = Span::from_seconds(30 * 86_400);
    for wall in [stamp_after(101).wall + month, stamp_after(101).wall - month] {
        test_store
            .writer
            .store_clock_readings(Stamp { wall, ..stamp_after(101) }, &mut pending)
            .await
            .expect("stores");
    }
    assert_eq!(test_store.count(ELAPSED_S).await, 101);
    // The aggregator did not store for a day. A pause counts for at most 60 s.
    test_store.writer.store_clock_readings(stamp_after(86_400), &mut pending).await.expect("stores");
    assert_eq!(test_store.count(ELAPSED_S).await, 161);
    // A new process begins on a machine that was restarted: its monotonic clock begins again. The storage clock advances
    // from the first transaction of the process on.
    test_store.writer = open(&test_store.path).await;
    for seconds in [0, 40] {
        test_store.writer.store_clock_readings(stamp_after(seconds), &mut pending).await.expect("stores");
    }
    assert_eq!(test_store.count(ELAPSED_S).await, 201);
}

#[tokio::test]
async fn step_of_wall_clock_is_incident_of_aggregator() {
    let mut test_store = TestStore::new().await;
    let mut pending = PendingIncidents::new(STAMP);
    test_store.writer.store_clock_readings(stamp_after(1), &mut pending).await.expect("stores");
    test_store
        .writer
        .store_clock_readings(
            Stamp { wall: stamp_after(2).wall + Span::from_seconds(9), ..stamp_after(2) },
            &mut pending,
        )
        .await
        .expect("stores");
    // A step of less than 10 s is not reported.
    assert_eq!(incidents(&test_store).await, []);
    test_store
        .writer
        .store_clock_readings(Stamp { wall: NOW + Span::from_seconds(3_600), ..stamp_after(3) }, &mut pending)
        .await
        .expect("stores");
    let stored = incidents(&test_store).await;
    let [step] = &stored[..] else { panic!("{stored:?}") };
    assert_eq!((step.kind.as_str(), step.host, step.host_name.clone()), ("clock-step", None, None));
    // The wall clock shows 3,600 s after the start. Of these, 3 s have passed, and 9 s are the earlier step.
    assert!(step.text.contains("set forward by 3588.0 s"), "{}", step.text);

    // The aggregator starts again after the clock was set back.
    let connection = database::open(&test_store.path).await.expect("opens");
    let config = RetentionConfig::default();
    test_store.writer = Writer::new(test_store.path.clone(), connection, config).await.expect("reads");
    let mut pending = PendingIncidents::new(STAMP);
    test_store.writer.store_clock_readings(STAMP, &mut pending).await.expect("stores");
    let stored = incidents(&test_store).await;
    assert_eq!(stored.len(), 2);
    assert!(stored.iter().any(|step| step.text.contains("3600.0 s less")), "{stored:?}");
}

#[tokio::test]
async fn incident_waits_until_database_is_writable() {
    let mut test_store = TestStore::new().await;
    let mut pending = PendingIncidents::new(STAMP);
    let mut other = test_store.second_connection().await;
    sqlx::raw_sql("BEGIN IMMEDIATE").execute(&mut other).await.expect("locks");
    pending.add(AggregatorIncidentKind::Storage, NOW, "the database is locked".to_owned());
    test_store.writer.store_clock_readings(stamp_after(1), &mut pending).await.expect_err("locked");
    other.close().await.expect("unlocks");
    test_store.writer.store_clock_readings(stamp_after(2), &mut pending).await.expect("stores");
    test_store.writer.store_clock_readings(stamp_after(3), &mut pending).await.expect("stores");
    let stored = incidents(&test_store).await;
    assert_eq!(
        stored.iter().map(|row| (row.kind.as_str(), row.text.as_str())).collect::<Vec<_>>(),
        [("storage", "the database is locked")]
    );
}

#[tokio::test]
async fn newest_ten_thousand_aggregator_incidents_stay() {
    let mut test_store = TestStore::new().await;
    let mut pending = PendingIncidents::new(STAMP);
    let mut other = test_store.second_connection().await;
    sqlx::raw_sql(
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 10010) \
         INSERT INTO incident (host, at_ns, kind, text) SELECT NULL, i, 'storage', 'old' FROM n; \
         INSERT INTO incident (host, at_ns, kind, text) SELECT id, 0, 'gap', 'of a host' FROM host LIMIT 1;",
    )
    .execute(&mut other)
    .await
    .expect("inserts");
    pending.add(AggregatorIncidentKind::Storage, NOW, "new".to_owned());
    test_store.writer.store_clock_readings(stamp_after(1), &mut pending).await.expect("stores");
    assert_eq!(test_store.count("SELECT count(*) FROM incident WHERE host IS NULL").await, 10_000);
    assert_eq!(test_store.count("SELECT count(*) FROM incident WHERE host IS NOT NULL").await, 1);
    assert_eq!(incidents(&test_store).await[0].text, "new");
}

/// Simulates the time from the first commit to the deletion, as an aggregator's writer does: one check each minute.
#[tokio::test]
async fn data_is_deleted_after_period_on_storage_clock() {
    let mut test_store = TestStore::new().await;
    let mut pending = PendingIncidents::new(STAMP);
    let config = RetentionConfig { nodes_days: 1, seconds_days: 1, ..RetentionConfig::default() };
    let connection = database::open(&test_store.path).await.expect("opens");
    test_store.writer = Writer::new(test_store.path.clone(), connection, config).await.expect("reads");
    test_store.store_run(50).await;
    let mut check_each_minute = async |test_store: &mut TestStore, minutes: std::ops::Range<i64>| {
        for minute in minutes {
            // The wall clock runs a thousand times too fast, which must not make data older.
            let stamp = Stamp { wall: NOW + Span::from_seconds(60_000 * minute), ..stamp_after(60 * minute) };
            let mut result = StepResult::More;
            while result == StepResult::More {
                result = test_store.writer.retain(stamp).await.expect("steps");
            }
            test_store.writer.store_clock_readings(stamp, &mut pending).await.expect("stores");
        }
    };
    check_each_minute(&mut test_store, 1..24 * 60).await;
    assert_eq!(test_store.count("SELECT count(*) FROM iteration").await, 50);
    let statistics_per_second = test_store.count("SELECT count(*) FROM rollup WHERE resolution_s = 1").await;
    // Data that arrives within a sixty-fourth of the period, here 22.5 minutes, is deleted together.
    check_each_minute(&mut test_store, 24 * 60..24 * 60 + 26).await;
    assert_eq!(test_store.count("SELECT count(*) FROM iteration").await, 0);
    assert_eq!(test_store.count("SELECT count(*) FROM rollup WHERE resolution_s = 1").await, 0);
    let stored = test_store.store.incidents(&IncidentFilter::newest(1_000)).await.expect("answers");
    let deleted: Vec<&str> =
        stored.iter().filter(|row| row.kind == "retention").map(|row| row.text.as_str()).collect();
    let expected = format!(
        "deleted 50 iterations with their trees of 1 run (nodes_days = 1), {statistics_per_second} \
         statistics per second of 1 run (seconds_days = 1)"
    );
    assert_eq!(deleted, [expected.as_str()]);
}
