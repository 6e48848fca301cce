//! Pairs of values: which iterations are read, and the value of an iteration with several nodes of the same name.

use peernet_clock::Span;
use peernet_logger::{Measure, NodeId, RunId, Unit, stage};
use peernet_stream::{Event, Iteration, Outcome};

use super::retention::{day, run_until_done, short_retention, store_two_runs};
use super::{NOW, TestStore, generate};
use crate::retention::Retention;
use crate::types::ValuePairs;

/// Duration of an additional inference node.
const ADDITIONAL_INFERENCE: Span = Span::from_millis(1_000);

impl TestStore {
    /// Makes the iteration with this number. The answer has 10 × `number` bytes and 2 × `number` tokens, and the
    /// inference takes `number` seconds.
    fn iteration_with_answer(&self, run: RunId, number: u64) -> Iteration {
        let mut iteration =
            generate::iteration(run, number, self.hosts(), &mut generate::Numbers::new(number));
        let tree = &mut iteration.tree;
        let (id, _) = tree.find(&[stage::INFERENCE.as_str()]).expect("a stage");
        let duration = Measure::Timer(Some(Span::from_seconds_f64(number as f64)));
        *tree.measure_mut(id).expect("a node") = duration;
        let mut add = |name: &'static str, value: f64| {
            let measure = Measure::Value(value, Unit::NONE);
            tree.add(NodeId::ROOT, name.into(), Span::ZERO, measure);
        };
        add("download-bytes", 10.0 * number as f64);
        add("completion-tokens", 2.0 * number as f64);
        iteration
    }

    async fn store_iterations(&mut self, iterations: impl Iterator<Item = Iteration>) {
        let mut work = Vec::new();
        for iteration in iterations {
            work.push(self.batch(vec![Event::Iteration(iteration)]));
        }
        self.commit(&work).await;
    }

    /// Stores a run of iterations with these numbers.
    async fn store_run_with_answers(&mut self, numbers: std::ops::RangeInclusive<u64>) -> RunId {
        let run = RunId::random();
        let work = self.batch(vec![generate::run_started(run, "line", NOW)]);
        self.commit(&[work]).await;
        let all: Vec<Iteration> = numbers.map(|number| self.iteration_with_answer(run, number)).collect();
        self.store_iterations(all.into_iter()).await;
        run
    }

    async fn pairs(&self, x: &str, max_points: u32) -> ValuePairs {
        self.store.value_pairs(1, [x, "inference"], max_points).await.expect("answers")
    }
}

#[tokio::test]
async fn limited_pairs_are_spread_over_run() {
    let mut test_store = TestStore::new().await;
    assert_eq!(test_store.pairs("download-bytes", 10).await, ValuePairs::default(), "no such run");
    test_store.store_run_with_answers(1..=400).await;
    for (name, factor) in [("download-bytes", 10.0), ("completion-tokens", 2.0)] {
        let complete = test_store.pairs(name, 400).await;
        assert!(complete.is_complete());
        let expected: Vec<(f64, f64)> = (1..=400).map(|n| (f64::from(n) * factor, f64::from(n))).collect();
        assert_eq!(
            (complete.points, complete.read_iterations, complete.stored_iterations),
            (expected, 400, 400)
        );
        let limited = test_store.pairs(name, 40).await;
        assert!(!limited.is_complete());
        assert_eq!((limited.points.len(), limited.read_iterations, limited.stored_iterations), (40, 40, 400));
        for (index, (x, y)) in limited.points.iter().enumerate() {
            assert_eq!(x / factor, *y);
            assert_eq!((y - 1.0) as usize / 10, index, "one of every ten iterations");
        }
    }
    assert_eq!(test_store.pairs("download-bytes", 0).await.points, []);
    assert_eq!(test_store.pairs("' OR 1", 400).await.points, []);
}

#[tokio::test]
async fn values_outside_statistics_make_no_pairs() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run_with_answers(1..=4).await;
    let warm_up = Iteration { warm_up: true, ..test_store.iteration_with_answer(run, 5) };
    let outcomes =
        [Outcome::Failed("no".into()), Outcome::Lost("gone".into()), Outcome::Timeout(String::new())];
    let unanswered = (6..)
        .zip(outcomes)
        .map(|(number, outcome)| Iteration { outcome, ..test_store.iteration_with_answer(run, number) });
    let mut without_bytes = test_store.iteration_with_answer(run, 9);
    let (id, _) = without_bytes.tree.find(&["download-bytes"]).expect("a node");
    // `None`: the reading of the number failed.
    *without_bytes.tree.measure_mut(id).expect("a node") = Measure::Custom("value".into(), Unit::BYTES, None);
    let all: Vec<Iteration> = [warm_up, without_bytes].into_iter().chain(unanswered).collect();
    test_store.store_iterations(all.into_iter()).await;
    let pairs = test_store.pairs("download-bytes", 100).await;
    assert_eq!(pairs.points, [(10.0, 1.0), (20.0, 2.0), (30.0, 3.0), (40.0, 4.0)]);
    // Iterations outside statistics are read, but yield no pair.
    assert_eq!((pairs.read_iterations, pairs.stored_iterations), (9, 9));
    assert_eq!(
        test_store.pairs("completion-tokens", 100).await.points.len(),
        5,
        "one iteration has tokens and no bytes"
    );
}

#[tokio::test]
async fn nodes_of_one_name_are_summed() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run_with_answers(1..=1).await;
    let mut repeated_nodes = test_store.iteration_with_answer(run, 2);
    let (inference, _) = repeated_nodes.tree.find(&["inference"]).expect("a stage");
    let duration = Measure::Timer(Some(ADDITIONAL_INFERENCE));
    repeated_nodes.tree.add(NodeId::ROOT, stage::INFERENCE, Span::ZERO, duration.clone());
    // The time of a child with the same name is already part of the time of its parent.
    repeated_nodes.tree.add(inference, stage::INFERENCE, Span::ZERO, duration);
    for (parent, value) in [(inference, 77.0), (NodeId::ROOT, 99.0)] {
        repeated_nodes.tree.add(
            parent,
            "completion-tokens".into(),
            Span::ZERO,
            Measure::Value(value, Unit::NONE),
        );
    }
    repeated_nodes.tree.add(
        NodeId::ROOT,
        "download-bytes".into(),
        Span::ZERO,
        Measure::Value(5.0, Unit::BYTES),
    );
    test_store.store_iterations([repeated_nodes].into_iter()).await;
    assert_eq!(test_store.pairs("download-bytes", 9).await.points, [(10.0, 1.0), (25.0, 3.0)]);
    assert_eq!(
        test_store.pairs("completion-tokens", 9).await.points,
        [(2.0, 1.0), (4.0 + 77.0 + 99.0, 3.0)],
        "nodes under different parents are summed, too"
    );
}

#[tokio::test]
async fn deleted_iterations_make_no_pairs() {
    let (test_store, _) = store_two_runs().await;
    let mut connection = test_store.second_connection().await;
    let mut retention = Retention::new(short_retention());
    let pairs_before = test_store.pairs("upload-bytes", 20).await;
    assert_eq!((pairs_before.points.len(), pairs_before.stored_iterations), (20, 288));
    run_until_done(&mut retention, &mut connection, day(4.0)).await;
    // `nodes_from` is the number of the last deleted iteration.
    let remaining = test_store.count("SELECT 288 - nodes_from FROM run WHERE number = 1").await;
    assert!((50..200).contains(&remaining), "{remaining}");
    let pairs_after = test_store.pairs("upload-bytes", 20).await;
    assert_eq!(
        (pairs_after.points.len(), pairs_after.stored_iterations),
        (20, remaining as u64),
        "only numbers of stored iterations are chosen"
    );
}
