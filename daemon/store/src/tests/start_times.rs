//! The time over which the rate of a run is computed. It is the same for a stored run as for the run's files.

use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::{Row, Rows};
use peernet_analysis::trust::{StartTimes, TrustInput};
use peernet_clock::{Span, WallTime};
use peernet_logger::RunId;
use peernet_stream::{Event, Iteration, Outcome};

use super::{NOW, TestStore, generate};

/// Number of iterations, ten per second. The first ten and the last ten are warm-up, as if an episode began with the
/// run, and another episode one second before the end of the run.
const COUNT: u64 = 300;

/// Returns the start times of a run, first according to the store, then according to the rows of files. `start` and
/// `outcome` return the start and the outcome of the iteration with a number.
async fn start_times(
    start: impl Fn(u64) -> WallTime,
    outcome: impl Fn(u64) -> Outcome,
) -> (StartTimes, StartTimes) {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let mut numbers = generate::Numbers::new(3);
    let iterations: Vec<Iteration> = (1..=COUNT)
        .map(|number| Iteration {
            warm_up: number <= 10 || number > COUNT - 10,
            outcome: outcome(number),
            ..generate::iteration_at(run, number, test_store.hosts(), start(number), &mut numbers)
        })
        .collect();
    let rows: Rows = iterations.iter().map(Row::from_iteration).collect();
    let started = std::iter::once(generate::run_started(run, "line", NOW));
    let work = test_store.batch(started.chain(iterations.into_iter().map(Event::Iteration)).collect());
    test_store.commit(&[work]).await;
    let detail = test_store.store.run(1).await.expect("answers").expect("is stored");
    let stored = test_store.store.trust_input(&detail).await.expect("answers").starts.times;
    (stored, TrustInput::from_run(&RunRecord::default(), &rows).starts.times)
}

fn at(number: u64) -> WallTime {
    NOW + Span::from_millis(100 * number as i64)
}

fn answered(_: u64) -> Outcome {
    Outcome::Ok
}

#[tokio::test]
async fn start_times_exclude_warm_up_at_both_ends() {
    let (stored, of_files) = start_times(at, answered).await;
    assert_eq!(stored, StartTimes { first: Some(at(11)), last: Some(at(290)), standstill_s: None });
    let near = |a: Option<f64>, b: Option<f64>| a.zip(b).is_some_and(|(a, b)| (a - b).abs() < 1e-6);
    assert!(near(stored.seconds(), of_files.seconds()), "{of_files:?}");
}

#[tokio::test]
async fn rate_is_unknown_if_clock_was_set_during_run() {
    for set_by_s in [3_600, -3_600] {
        // By the wall clock, there is an hour without a start between the starts before and after the step.
        let start = |number| at(number) + Span::from_seconds(if number > 150 { set_by_s } else { 0 });
        let (stored, of_files) = start_times(start, answered).await;
        assert_eq!((stored.seconds(), of_files.seconds()), (None, None), "{set_by_s}");
        assert!(stored.standstill_s.is_some() && of_files.standstill_s.is_some(), "{stored:?} {of_files:?}");
    }
}

#[tokio::test]
async fn unanswered_iterations_are_no_standstill() {
    // In the middle of the run there is one iteration every 20 s, without an answer.
    let start = |number: u64| at(number) + Span::from_seconds(20 * number.clamp(100, 200) as i64);
    let outcome = |number: u64| match number {
        100..=200 => Outcome::Timeout("no answer".to_owned()),
        _ => Outcome::Ok,
    };
    let (stored, of_files) = start_times(start, outcome).await;
    assert_eq!((stored.standstill_s, of_files.standstill_s), (None, None));
    // The first start is that of iteration 11, the last is that of iteration 290: 279 × 0.1 s, and
    // 100 × 20 s more.
    assert!(stored.seconds().is_some_and(|seconds| (seconds - 2_027.9).abs() < 1e-6), "{stored:?}");
}
