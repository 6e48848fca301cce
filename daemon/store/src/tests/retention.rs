//! Retention deletes data after its period, in small steps, and no other data. Age is time on the storage clock.

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::{RunId, stage};
use peernet_stream::{EndReason, Event, RunEnded};
use sqlx::SqliteConnection;

use super::clocks::sample;
use super::generate::{self, Numbers};
use super::rollups::{assert_same, read_rollups};
use super::{NODES_PER_ITERATION, NOW, TestStore};
use crate::maintenance::{Examination, examine};
use crate::rebuild::rebuild;
use crate::retention::{Retention, StepResult, pin};
use crate::retention_config::RetentionConfig;
use crate::storage_clock::StorageClock;
use crate::types::{IncidentFilter, IterationFilter};

const DAY: f64 = 86_400.0;
/// Seconds between two iterations. Three iterations share a bucket of 1 h; all narrower buckets have one iteration.
const INTERVAL_S: f64 = 1_200.0;
/// Number of iterations that arrive together.
const ARRIVAL_ITERATIONS: u64 = 3;
/// Data that arrives within this time of the storage clock, in seconds, may be deleted together.
const RESOLUTION_S: i64 = 3_600;
/// Approximate maximum cost of one step, in rows of the table `node`.
const MAX_STEP_COST: u32 = 300;

/// Makes iterations of a run, one every [`INTERVAL_S`] seconds.
pub(super) fn iterations(
    test_store: &TestStore,
    run: RunId,
    numbers: std::ops::RangeInclusive<u64>,
) -> Vec<Event> {
    let mut random = Numbers::new(*numbers.start());
    numbers
        .map(|number| {
            let started = generate::at(number as f64 * INTERVAL_S);
            Event::Iteration(generate::iteration_at(run, number, test_store.hosts(), started, &mut random))
        })
        .collect()
}

pub(super) fn day(days: f64) -> WallTime {
    generate::at(days * DAY)
}

/// Sets the storage clock of a database to a time of the test.
pub(super) async fn set_storage_clock(connection: &mut SqliteConnection, at: WallTime) {
    let elapsed = at - generate::at(0.0);
    sqlx::query("UPDATE storage_clock SET elapsed_ns = ?")
        .bind(elapsed.nanos())
        .execute(connection)
        .await
        .expect("sets");
}

/// Makes one step of retention when the storage clock shows `at`. The aggregator's wall clock stands still.
pub(super) async fn step(
    retention: &mut Retention,
    connection: &mut SqliteConnection,
    at: WallTime,
) -> StepResult {
    set_storage_clock(connection, at).await;
    // A new `StorageClock` has not advanced in this process, so its reading is the stored one.
    let mono = MonoTime::from_nanos((at - generate::at(0.0)).nanos());
    let mut clock = StorageClock::default();
    retention
        .step(connection, &mut clock, Stamp { wall: NOW, mono, ..Stamp::default() }, MAX_STEP_COST)
        .await
        .expect("steps")
}

/// Makes steps until retention has nothing to do. Returns the number of steps that did something.
pub(super) async fn run_until_done(
    retention: &mut Retention,
    connection: &mut SqliteConnection,
    now: WallTime,
) -> usize {
    // Retention that had nothing to do looks for work again only after a second.
    let now = now + Span::from_seconds(2);
    for steps in 0..10_000 {
        if step(retention, connection, now).await == StepResult::Done {
            return steps;
        }
    }
    panic!("retention does not end");
}

/// Stores events when the storage clock shows `at`. Events that arrived an hour earlier belong to another arrival,
/// because retention runs before the commit.
pub(super) async fn store_arrival(test_store: &mut TestStore, events: Vec<Event>, at: WallTime) {
    let mut connection = test_store.second_connection().await;
    run_until_done(&mut Retention::new(unlimited_retention()), &mut connection, at).await;
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;
}

/// Stores two runs of four days with the same iterations. Neither run has ended. The second run is pinned. Iterations
/// arrive each hour.
pub(super) async fn store_two_runs() -> (TestStore, [RunId; 2]) {
    let mut test_store = TestStore::new().await;
    let runs = [RunId::random(), RunId::random()];
    let run_starts = runs.into_iter().zip(["line", "arm"]);
    let run_starts = run_starts.map(|(run, name)| generate::run_started(run, name, day(0.0))).collect();
    store_arrival(&mut test_store, run_starts, day(0.0)).await;
    let mut connection = test_store.second_connection().await;
    assert!(pin(&mut connection, 2, true).await.expect("pins"));
    assert!(!pin(&mut connection, 3, true).await.expect("finds no run"));
    for first in (1..=288).step_by(ARRIVAL_ITERATIONS as usize) {
        let last = first + ARRIVAL_ITERATIONS - 1;
        let events = runs.iter().flat_map(|run| iterations(&test_store, *run, first..=last)).collect();
        store_arrival(&mut test_store, events, generate::at(last as f64 * INTERVAL_S)).await;
    }
    (test_store, runs)
}

pub(super) fn unlimited_retention() -> RetentionConfig {
    RetentionConfig {
        nodes_days: 0,
        seconds_days: 0,
        ten_seconds_days: 0,
        minutes_days: 0,
        clock_samples_days: 0,
        ..RetentionConfig::default()
    }
}

pub(super) fn short_retention() -> RetentionConfig {
    RetentionConfig {
        nodes_days: 2,
        seconds_days: 1,
        ten_seconds_days: 2,
        minutes_days: 3,
        ..RetentionConfig::default()
    }
}

#[tokio::test]
async fn each_kind_is_deleted_after_its_period_except_pinned_runs() {
    let (test_store, _) = store_two_runs().await;
    let mut connection = test_store.second_connection().await;
    let before = read_rollups(&mut connection).await;
    let stages = test_store.store.statistics_of(1).await.expect("answers").stages;
    let mut retention = Retention::new(short_retention());
    run_until_done(&mut retention, &mut connection, day(4.0)).await;

    // `run_until_done` adds two seconds.
    let now_s = (day(4.0) + Span::from_seconds(2)).unix_seconds();
    let period_s = |width_s: i64| match width_s {
        1 => 86_400,
        10 => 2 * 86_400,
        60 => 3 * 86_400,
        _ => 1_000 * 86_400,
    };
    let remaining = read_rollups(&mut connection).await;
    let must_stay = |((run, width_s, bucket_s, ..), _): &(&(i64, i64, i64, i64, i64), &_)| {
        *run == 2 || *width_s == 0 || bucket_s + width_s > now_s - period_s(*width_s)
    };
    // An iteration arrives at most an hour after it began. It is deleted with the iterations that
    // arrived within the next hour. The 60 s are a tolerance.
    let may_stay = |((_, width_s, bucket_s, ..), _): &(&(i64, i64, i64, i64, i64), &_)| {
        bucket_s + width_s + 2 * RESOLUTION_S + 60 > now_s - period_s(*width_s)
    };
    let expected = before
        .iter()
        .filter(must_stay)
        .map(|(key, row)| (*key, row.clone()))
        .collect::<std::collections::BTreeMap<_, _>>();
    let deleted: Vec<_> = before.iter().filter(|(key, _)| !remaining.contains_key(*key)).collect();
    assert!(deleted.iter().all(|row| !must_stay(row)), "{deleted:?}");
    assert!(deleted.len() > 1_000, "{}", deleted.len());
    let too_old: Vec<_> = remaining.iter().filter(|row| !must_stay(row) && !may_stay(row)).collect();
    assert!(too_old.is_empty(), "{too_old:?}");
    let remaining_expected = remaining
        .iter()
        .filter(|(key, _)| expected.contains_key(*key))
        .map(|(key, row)| (*key, row.clone()))
        .collect();
    assert_same(&remaining_expected, &expected);

    let cutoff_ns = (now_s - 2 * 86_400) * 1_000_000_000;
    let oldest = test_store.count("SELECT min(started_ns) FROM iteration WHERE run = 1").await;
    let slack_ns = (2 * RESOLUTION_S + 60) * 1_000_000_000;
    assert!(
        oldest <= cutoff_ns + Span::from_seconds_f64(INTERVAL_S).nanos() && oldest >= cutoff_ns - slack_ns,
        "{oldest} {cutoff_ns}"
    );
    let first = test_store.count("SELECT min(number) FROM iteration WHERE run = 1").await;
    // The column `nodes_from` has the number of the last deleted iteration.
    assert_eq!(test_store.count("SELECT nodes_from FROM run WHERE number = 1").await, first - 1);
    let remaining = 288 - (first - 1);
    assert_eq!(test_store.count("SELECT count(*) FROM iteration WHERE run = 1").await, remaining);
    assert_eq!(
        test_store.count("SELECT count(*) FROM node WHERE run = 1").await,
        remaining * NODES_PER_ITERATION
    );
    assert_eq!(test_store.count("SELECT count(*) FROM transit WHERE run = 1").await, remaining * 2);
    assert_eq!(test_store.count("SELECT count(*) FROM anchor WHERE run = 1").await, remaining);
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 2").await, 288 * NODES_PER_ITERATION);
    // The table `trimmed` has a row for iterations, and a row for each width of deleted roll-ups: 1, 10 and 60 s.
    assert_eq!(test_store.count("SELECT count(*) FROM trimmed WHERE run = 1").await, 4);
    assert_eq!(test_store.count("SELECT count(*) FROM trimmed WHERE run = 2").await, 0);

    // The statistics of the run are unchanged. Only the points of its series are wider.
    assert_eq!(test_store.store.statistics_of(1).await.expect("answers").stages, stages);
    let filter = IterationFilter::default();
    let listed = test_store.store.iterations(1, &filter).await.expect("answers");
    assert_eq!(i64::try_from(listed[0].number).expect("small"), first);
    assert!(test_store.store.iteration(1, 1).await.expect("answers").is_none());
    for (run, width_s) in [(1, 3_600), (2, 60)] {
        let series = test_store.store.series(run, &[stage::TOTAL], 6_000).await.expect("answers");
        assert_eq!(series.bucket_s, width_s);
        let counts = series.stages[0].points.iter().map(|point| point.count);
        assert_eq!(counts.sum::<u64>(), 288);
    }
}

#[tokio::test]
async fn deletions_are_one_incident_with_counts() {
    let (test_store, _) = store_two_runs().await;
    let mut connection = test_store.second_connection().await;
    let seconds = "SELECT count(*) FROM rollup WHERE run = 1 AND resolution_s = 1";
    let before = test_store.count(seconds).await;
    let mut retention =
        Retention::new(RetentionConfig { seconds_days: 1, nodes_days: 2, ..unlimited_retention() });
    assert!(run_until_done(&mut retention, &mut connection, day(4.0)).await > 10);
    let deleted = before - test_store.count(seconds).await;
    let iterations = 288 - test_store.count("SELECT count(*) FROM iteration WHERE run = 1").await;
    assert!(deleted > 0 && iterations > 0, "{deleted} {iterations}");
    let incidents = test_store.store.incidents(&IncidentFilter::newest(10)).await.expect("answers");
    let [incident] = &incidents[..] else { panic!("one incident for all deletions: {incidents:?}") };
    assert_eq!((incident.kind.as_str(), incident.host), ("retention", None));
    assert_eq!(
        incident.text,
        format!(
            "deleted {iterations} iterations with their trees of 1 run (nodes_days = 2), {deleted} statistics per second of \
             1 run (seconds_days = 1)"
        )
    );
    let report = examine(&test_store.path, Examination { full: false, now: NOW }).await.expect("opens");
    assert!(
        report.findings.iter().any(|finding| finding.what.contains(&incident.text)),
        "{:?}",
        report.findings
    );
    // A day later another incident begins.
    run_until_done(&mut retention, &mut connection, day(5.0)).await;
    assert_eq!(test_store.store.incidents(&IncidentFilter::newest(10)).await.expect("answers").len(), 2);
}

#[tokio::test]
async fn jump_of_robot_clock_deletes_nothing_early() {
    for jump_days in [400.0, -400.0] {
        let mut test_store = TestStore::new().await;
        let run = RunId::random();
        let mut random = Numbers::new(5);
        store_arrival(&mut test_store, vec![generate::run_started(run, "line", day(0.0))], day(0.0)).await;
        // The robot's clock is wrong on the second of three days.
        for hour in 0..72_u32 {
            let arrived = generate::at(f64::from(hour) * 3_600.0);
            let clock_error_s = if (24..48).contains(&hour) { jump_days * DAY } else { 0.0 };
            let started = generate::at(f64::from(hour) * 3_600.0 + clock_error_s);
            let number = u64::from(hour) + 1;
            let iteration = generate::iteration_at(run, number, test_store.hosts(), started, &mut random);
            store_arrival(&mut test_store, vec![Event::Iteration(iteration)], arrived).await;
        }
        let mut connection = test_store.second_connection().await;
        let config =
            RetentionConfig { nodes_days: 3, seconds_days: 3, ten_seconds_days: 3, ..unlimited_retention() };
        let mut retention = Retention::new(config);
        let stored = "SELECT count(DISTINCT bucket_s) FROM rollup WHERE resolution_s = 1";
        // After three days, retention deletes each hour the data that arrived three days before. The test accepts that
        // retention is late by four hours.
        for hour in 72..150_i64 {
            run_until_done(&mut retention, &mut connection, generate::at(hour as f64 * 3_600.0)).await;
            let expected_rows = (72 - (hour - 72) - 1).clamp(0, 72);
            for remaining in
                [test_store.count("SELECT count(*) FROM iteration").await, test_store.count(stored).await]
            {
                assert!(
                    (expected_rows..=expected_rows + 4).contains(&remaining),
                    "{jump_days} days, hour {hour}: {remaining} of {expected_rows}"
                );
            }
        }
        assert_eq!(test_store.count("SELECT count(*) FROM node").await, 0);
        assert_eq!(test_store.count("SELECT count(*) FROM rollup WHERE resolution_s IN (1, 10)").await, 0);
        assert_eq!(test_store.count("SELECT count(*) FROM arrival WHERE kind IN (0, 1, 10)").await, 0);
    }
}

#[tokio::test]
async fn step_is_bounded_and_idle_step_writes_nothing() {
    let (test_store, _) = store_two_runs().await;
    let mut connection = test_store.second_connection().await;
    let mut retention = Retention::new(short_retention());
    let rows = "SELECT (SELECT count(*) FROM node) + (SELECT count(*) FROM rollup)";
    let mut remaining = test_store.count(rows).await;
    let mut steps = 0;
    while step(&mut retention, &mut connection, day(5.0)).await == StepResult::More {
        let remaining_after_step = test_store.count(rows).await;
        // A step may exceed its maximum cost a little.
        assert!(remaining - remaining_after_step <= 400, "{remaining} {remaining_after_step}");
        remaining = remaining_after_step;
        steps += 1;
    }
    assert!(steps > 40, "{steps}");
    // `data_version` changes for a connection when another connection writes.
    let mut observer = test_store.second_connection().await;
    let mut version = async || -> i64 {
        sqlx::query_scalar("PRAGMA data_version").fetch_one(&mut observer).await.expect("answers")
    };
    let version_before = version().await;
    let mut clock = StorageClock::default();
    for seconds in 0..100 {
        let mono = MonoTime::from_nanos(0) + Span::from_seconds(seconds);
        let stamp = Stamp { wall: NOW, mono, ..Stamp::default() };
        let done = retention.step(&mut connection, &mut clock, stamp, MAX_STEP_COST).await.expect("steps");
        assert_eq!(done, StepResult::Done);
    }
    assert_eq!(version().await, version_before);
}

#[tokio::test]
async fn late_arrivals_are_kept_for_their_period() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    // When the run is stored, it is older than every retention period.
    let mut events = vec![generate::run_started(run, "line", day(0.0))];
    events.extend(iterations(&test_store, run, 1..=288));
    events.push(Event::RunEnded(RunEnded { run, ended: day(4.0), reason: EndReason::Stopped }));
    store_arrival(&mut test_store, events, day(100.0)).await;
    let mut connection = test_store.second_connection().await;
    let mut retention = Retention::new(short_retention());
    run_until_done(&mut retention, &mut connection, day(100.9)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 1").await, 288 * NODES_PER_ITERATION);
    assert!(test_store.count("SELECT count(*) FROM rollup WHERE resolution_s = 1").await > 288);
    run_until_done(&mut retention, &mut connection, day(104.0)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 1").await, 0);
    assert_eq!(
        test_store.count("SELECT count(*) FROM rollup WHERE run = 1 AND resolution_s IN (1, 10, 60)").await,
        0
    );
    assert_eq!(test_store.count("SELECT group_concat(kind) = '3600' FROM arrival WHERE owner = 1").await, 1);

    // These iterations also arrive a hundred days after they began. All earlier iterations of the
    // run are deleted.
    let events = iterations(&test_store, run, 300..=310);
    store_arrival(&mut test_store, events, day(104.0)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 1").await, 11 * NODES_PER_ITERATION);
    assert_eq!(test_store.count("SELECT ok FROM run WHERE number = 1").await, 299);
    assert!(test_store.store.iteration(1, 305).await.expect("answers").is_some());
    let whole = test_store.store.statistics_of(1).await.expect("answers").stages;
    let series = test_store.store.series(1, &[stage::TOTAL], 6_000).await.expect("answers");
    assert_eq!(series.bucket_s, 3_600);
    assert_eq!(series.stages[0].points.iter().map(|point| point.count).sum::<u64>(), 299);
    let rebuilt = rebuild(&mut connection, Some(1), |_| {}).await.expect("rebuilds");
    assert_eq!(rebuilt.partly_rebuilt_runs, 1);
    assert_eq!(test_store.store.statistics_of(1).await.expect("answers").stages, whole);
    // The arrival becomes a row of the table `arrival` within an hour.
    run_until_done(&mut retention, &mut connection, day(104.1)).await;
    run_until_done(&mut retention, &mut connection, day(108.0)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 1").await, 0);
    assert_eq!(test_store.count("SELECT nodes_from FROM run WHERE number = 1").await, 310);
}

#[tokio::test]
async fn rebuilt_statistics_are_deleted_after_their_period() {
    let (test_store, _) = store_two_runs().await;
    let mut connection = test_store.second_connection().await;
    let seconds = "SELECT count(*) FROM rollup WHERE run = 1 AND resolution_s = 1";
    let before = test_store.count(seconds).await;
    let mut retention = Retention::new(RetentionConfig { seconds_days: 1, ..unlimited_retention() });
    run_until_done(&mut retention, &mut connection, day(4.0)).await;
    let remaining = test_store.count(seconds).await;
    assert!(remaining < before / 3, "{remaining} of {before}");
    rebuild(&mut connection, Some(1), |_| {}).await.expect("rebuilds");
    assert_eq!(test_store.count(seconds).await, before);
    // The latest arrivals become rows of the table `arrival` within an hour.
    run_until_done(&mut retention, &mut connection, day(4.05)).await;
    run_until_done(&mut retention, &mut connection, day(4.9)).await;
    assert!(test_store.count(seconds).await >= before - remaining);
    run_until_done(&mut retention, &mut connection, day(5.2)).await;
    assert_eq!(test_store.count(seconds).await, 0);
}

#[tokio::test]
async fn data_of_unpinned_run_stays_for_another_period() {
    let (test_store, _) = store_two_runs().await;
    let mut connection = test_store.second_connection().await;
    // This statement pins the run as a person would do with the sqlite3 shell.
    sqlx::query("UPDATE run SET pinned = 1 WHERE number = 1").execute(&mut connection).await.expect("pins");
    let mut retention = Retention::new(short_retention());
    run_until_done(&mut retention, &mut connection, day(50.0)).await;
    assert!(pin(&mut connection, 2, false).await.expect("unpins"));
    // The period of the nodes is two days. It begins anew when the run is unpinned.
    run_until_done(&mut retention, &mut connection, day(51.5)).await;
    run_until_done(&mut retention, &mut connection, day(51.9)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM node").await, 2 * 288 * NODES_PER_ITERATION);
    run_until_done(&mut retention, &mut connection, day(60.0)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 1").await, 288 * NODES_PER_ITERATION);
    assert_eq!(test_store.count("SELECT count(*) FROM node WHERE run = 2").await, 0);
}

#[tokio::test]
async fn connection_between_two_arrivals_of_clock_samples_is_deleted() {
    let mut test_store = TestStore::new().await;
    for (second, arrived) in [(1, 0.0), (2, 1.0)] {
        let event = Event::Clock(Box::new(sample(test_store.cloud, second, 40)));
        store_arrival(&mut test_store, vec![event], day(arrived)).await;
    }
    let mut connection = test_store.second_connection().await;
    sqlx::query(
        "INSERT INTO connection_sample (link, at_ns, pipeline, sent_bytes, sent_messages, received_bytes, \
         received_messages, malformed_messages, late_messages, lost_messages) \
         SELECT link, at_ns + 500000000, 'line', 0, 0, 0, 0, 0, 0, 0 FROM clock_sample ORDER BY at_ns LIMIT 1",
    )
    .execute(&mut connection)
    .await
    .expect("stores");
    let config = RetentionConfig { clock_samples_days: 1, ..unlimited_retention() };
    run_until_done(&mut Retention::new(config), &mut connection, day(2.05)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 1);
    assert_eq!(test_store.count("SELECT count(*) FROM connection_sample").await, 0);
}

#[tokio::test]
async fn clock_samples_are_deleted_except_for_pinned_runs() {
    let (mut test_store, [_, pinned]) = store_two_runs().await;
    let seconds = |from: f64| (0..50).map(move |n| (from * DAY) as i64 + n);
    // The samples arrive at other times than the edge's clock shows: their age counts from the arrival.
    for (from, arrived) in [(-1.0, 4.1), (1.0, 4.2), (4.0, 4.3), (6.0, 4.4), (11.9, 11.9)] {
        let samples =
            seconds(from).map(|second| Event::Clock(Box::new(sample(test_store.cloud, second, 40))));
        let events = samples.collect();
        store_arrival(&mut test_store, events, day(arrived)).await;
    }
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 5 * 50);
    let mut connection = test_store.second_connection().await;
    // One connection for each clock sample.
    sqlx::query(
        "INSERT INTO connection_sample (link, at_ns, pipeline, sent_bytes, sent_messages, received_bytes, \
         received_messages, malformed_messages, late_messages, lost_messages) \
         SELECT link, at_ns, 'line', 0, 0, 0, 0, 0, 0, 0 FROM clock_sample",
    )
    .execute(&mut connection)
    .await
    .expect("stores");
    let config = RetentionConfig { clock_samples_days: 1, ..unlimited_retention() };
    let mut retention = Retention::new(config);
    // The pinned run has not ended: all samples of its edge since the run's start stay.
    run_until_done(&mut retention, &mut connection, day(12.0)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 4 * 50);
    let ended = RunEnded { run: pinned, ended: day(4.0), reason: EndReason::Stopped };
    let work = test_store.batch(vec![Event::RunEnded(ended)]);
    test_store.commit(&[work]).await;
    // Retention checks the samples that it kept for the pinned run again after another period. Only the samples of the
    // days 1 and 4 are from the time of the run, or at most an hour later.
    run_until_done(&mut retention, &mut connection, day(13.2)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 2 * 50);
    assert_eq!(test_store.count("SELECT count(*) FROM connection_sample").await, 2 * 50);
    assert!(pin(&mut connection, 2, false).await.expect("unpins"));
    run_until_done(&mut retention, &mut connection, day(14.4)).await;
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 0);
    assert_eq!(test_store.count("SELECT count(*) FROM connection_sample").await, 0);
    // The newest relation period stays, because it may continue.
    assert_eq!(test_store.count("SELECT count(*) FROM clock_window").await, 1);
    assert_eq!(test_store.count("SELECT count(*) FROM arrival WHERE kind = -1").await, 0);
}
