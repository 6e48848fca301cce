//! What is old goes in its time, a little at a time, and nothing else does.

use peernet_clock::{Span, WallTime};
use peernet_logger::stream::{Event, RunEnded};
use peernet_logger::{RunId, stage};
use sqlx::SqliteConnection;

use super::Bed;
use super::clocks::sample;
use super::generate::{self, Numbers};
use super::rollups::{assert_same, table};
use crate::config::RetentionConfig;
use crate::store::rebuild::rebuild;
use crate::store::retention::{Retention, Step, pin};
use crate::store::types::IterationFilter;

const DAY: f64 = 86_400.0;
/// Time between two iterations: a bucket of each width for each of them, nearly.
const EVERY: f64 = 1_200.0;

/// Iterations of a run, one every [`EVERY`] seconds from a day on.
pub(super) fn iterations(bed: &Bed, run: RunId, numbers: std::ops::RangeInclusive<u64>) -> Vec<Event> {
    let mut random = Numbers(*numbers.start());
    numbers
        .map(|number| {
            let started = generate::at(number as f64 * EVERY);
            Event::Iteration(generate::iteration_at(run, number, bed.hosts(), started, &mut random))
        })
        .collect()
}

pub(super) fn day(days: f64) -> WallTime {
    generate::at(days * DAY)
}

/// Two runs alike of four days, the second one pinned, neither ended.
pub(super) async fn two_runs() -> (Bed, [RunId; 2]) {
    let mut bed = Bed::new().await;
    let runs = [RunId::random(), RunId::random()];
    let names = ["line", "arm"];
    for (run, name) in runs.into_iter().zip(names) {
        let mut events = vec![generate::run_started(run, name, day(0.0))];
        events.extend(iterations(&bed, run, 1..=288));
        let work = bed.batch(events);
        bed.commit(&[work]).await;
    }
    let mut connection = bed.other().await;
    assert!(pin(&mut connection, 2, true).await.expect("pins"));
    assert!(!pin(&mut connection, 3, true).await.expect("looks"));
    (bed, runs)
}

/// Steps until there is nothing to do; returns how many did something.
pub(super) async fn work_off(
    retention: &mut Retention,
    connection: &mut SqliteConnection,
    now: WallTime,
) -> usize {
    // Behind the second in which it is not looked again.
    let now = now + Span::from_seconds(2);
    for steps in 0..10_000 {
        if retention.step(connection, now, 300).await.expect("steps") == Step::Done {
            return steps;
        }
    }
    panic!("there is no end");
}

pub(super) fn short() -> RetentionConfig {
    RetentionConfig {
        nodes_days: 2,
        seconds_days: 1,
        ten_seconds_days: 2,
        minutes_days: 3,
        ..RetentionConfig::default()
    }
}

#[tokio::test]
async fn each_kind_goes_in_its_time_and_pinned_runs_stay() {
    let (bed, _) = two_runs().await;
    let mut connection = bed.other().await;
    let before = table(&mut connection).await;
    let stages = bed.store.statistics_of(1).await.expect("answers").stages;
    let mut retention = Retention::new(short());
    // They arrive on the day on which they begin, and nothing goes for a day.
    work_off(&mut retention, &mut connection, day(0.0)).await;
    assert_eq!(work_off(&mut retention, &mut connection, day(1.0)).await, 0);
    assert!(work_off(&mut retention, &mut connection, day(4.0)).await > 10);

    let now_s = (day(4.0) + Span::from_seconds(2)).unix_seconds();
    let kept = |width_s: i64| match width_s {
        1 => 1,
        10 => 2,
        60 => 3,
        _ => 1_000,
    };
    let expected = before
        .into_iter()
        .filter(|((run, width_s, bucket_s, ..), _)| {
            *run == 2 || *width_s == 0 || bucket_s + width_s > now_s - kept(*width_s) * 86_400
        })
        .collect();
    let left = table(&mut connection).await;
    assert_same(&left, &expected);
    let cutoff_ns = (now_s - 2 * 86_400) * 1_000_000_000;
    let oldest = bed.count("SELECT min(started_ns) FROM iteration WHERE run = 1").await;
    assert!(oldest >= cutoff_ns && oldest < cutoff_ns + 1_200_000_000_000, "{oldest} {cutoff_ns}");
    let first = bed.count("SELECT min(number) FROM iteration WHERE run = 1").await;
    assert_eq!(bed.count("SELECT nodes_from FROM run WHERE number = 1").await, first - 1);
    let left = 288 - (first - 1);
    assert_eq!(bed.count("SELECT count(*) FROM iteration WHERE run = 1").await, left);
    assert_eq!(bed.count("SELECT count(*) FROM node WHERE run = 1").await, left * 21);
    assert_eq!(bed.count("SELECT count(*) FROM transit WHERE run = 1").await, left * 2);
    assert_eq!(bed.count("SELECT count(*) FROM anchor WHERE run = 1").await, left);
    assert_eq!(bed.count("SELECT count(*) FROM node WHERE run = 2").await, 288 * 21);
    assert_eq!(bed.count("SELECT count(*) FROM trimmed WHERE run = 1").await, 4);
    assert_eq!(bed.count("SELECT count(*) FROM trimmed WHERE run = 2").await, 0);

    // What is told of the run is what was told of it before, in wider points.
    assert_eq!(bed.store.statistics_of(1).await.expect("answers").stages, stages);
    let filter = IterationFilter::default();
    let listed = bed.store.iterations(1, &filter).await.expect("answers");
    assert_eq!(i64::try_from(listed[0].number).expect("small"), first);
    assert!(bed.store.iteration(1, 1).await.expect("answers").is_none());
    for (run, width_s) in [(1, 3_600), (2, 60)] {
        let series = bed.store.series(run, &[stage::TOTAL], 6_000).await.expect("answers");
        assert_eq!(series.bucket_s, width_s);
        let counts = series.stages[0].points.iter().map(|point| point.count);
        assert_eq!(counts.sum::<u64>(), 288);
    }
}

#[tokio::test]
async fn a_step_deletes_little_and_nothing_to_do_costs_no_writing() {
    let (bed, _) = two_runs().await;
    let mut connection = bed.other().await;
    let mut retention = Retention::new(short());
    work_off(&mut retention, &mut connection, day(0.0)).await;
    let rows = "SELECT (SELECT count(*) FROM node) + (SELECT count(*) FROM rollup)";
    let mut left = bed.count(rows).await;
    let mut steps = 0;
    while retention.step(&mut connection, day(5.0), 300).await.expect("steps") == Step::More {
        let now = bed.count(rows).await;
        assert!(left - now <= 400, "{left} {now}");
        left = now;
        steps += 1;
    }
    assert!(steps > 40, "{steps}");
    // It is told to each connection by itself, of what others wrote.
    let mut onlooker = bed.other().await;
    let mut version = async || -> i64 {
        sqlx::query_scalar("PRAGMA data_version").fetch_one(&mut onlooker).await.expect("tells")
    };
    let before = version().await;
    for seconds in 0..100 {
        let now = day(5.0) + Span::from_seconds(seconds);
        assert_eq!(retention.step(&mut connection, now, 300).await.expect("steps"), Step::Done);
    }
    assert_eq!(version().await, before);
}

#[tokio::test]
async fn what_arrives_late_is_kept_for_its_period_and_goes_then() {
    let (mut bed, [run, _]) = two_runs().await;
    let ended = RunEnded { run, ended: day(4.0), reason: "stopped".into() };
    let work = bed.batch(vec![Event::RunEnded(ended)]);
    bed.commit(&[work]).await;
    let mut connection = bed.other().await;
    let mut retention = Retention::new(short());
    // Stored when it was older than any period.
    work_off(&mut retention, &mut connection, day(100.0)).await;
    assert_eq!(work_off(&mut retention, &mut connection, day(100.5)).await, 0);
    assert_eq!(bed.count("SELECT count(*) FROM node WHERE run = 1").await, 288 * 21);
    work_off(&mut retention, &mut connection, day(103.5)).await;
    assert_eq!(bed.count("SELECT count(*) FROM node WHERE run = 1").await, 0);
    assert_eq!(
        bed.count("SELECT count(*) FROM rollup WHERE run = 1 AND resolution_s IN (1, 10, 60)").await,
        0
    );
    assert_eq!(bed.count("SELECT group_concat(kind) = '3600' FROM retained WHERE run = 1").await, 1);

    // A batch of iterations from a time that is gone.
    let events = iterations(&bed, run, 300..=310);
    let work = bed.batch(events);
    bed.commit(&[work]).await;
    work_off(&mut retention, &mut connection, day(104.0)).await;
    assert_eq!(bed.count("SELECT count(*) FROM node WHERE run = 1").await, 11 * 21);
    assert_eq!(bed.count("SELECT ok FROM run WHERE number = 1").await, 299);
    assert!(bed.store.iteration(1, 305).await.expect("answers").is_some());
    let whole = bed.store.statistics_of(1).await.expect("answers").stages;
    let series = bed.store.series(1, &[stage::TOTAL], 6_000).await.expect("answers");
    assert_eq!(series.bucket_s, 3_600);
    assert_eq!(series.stages[0].points.iter().map(|point| point.count).sum::<u64>(), 299);
    let rebuilt = rebuild(&mut connection, Some(1), |_| {}).await.expect("rebuilds");
    assert_eq!(rebuilt.in_part, 1);
    assert_eq!(bed.store.statistics_of(1).await.expect("answers").stages, whole);
    work_off(&mut retention, &mut connection, day(108.0)).await;
    assert_eq!(bed.count("SELECT count(*) FROM node WHERE run = 1").await, 0);
    assert_eq!(bed.count("SELECT nodes_from FROM run WHERE number = 1").await, 310);
}

#[tokio::test]
async fn a_run_that_is_let_go_has_its_whole_period_before_it() {
    let (bed, _) = two_runs().await;
    let mut connection = bed.other().await;
    let mut retention = Retention::new(short());
    work_off(&mut retention, &mut connection, day(50.0)).await;
    assert!(pin(&mut connection, 2, false).await.expect("lets go"));
    // By hand, as with the sqlite3 shell.
    sqlx::query("UPDATE run SET pinned = 1 WHERE number = 1").execute(&mut connection).await.expect("pins");
    work_off(&mut retention, &mut connection, day(51.5)).await;
    work_off(&mut retention, &mut connection, day(51.9)).await;
    assert_eq!(bed.count("SELECT count(*) FROM node").await, 2 * 288 * 21);
    work_off(&mut retention, &mut connection, day(60.0)).await;
    assert_eq!(bed.count("SELECT count(*) FROM node WHERE run = 1").await, 288 * 21);
    assert_eq!(bed.count("SELECT count(*) FROM node WHERE run = 2").await, 0);
}

#[tokio::test]
async fn samples_of_clocks_go_except_those_of_a_pinned_run() {
    let (mut bed, [_, pinned]) = two_runs().await;
    let seconds = |from: f64| (0..50).map(move |n| (from * DAY) as i64 + n);
    for from in [-1.0, 1.0, 4.0, 6.0, 11.9] {
        let samples = seconds(from).map(|second| Event::Clock(Box::new(sample(bed.cloud, second, 40))));
        let events = samples.collect();
        let work = bed.batch(events);
        bed.commit(&[work]).await;
    }
    let mut connection = bed.other().await;
    let config = RetentionConfig { clock_samples_days: 1, nodes_days: 0, ..RetentionConfig::default() };
    let mut retention = Retention::new(config);
    // However old they are, they stay for a day from now on.
    work_off(&mut retention, &mut connection, day(8.5)).await;
    work_off(&mut retention, &mut connection, day(9.0)).await;
    assert_eq!(bed.count("SELECT count(*) FROM clock_sample").await, 5 * 50);
    // The pinned run may go on: of its edge, all stays from its begin on.
    work_off(&mut retention, &mut connection, day(10.0)).await;
    assert_eq!(bed.count("SELECT count(*) FROM clock_sample").await, 4 * 50);
    let ended = RunEnded { run: pinned, ended: day(4.0), reason: "stopped".into() };
    let work = bed.batch(vec![Event::RunEnded(ended)]);
    bed.commit(&[work]).await;
    work_off(&mut retention, &mut connection, day(11.2)).await;
    assert_eq!(bed.count("SELECT count(*) FROM clock_sample").await, 3 * 50);
    assert!(pin(&mut connection, 2, false).await.expect("lets go"));
    work_off(&mut retention, &mut connection, day(12.4)).await;
    assert_eq!(bed.count("SELECT count(*) FROM clock_sample").await, 50);
    assert_eq!(bed.count("SELECT count(*) FROM clock_window").await, 1);
    assert_eq!(bed.store.links().await.expect("answers")[0].first, day(11.9));
}
