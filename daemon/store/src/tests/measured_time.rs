//! The time from the first to the last iteration of a run in the statistics. The time is exact while the iterations are
//! stored. After retention has deleted iterations, the time has the resolution of the buckets.

use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::{HostRecord, RunRecord};
use peernet_analysis::rows::{self, Row, Rows};
use peernet_analysis::users::{Users, common_time};
use peernet_clock::{Span, WallTime};
use peernet_logger::RunId;
use peernet_statistics::Summary;
use peernet_stream::{Event, ExperimentPosition, Iteration, Outcome};

use super::retention::{day, run_until_done, short_retention, store_two_runs};
use super::{TestStore, generate};
use crate::retention::Retention;
use crate::types::{IterationFilter, IterationRow, MeasuredTime, RunFilter};

/// Returns the iterations of run 1 that are in the statistics.
async fn iterations_in_statistics(test_store: &TestStore) -> Vec<IterationRow> {
    let filter = IterationFilter { limit: 1_000, ..IterationFilter::default() };
    let mut rows = test_store.store.iterations(1, &filter).await.expect("answers");
    rows.retain(|row| !row.warm_up && row.outcome == rows::Outcome::Ok);
    rows
}

async fn measured_time(test_store: &TestStore, run: i64) -> Option<MeasuredTime> {
    let runs = test_store.store.runs(&RunFilter::default()).await.expect("answers");
    let run = runs.into_iter().find(|summary| summary.number == run).expect("a run");
    test_store.store.measured_time(&run).await.expect("answers")
}

/// Makes a store with a run of two minutes. The run begins with a warm-up. Iterations without an answer follow the
/// warm-up, end the run and lie in the middle of the run.
async fn store_with_run_of_two_minutes() -> TestStore {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let mut numbers = generate::Numbers::new(7);
    let mut events = vec![generate::run_started(run, "line", generate::at(0.0))];
    for number in 1..=600 {
        // Irregular starts, about five in a second.
        let at = generate::at(number as f64 * 0.2) + Span::from_nanos(numbers.between(0, 190_000_000));
        let mut iteration = generate::iteration_at(run, number, test_store.hosts(), at, &mut numbers);
        iteration.warm_up = number <= 7;
        if [8, 9, 300, 600].contains(&number) {
            iteration.outcome = Outcome::Lost("no answer".into());
        }
        events.push(Event::Iteration(iteration));
    }
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;
    test_store
}

#[tokio::test]
async fn iterations_within_time_are_counted_exactly() {
    let test_store = store_with_run_of_two_minutes().await;
    let rows = iterations_in_statistics(&test_store).await;
    let time = measured_time(&test_store, 1).await.expect("measured");
    let (first, last) = (rows[0].started, rows[rows.len() - 1].started);
    assert_eq!((time.first, time.last, time.resolution_s), (first, last, 0));
    let after = |seconds: f64| first + Span::from_seconds_f64(seconds);
    let cases: [(WallTime, WallTime); 7] = [
        (first, last),
        (after(0.1), after(0.3)),
        (after(0.5), after(1.7)),
        (after(3.3), after(15.2)),
        (after(2.0), after(111.1)),
        (after(-9.0), after(500.0)),
        (after(40.0), after(40.0)),
    ];
    for (from, to) in cases {
        let mut totals = Summary::default();
        let within = rows.iter().filter(|row| (from..to).contains(&row.started));
        within.filter_map(|row| row.total).for_each(|total| totals.record(total));
        let found = test_store.store.measured_within(1, from, to).await.expect("answers");
        assert_eq!(found.count, totals.count(), "{from:?} {to:?}");
        assert_eq!(found.totals.quantile(0.5), totals.quantile(0.5));
        assert!((found.totals.moments.mean - totals.moments.mean).abs() < 1e-12);
    }
}

#[tokio::test]
async fn run_without_answers_has_no_measured_time() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let mut events = vec![generate::run_started(run, "line", generate::at(0.0))];
    let mut numbers = generate::Numbers::new(7);
    events.extend((1..=9).map(|number| {
        let mut iteration = generate::iteration(run, number, test_store.hosts(), &mut numbers);
        iteration.outcome = Outcome::Lost("no answer".into());
        Event::Iteration(iteration)
    }));
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;
    assert_eq!(measured_time(&test_store, 1).await, None);
}

#[tokio::test]
async fn resolution_is_that_of_remaining_buckets() {
    let (test_store, _) = store_two_runs().await;
    let exact = measured_time(&test_store, 1).await.expect("measured");
    let mut connection = test_store.second_connection().await;
    let mut retention = Retention::new(short_retention());
    run_until_done(&mut retention, &mut connection, day(9.0)).await;
    let coarse = measured_time(&test_store, 1).await.expect("buckets of an hour are never deleted");
    assert_eq!((exact.resolution_s, coarse.resolution_s), (0, 3_600));
    assert!(coarse.first >= exact.first && coarse.last <= exact.last, "{exact:?} {coarse:?}");
    let pinned = measured_time(&test_store, 2).await.expect("measured");
    assert_eq!(pinned.resolution_s, 0);
    // Both runs have iterations with the same starts.
    let within =
        async |run| test_store.store.measured_within(run, coarse.first, coarse.last).await.expect("answers");
    let (in_buckets, of_iterations) = (within(1).await, within(2).await);
    assert!(
        in_buckets.count > 0 && in_buckets.count == of_iterations.count,
        "{} {}",
        in_buckets.count,
        of_iterations.count
    );
}

/// Returns the answers per second of two edges together, first according to the store, then according to the rows of
/// files. Each edge starts 1,000 iterations, ten per second, and its clock is set back after 500 of them.
async fn rates_if_clock_is_set_back(by: Span) -> [Option<f64>; 2] {
    let mut test_store = TestStore::new().await;
    let (run, mut numbers) = (RunId::random(), generate::Numbers::new(3));
    let iterations: Vec<Iteration> = (1..=1_000)
        .map(|number| {
            let at = generate::at(number as f64 * 0.1) - if number > 500 { by } else { Span::ZERO };
            generate::iteration_at(run, number, test_store.hosts(), at, &mut numbers)
        })
        .collect();
    let rows: Rows = iterations.iter().map(Row::from_iteration).collect();
    let started = std::iter::once(generate::run_started(run, "line", generate::at(0.0)));
    let work = test_store.batch(started.chain(iterations.into_iter().map(Event::Iteration)).collect());
    test_store.commit(&[work]).await;
    let time = measured_time(&test_store, 1).await.expect("measured");
    let stored_rate = match common_time([Some((time.first, time.last)); 2]) {
        Some((from, to)) => {
            let within = test_store.store.measured_within(1, from, to).await.expect("answers");
            Some(2.0 * within.count as f64 / (to - from).seconds())
        }
        None => None,
    };
    let edge = |name: &str| Loaded {
        folder: name.into(),
        record: RunRecord {
            experiment: Some(ExperimentPosition::default()),
            edge: HostRecord { name: name.to_owned(), ..HostRecord::default() },
            ..RunRecord::default()
        },
        rows: rows.clone(),
    };
    let users = Users::from_runs(&[edge("a"), edge("b")]).expect("several edges");
    [stored_rate, users.lines[0].rate]
}

#[tokio::test]
async fn rate_of_users_is_same_in_files() {
    let [stored, of_files] = rates_if_clock_is_set_back(Span::ZERO).await;
    assert!(stored.zip(of_files).is_some_and(|(a, b)| (a - b).abs() < 1e-3), "{stored:?} {of_files:?}");
    // The store finds the starts in an incomplete second by bisection, and so misses some of those that occur twice.
    let [stored, of_files] = rates_if_clock_is_set_back(Span::from_seconds(60)).await;
    assert!(stored.zip(of_files).is_some_and(|(a, b)| (a / b - 1.0).abs() < 0.02), "{stored:?} {of_files:?}");
    assert_eq!(rates_if_clock_is_set_back(Span::from_seconds(3_600)).await, [None, None]);
}
