//! While the database uses more bytes than its limit, retention deletes the oldest data of all runs that are not pinned.

use std::collections::BTreeMap;

use peernet_logger::RunId;
use peernet_stream::Event;

use super::generate::{self, Numbers, at};
use super::retention::{
    day, iterations, run_until_done, step, store_arrival, store_two_runs, unlimited_retention,
};
use super::{NODES_PER_ITERATION, TestStore};
use crate::retention::{Retention, StepResult};
use crate::retention_config::RetentionConfig;
use crate::types::IncidentFilter;

/// Number of bytes of the file's pages that hold data.
const USED_BYTES: &str = "SELECT (page_count - freelist_count) * page_size \
     FROM pragma_page_count, pragma_freelist_count, pragma_page_size";

fn retention_with_size_limit(size_limit_bytes: u64) -> Retention {
    Retention::new(RetentionConfig { size_limit_bytes, ..unlimited_retention() })
}

#[tokio::test]
async fn oldest_unpinned_rows_are_deleted_above_limit() {
    let (mut test_store, [run, _]) = store_two_runs().await;
    let mut connection = test_store.second_connection().await;
    let used_bytes = test_store.count(USED_BYTES).await.unsigned_abs();
    let limit = used_bytes - used_bytes / 20;
    let mut retention = retention_with_size_limit(limit);
    run_until_done(&mut retention, &mut connection, day(4.0)).await;
    let first = test_store.count("SELECT min(number) FROM iteration WHERE run = 1").await;
    assert!((2..288).contains(&first), "{first}");
    // The column `nodes_from` has the number of the last deleted iteration.
    assert_eq!(test_store.count("SELECT nodes_from FROM run WHERE number = 1").await, first - 1);
    assert!(test_store.count(USED_BYTES).await.unsigned_abs() <= limit);
    assert_eq!(
        test_store.count("SELECT count FROM retention_note WHERE what = 'size-limit'").await,
        first - 1
    );
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 2").await, 288 * NODES_PER_ITERATION);
    let incidents = test_store.store.incidents(&IncidentFilter::newest(10)).await.expect("answers");
    let deleted_iterations = first - 1;
    let expected = format!(
        "deleted {deleted_iterations} iterations with their trees of 1 run (size_limit_bytes = {limit})"
    );
    assert_eq!(incidents.iter().map(|row| row.text.as_str()).collect::<Vec<_>>(), [expected.as_str()]);

    // The database cannot be as small as this limit. Retention deletes all data that may be deleted, and then stops.
    let mut retention = retention_with_size_limit(1);
    run_until_done(&mut retention, &mut connection, day(4.1)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 1").await, 0);
    assert_eq!(
        test_store.count("SELECT count(*) FROM rollup WHERE run = 1 AND resolution_s IN (1, 10, 60)").await,
        0
    );
    assert!(test_store.count("SELECT count(*) FROM rollup WHERE run = 1 AND resolution_s = 3600").await > 90);
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 2").await, 288 * NODES_PER_ITERATION);
    // The run continues, and its new data is stored.
    let events = iterations(&test_store, run, 289..=290);
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;
    assert_eq!(test_store.store.run(1).await.expect("answers").expect("exists").summary.counts.ok, 290);
    // Quantity 1 is half the width of the bounds of a delay. Each of the two iterations has two delays.
    assert_eq!(
        test_store
            .count("SELECT count(*) FROM rollup WHERE run = 1 AND resolution_s = 1 AND quantity = 1")
            .await,
        4
    );
}

/// Stores concurrent runs. `runs` has for each run its name, the hours in which it measures, and its number of
/// iterations per hour. All iterations of an hour arrive at the end of the hour.
async fn store_concurrent_runs(
    test_store: &mut TestStore,
    runs: &[(&str, std::ops::Range<u32>, u32)],
    hours: u32,
) {
    let ids: Vec<RunId> = runs.iter().map(|_| RunId::random()).collect();
    let mut random = Numbers::new(7);
    for hour in 0..hours {
        let mut events = Vec::new();
        for ((name, hours_of_run, count), run) in runs.iter().zip(&ids) {
            let hour_start_s = f64::from(hour) * 3_600.0;
            if hours_of_run.start == hour {
                events.push(generate::run_started(*run, name, at(hour_start_s)));
            }
            if hours_of_run.contains(&hour) {
                events.extend((0..*count).map(|n| {
                    let number = (hour - hours_of_run.start) * count + n + 1;
                    let started = at(hour_start_s + f64::from(n) * 3_600.0 / f64::from(*count) + 0.3);
                    Event::Iteration(generate::iteration_at(
                        *run,
                        number.into(),
                        test_store.hosts(),
                        started,
                        &mut random,
                    ))
                }));
            }
        }
        store_arrival(test_store, events, at(f64::from(hour + 1) * 3_600.0)).await;
    }
}

/// Returns, for each kind of data and each run, the time of the oldest data and the time before which all data is
/// deleted, in seconds. The kind 0 stands for iterations, any other kind for the roll-ups of that width in seconds.
async fn trimming_state(test_store: &TestStore) -> BTreeMap<i64, Vec<(Option<i64>, i64)>> {
    let rows: Vec<(i64, Option<i64>, i64)> = sqlx::query_as(
        "SELECT kind.column1, \
           iif(kind.column1 = 0, (SELECT min(started_ns) / 1000000000 FROM iteration WHERE iteration.run = run.number), \
             (SELECT min(bucket_s) FROM rollup WHERE rollup.run = run.number AND resolution_s = kind.column1)), \
           coalesce((SELECT before_s FROM trimmed WHERE trimmed.run = run.number AND kind = kind.column1), 0) \
         FROM (VALUES (0), (1), (10), (60)) AS kind, run",
    )
    .fetch_all(&test_store.store.readers.pool())
    .await
    .expect("answers");
    rows.into_iter().fold(BTreeMap::new(), |mut kinds, (kind, oldest_s, deleted_before_s)| {
        kinds.entry(kind).or_insert_with(Vec::new).push((oldest_s, deleted_before_s));
        kinds
    })
}

#[tokio::test]
async fn overlapping_runs_are_trimmed_in_turns() {
    let mut test_store = TestStore::new().await;
    // One run lasts the whole time, two runs end earlier, and one run begins late.
    let runs = [("line", 0..20, 3), ("arm", 0..5, 4), ("belt", 5..15, 2), ("cell", 16..20, 2)];
    store_concurrent_runs(&mut test_store, &runs, 20).await;
    let mut connection = test_store.second_connection().await;
    let mut retention = retention_with_size_limit(1);
    // Data that arrives within an hour is deleted together. A bucket is deleted as a whole.
    let tolerance_s = |kind: i64| 2 * 3_600 + 60 + kind;
    let mut states_with_two_partial_runs = 0;
    while step(&mut retention, &mut connection, at(20.0 * 3_600.0)).await == StepResult::More {
        for (kind, runs) in trimming_state(&test_store).await {
            let deleted_before_s =
                runs.iter().map(|(_, deleted_before_s)| *deleted_before_s).max().expect("there are runs");
            let oldest_s = runs.iter().filter_map(|(oldest_s, _)| *oldest_s).min();
            if let Some(oldest_s) = oldest_s {
                assert!(deleted_before_s - oldest_s <= tolerance_s(kind), "kind {kind}: {runs:?}");
            }
            let partial_runs = runs
                .iter()
                .filter(|(oldest_s, deleted_before_s)| oldest_s.is_some() && *deleted_before_s > 0);
            states_with_two_partial_runs += usize::from(partial_runs.count() >= 2);
        }
    }
    assert!(states_with_two_partial_runs > 10, "{states_with_two_partial_runs}");
    assert_eq!(test_store.count("SELECT count(*) FROM node").await, 0);
    assert_eq!(test_store.count("SELECT count(*) FROM rollup WHERE resolution_s IN (1, 10, 60)").await, 0);
}

#[tokio::test]
async fn rows_with_times_in_future_are_deleted_too() {
    let mut test_store = TestStore::new().await;
    for name in ["line", "arm"] {
        let run = RunId::random();
        let mut random = Numbers::new(7);
        let mut events = vec![generate::run_started(run, name, at(9_000.0))];
        events.extend((1..50).map(|number| {
            let started = at(9_000.0 + 2.0 * number as f64);
            Event::Iteration(generate::iteration_at(run, number, test_store.hosts(), started, &mut random))
        }));
        store_arrival(&mut test_store, events, at(0.0)).await;
    }
    let mut connection = test_store.second_connection().await;
    run_until_done(&mut retention_with_size_limit(1), &mut connection, at(0.0)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM node").await, 0);
    assert_eq!(test_store.count("SELECT count(*) FROM rollup WHERE resolution_s IN (1, 10, 60)").await, 0);
}
