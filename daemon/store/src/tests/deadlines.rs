//! Counting of iterations that missed their deadline.

use peernet_analysis::deadline::Misses;
use peernet_clock::Span;
use peernet_logger::{Measure, NodeId, RunId, Unit};
use peernet_stream::{Event, Iteration, Outcome, RunDescription};

use super::{NOW, TestStore, generate};
use crate::types::RunFilter;

/// Stores a run with this configuration. `iterations` has for each iteration the outcome, and 1 if the iteration missed
/// its deadline, otherwise 0. The first iteration is warm-up.
async fn store(test_store: &mut TestStore, configuration: &str, iterations: &[(Outcome, f64)]) {
    let run = RunId::random();
    let Event::RunStarted(description) = generate::run_started(run, "line", NOW) else {
        panic!("the start of a run")
    };
    let configuration = configuration.to_owned();
    let mut events = vec![Event::RunStarted(RunDescription { configuration, ..description })];
    for (number, (outcome, missed)) in (1..).zip(iterations) {
        let mut iteration =
            generate::iteration(run, number, test_store.hosts(), &mut generate::Numbers::new(number));
        iteration.tree.add(
            NodeId::ROOT,
            "deadline-missed".into(),
            Span::ZERO,
            Measure::Value(*missed, Unit::NONE),
        );
        events.push(Event::Iteration(Iteration {
            outcome: outcome.clone(),
            warm_up: number == 1,
            ..iteration
        }));
    }
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;
}

#[tokio::test]
async fn misses_are_late_and_failed_iterations() {
    let mut test_store = TestStore::new().await;
    let lost = || Outcome::Lost("gone".into());
    let iterations = [
        (Outcome::Ok, 1.0),
        (Outcome::Ok, 0.0),
        (Outcome::Ok, 1.0),
        (Outcome::Timeout(String::new()), 1.0),
        (lost(), 1.0),
    ];
    store(&mut test_store, "name = \"line\"\ndeadline_ms = 100\n\n[sensor]\nkind = \"x\"\n", &iterations)
        .await;
    store(&mut test_store, "deadline_ms = 250\n", &[(lost(), 1.0), (lost(), 1.0)]).await;
    // A key of another table is not the deadline of the pipeline.
    store(&mut test_store, "name = \"line\"\n[sensor]\ndeadline_ms = 9\n", &iterations).await;
    let runs =
        test_store.store.runs(&RunFilter { limit: 10, ..RunFilter::default() }).await.expect("answers");
    let deadlines: Vec<_> = runs.iter().rev().map(|run| (run.deadline_s, run.misses)).collect();
    let misses = |missed, iterations| Some(Misses { missed, iterations });
    assert_eq!(deadlines, [(Some(0.1), misses(3, 4)), (Some(0.25), misses(1, 1)), (None, None)]);
    let detail = test_store.store.run(1).await.expect("answers").expect("exists");
    assert_eq!(detail.summary.misses, misses(3, 4), "equal to the list of runs");
}
