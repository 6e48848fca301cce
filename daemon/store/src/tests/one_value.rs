//! Pages and `data.csv` count one value of a stage in each iteration, even if several nodes have the stage's name.

use peernet_analysis::rows::Rows;
use peernet_clock::Span;
use peernet_logger::{IterationValues, Measure, NodeId, RunId, Unit, stage};
use peernet_stream::{Event, Iteration};

use super::{NOW, TestStore, generate};
use crate::rebuild::rebuild;
use crate::types::StageStatistics;

/// Number of iterations.
const COUNT: u64 = 8;

impl TestStore {
    /// Makes an iteration with a model inside another model. The iteration waited twice in the queue `send-queue`.
    fn iteration_with_inner_model(&self, run: RunId, number: u64) -> Iteration {
        let mut iteration =
            generate::iteration(run, number, self.hosts(), &mut generate::Numbers::new(number));
        let tree = &mut iteration.tree;
        let timer = |millis: u64| Measure::Timer(Some(Span::from_millis((millis + number) as i64)));
        let (outer, _) = tree.find(&["inference"]).expect("a stage");
        let inner = tree.add(outer, "inner-model".into(), Span::ZERO, timer(20));
        for name in [stage::PREPROCESSING, stage::INFERENCE, stage::RESTART] {
            tree.add(inner, name, Span::ZERO, timer(6));
        }
        for name in [stage::SEND_QUEUE, stage::SEND_QUEUE, stage::BATCH_WAIT, stage::BATCH_WAIT] {
            tree.add(NodeId::ROOT, name, Span::ZERO, timer(2));
        }
        for parent in [inner, NodeId::ROOT] {
            tree.add(parent, stage::UNKNOWN_LABEL, Span::ZERO, Measure::Value(1.0, Unit::NONE));
        }
        let (sensing, _) = tree.find(&["sensing"]).expect("a stage");
        tree.add(sensing, stage::CAPTURE, Span::ZERO, timer(1));
        tree.add(sensing, stage::CAPTURE, Span::ZERO, timer(1));
        iteration
    }
}

/// Asserts that stored statistics equal the statistics of the columns in `data.csv`, for each name with one value in an
/// iteration.
fn assert_equal_to_columns(statistics: &[StageStatistics], rows: &Rows) {
    let with_one_value =
        |stage: &&StageStatistics| IterationValues::has_one_value(&stage.stage) && stage.statistics.count > 0;
    let found: Vec<&StageStatistics> = statistics.iter().filter(with_one_value).collect();
    for stage in &found {
        let column: Vec<f64> = rows.values_in_statistics(&stage.stage).collect();
        assert_eq!(stage.statistics.count, column.len() as u64, "{}", stage.stage);
        let mean = column.iter().sum::<f64>() / column.len() as f64;
        assert!(
            (stage.statistics.mean - mean).abs() <= 1e-9 * mean,
            "{}: {mean} {:?}",
            stage.stage,
            stage.statistics
        );
    }
    for name in ["inference", "send-queue", "batch-wait", "capture", "unknown-label"] {
        assert!(found.iter().any(|found| found.stage == *name), "{name}");
    }
    // Nodes of the inner model do not count. A name has statistics exactly if it has values in its column.
    for name in ["preprocessing", "restart"] {
        let is_stored = statistics.iter().any(|stored| stored.stage == *name);
        assert_eq!(is_stored, rows.values_in_statistics(name).next().is_some(), "{name}");
    }
}

#[tokio::test]
async fn stage_of_several_nodes_equals_column_of_results() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let iterations: Vec<Iteration> =
        (1..=COUNT).map(|number| test_store.iteration_with_inner_model(run, number)).collect();
    let rows: Rows = iterations.iter().map(peernet_analysis::rows::Row::from_iteration).collect();
    let started = std::iter::once(generate::run_started(run, "line", NOW));
    let work = test_store.batch(started.chain(iterations.into_iter().map(Event::Iteration)).collect());
    test_store.commit(&[work]).await;
    let statistics = test_store.store.statistics_of(1).await.expect("answers");
    assert_equal_to_columns(&statistics.stages, &rows);
    for x in ["capture", "send-queue", "batch-wait"] {
        let pairs = test_store.store.value_pairs(1, [x, "inference"], 99).await.expect("answers");
        let expected: Vec<(f64, f64)> =
            rows.iter().filter_map(|row| row.value(x).zip(row.value("inference"))).collect();
        assert_eq!(pairs.points, expected, "{x}");
    }
    let slowest = test_store.store.slowest_iterations(1, 99).await.expect("answers");
    assert_eq!(slowest.len() as u64, COUNT);
    for iteration in slowest {
        let row = rows.iter().find(|row| row.iteration() == iteration.number).expect("a row");
        assert_eq!(iteration.total, row.value("total"));
        for (stage, seconds) in iteration.stages {
            assert_eq!(Some(seconds), row.value(&stage), "{stage}");
        }
    }

    let mut connection = test_store.second_connection().await;
    sqlx::query("DELETE FROM rollup").execute(&mut connection).await.expect("deletes");
    rebuild(&mut connection, None, |_| {}).await.expect("rebuilds");
    let rebuilt = test_store.store.statistics_of(1).await.expect("answers");
    assert_eq!(rebuilt.stages, statistics.stages);
}
