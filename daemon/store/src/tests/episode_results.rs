//! Success and return of episodes, and superseded answers.

use peernet_analysis::actuator_results::ActuatorResults;
use peernet_clock::Span;
use peernet_logger::{Measure, NodeId, RunId, Unit};
use peernet_stream::{Event, Iteration, Outcome, RunDescription};

use super::{NOW, TestStore, generate};
use crate::rebuild::rebuild;

/// Stores a run with these facts and with three episodes. The first episode ends with a lost answer, the second with a
/// warm-up iteration.
async fn store(test_store: &mut TestStore, facts: &[(&str, &str)]) {
    let run = RunId::random();
    let Event::RunStarted(description) = generate::run_started(run, "line", NOW) else {
        panic!("the start of a run")
    };
    let facts = facts.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect();
    let mut events = vec![Event::RunStarted(RunDescription { facts, ..description })];
    let iterations = [
        (Outcome::Ok, false, vec![("superseded", 1.0)]),
        (Outcome::Lost("gone".into()), false, vec![("episode-success", 0.0), ("episode-return", 1.0)]),
        (Outcome::Ok, true, vec![("episode-success", 1.0), ("episode-return", 2.0)]),
        (Outcome::Failed("stuck".into()), false, vec![("superseded", 1.0)]),
        (Outcome::Ok, false, vec![("episode-success", 1.0), ("episode-return", 6.0)]),
    ];
    for (number, (outcome, warm_up, values)) in (1..).zip(iterations) {
        let mut iteration =
            generate::iteration(run, number, test_store.hosts(), &mut generate::Numbers::new(number));
        for (name, value) in values {
            iteration.tree.add(NodeId::ROOT, name.into(), Span::ZERO, Measure::Value(value, Unit::NONE));
        }
        events.push(Event::Iteration(Iteration { outcome, warm_up, ..iteration }));
    }
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;
}

async fn results(test_store: &TestStore, run: i64) -> ActuatorResults {
    test_store.store.run(run).await.expect("answers").expect("exists").summary.actuator
}

#[tokio::test]
async fn episodes_with_failed_last_iteration_have_results() {
    let mut test_store = TestStore::new().await;
    store(&mut test_store, &[("Load", "closed"), ("Actuator", "an arm")]).await;
    let results_of_run = results(&test_store, 1).await;
    let (success, returns) =
        (results_of_run.success.expect("is reported"), results_of_run.episode_return.expect("is reported"));
    assert_eq!((success.episodes, (success.rate * 3.0).round(), returns.mean), (3, 2.0, 3.0));
    assert_eq!(results_of_run.superseded, 1, "only iterations in the statistics count");
    let listed = test_store.store.runs(&crate::types::RunFilter::default()).await.expect("answers");
    assert_eq!(listed[0].actuator, results_of_run, "the list of runs has the same results");

    let mut connection = test_store.second_connection().await;
    rebuild(&mut connection, None, |_| {}).await.expect("rebuilds");
    assert_eq!(results(&test_store, 1).await, results_of_run, "rebuilt from the nodes");
}

/// Results are computed from the values of iterations alone, as the columns of result files are.
#[tokio::test]
async fn run_without_fact_actuator_has_same_results() {
    let mut test_store = TestStore::new().await;
    store(&mut test_store, &[("Load", "closed"), ("Actuator", "an arm")]).await;
    store(&mut test_store, &[("Load", "closed")]).await;
    assert_eq!(results(&test_store, 2).await, results(&test_store, 1).await);
}
