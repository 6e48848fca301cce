//! Roll-ups that are rebuilt from nodes equal the roll-ups that the writer updated with each commit.

use peernet_clock::Span;
use peernet_logger::{Measure, NodeId, RunId, Unit, stage};
use peernet_stream::{Event, Iteration, Outcome};
use sqlx::Connection;

use super::generate::{self, Numbers};
use super::rollups::{assert_same, read_rollups};
use super::{NOW, TestStore};
use crate::rebuild::{Rebuilt, rebuild};

/// Makes iterations that cover about an hour, in random order. Some are warm-up, and some have no answer.
fn iterations(test_store: &TestStore, run: RunId, count: u64, numbers: &mut Numbers) -> Vec<Event> {
    let mut all: Vec<Iteration> = (1..=count)
        .map(|number| {
            let started = generate::at(number as f64 * 9.7 + numbers.between(0, 3_000) as f64 * 1e-3);
            let mut iteration = generate::iteration_at(run, number, test_store.hosts(), started, numbers);
            iteration.warm_up = number <= 3;
            iteration.outcome = match numbers.between(0, 10) {
                0 => Outcome::Timeout(String::new()),
                1 => Outcome::Failed("no".into()),
                _ => Outcome::Ok,
            };
            iteration
        })
        .collect();
    for at in (1..all.len()).rev() {
        let other = usize::try_from(numbers.between(0, at as i64 + 1)).expect("an index");
        all.swap(at, other);
    }
    all.into_iter().map(Event::Iteration).collect()
}

/// Makes a database with two runs whose iterations arrived in random order, in commits of random sizes.
async fn store_with_random_arrivals(seed: u64) -> TestStore {
    let mut test_store = TestStore::new().await;
    let mut numbers = Numbers::new(seed);
    let runs = [RunId::random(), RunId::random()];
    let started = runs.map(|run| generate::run_started(run, "line", NOW));
    let work = test_store.batch(started.into());
    test_store.commit(&[work]).await;
    let lists = runs.map(|run| iterations(&test_store, run, 400, &mut numbers));
    let mut lists = lists.map(Vec::into_iter);
    loop {
        let mut work = Vec::new();
        for list in &mut lists {
            let batch_length = usize::try_from(numbers.between(1, 60)).expect("few");
            let events: Vec<Event> = list.by_ref().take(batch_length).collect();
            if !events.is_empty() {
                work.push(test_store.batch(events));
            }
        }
        if work.is_empty() {
            return test_store;
        }
        test_store.commit(&work).await;
    }
}

#[tokio::test]
async fn rebuilt_statistics_equal_incremental_statistics() {
    for seed in 1..=4 {
        let test_store = store_with_random_arrivals(seed).await;
        let mut connection = test_store.second_connection().await;
        let verdicts = "SELECT run, name, verdict, count FROM verdict_count ORDER BY run, name, verdict";
        let verdict_counts: Vec<(i64, i64, i64, i64)> =
            sqlx::query_as(verdicts).fetch_all(&mut connection).await.expect("reads");
        let incremental = read_rollups(&mut connection).await;
        assert!(
            incremental.len() > 10_000 && verdict_counts.len() == 4,
            "{} {verdict_counts:?}",
            incremental.len()
        );
        // Makes all statistics wrong, and adds a row that should not exist.
        sqlx::raw_sql("UPDATE rollup SET count = count + 1, mean = 7; UPDATE verdict_count SET count = 1")
            .execute(&mut connection)
            .await
            .expect("spoils");
        sqlx::query("INSERT INTO rollup SELECT run, 60, 60, name, quantity, 1, 1, 0, 1, 1, sketch FROM rollup WHERE run = 1 AND resolution_s = 0")
            .execute(&mut connection)
            .await
            .expect("spoils");
        let mut progress_reports = Vec::new();
        let rebuilt = rebuild(&mut connection, None, |progress| progress_reports.push(*progress))
            .await
            .expect("rebuilds");
        assert_same(&read_rollups(&mut connection).await, &incremental);
        let rebuilt_verdict_counts: Vec<(i64, i64, i64, i64)> =
            sqlx::query_as(verdicts).fetch_all(&mut connection).await.expect("reads");
        assert_eq!(rebuilt_verdict_counts, verdict_counts);
        let ok = test_store.count("SELECT sum(ok) FROM run").await.unsigned_abs();
        assert_eq!(rebuilt, Rebuilt { runs: 2, iterations: ok, partly_rebuilt_runs: 0 });
        assert_eq!(progress_reports.last(), Some(&rebuilt));
        connection.close().await.expect("closes");
    }
}

#[tokio::test]
async fn rebuild_of_one_run_changes_no_other_run() {
    let test_store = store_with_random_arrivals(9).await;
    let mut connection = test_store.second_connection().await;
    let incremental = read_rollups(&mut connection).await;
    sqlx::query("DELETE FROM rollup").execute(&mut connection).await.expect("empties");
    let rebuilt = rebuild(&mut connection, Some(2), |_| {}).await.expect("rebuilds");
    assert_eq!((rebuilt.runs, rebuilt.partly_rebuilt_runs), (1, 0));
    let rollups_of_second_run = incremental.into_iter().filter(|((run, ..), _)| *run == 2).collect();
    assert_same(&read_rollups(&mut connection).await, &rollups_of_second_run);
    let rebuilt = rebuild(&mut connection, Some(3), |_| {}).await.expect("finds no run");
    assert_eq!(rebuilt, Rebuilt::default());
}

#[tokio::test]
async fn extreme_values_are_stored_outside_statistics() {
    let mut test_store = TestStore::new().await;
    let (run, mut numbers) = (RunId::random(), Numbers::new(3));
    let work = test_store.batch(vec![generate::run_started(run, "line", NOW)]);
    test_store.commit(&[work]).await;
    // Some drivers report such numbers if they have no reading. The valid readings are 1 m and 3 m.
    for (at, range) in [f64::MAX, 1.0, -f64::MAX, f64::INFINITY, 3.0].into_iter().enumerate() {
        let mut iteration = generate::iteration(run, at as u64 + 1, test_store.hosts(), &mut numbers);
        iteration.tree.add(NodeId::ROOT, "range".into(), Span::ZERO, Measure::Value(range, Unit::new("m")));
        let work = test_store.batch(vec![Event::Iteration(iteration)]);
        let committed = test_store.commit(&[work]).await;
        assert!(committed.quarantined.is_empty(), "{range}: {:?}", committed.quarantined);
    }
    let statistics = test_store.store.statistics_of(1).await.expect("answers").stages;
    let range = statistics.iter().find(|statistics| statistics.stage == *"range").expect("known");
    assert_eq!((range.statistics.count, range.statistics.mean, range.statistics.max), (2, 2.0, 3.0));

    let mut connection = test_store.second_connection().await;
    let incremental = read_rollups(&mut connection).await;
    rebuild(&mut connection, None, |_| {}).await.expect("rebuilds");
    assert_same(&incremental, &read_rollups(&mut connection).await);
}

/// An earlier version included numbers close to infinity in statistics.
#[tokio::test]
async fn invalid_statistics_do_not_block_writer_and_are_rebuilt() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(60).await;
    let mut connection = test_store.second_connection().await;
    sqlx::query("UPDATE rollup SET mean = ?1, m2 = ?2, min = ?3, max = ?1 WHERE quantity = 0")
        .bind(f64::MAX)
        .bind(f64::INFINITY)
        .bind(-f64::MAX)
        .execute(&mut connection)
        .await
        .expect("spoils");
    // A new writer has no roll-ups in memory, so it reads the invalid statistics.
    test_store.writer = super::open(&test_store.path).await;
    let mut numbers = Numbers::new(9);
    for number in 61..=70 {
        let iterations = (0..10).map(|at| {
            Event::Iteration(generate::iteration(run, number * 10 + at, test_store.hosts(), &mut numbers))
        });
        let work = test_store.batch(iterations.collect());
        let committed = test_store.commit(&[work]).await;
        assert!(committed.quarantined.is_empty(), "{number}: {:?}", committed.quarantined);
    }
    // Statistics accept numbers of up to 1e140.
    let stages = test_store.store.statistics_of(1).await.expect("answers").stages;
    assert!(stages.iter().any(|stage| stage.statistics.max > 1e140), "the writer leaves invalid statistics");

    rebuild(&mut connection, None, |_| {}).await.expect("rebuilds");
    let stages = test_store.store.statistics_of(1).await.expect("answers").stages;
    let total = stages.iter().find(|statistics| statistics.stage == stage::TOTAL).expect("known").statistics;
    assert_eq!(total.count, 160);
    for statistics in stages {
        let quantity = statistics.statistics;
        let all =
            [Some(quantity.mean), quantity.std, Some(quantity.min), Some(quantity.p50), Some(quantity.max)];
        assert!(
            all.iter().flatten().all(|number| number.abs() < 1e140),
            "{}: {quantity:?}",
            statistics.stage
        );
    }
}
