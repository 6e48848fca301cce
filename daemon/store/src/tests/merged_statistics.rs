//! Merged statistics of several runs equal the statistics of all iterations of these runs.

use peernet_clock::Span;
use peernet_logger::{Measure, NodeId, RunId, Unit, stage};
use peernet_stream::Event;

use super::{NOW, TestStore, generate};
use crate::types::RunStatistics;

/// Stores a run with one iteration for each reading.
async fn store(test_store: &mut TestStore, readings: &[f64]) {
    let (run, mut numbers) = (RunId::random(), generate::Numbers::new(11));
    let mut events = vec![generate::run_started(run, "line", NOW)];
    for (index, reading) in readings.iter().enumerate() {
        let mut iteration = generate::iteration(run, index as u64 + 1, test_store.hosts(), &mut numbers);
        let measure = Measure::Value(*reading, Unit::new("m"));
        iteration.tree.add(NodeId::ROOT, "range".into(), Span::ZERO, measure);
        events.push(Event::Iteration(iteration));
    }
    let mut work = Vec::new();
    for events in events.chunks(50) {
        work.push(test_store.batch(events.to_vec()));
    }
    test_store.commit(&work).await;
}

#[tokio::test]
async fn merged_quantiles_are_within_one_percent() {
    let mut test_store = TestStore::new().await;
    // The readings of the runs lie in three ranges, of which two overlap. An average of the runs' quantiles would be far
    // from the true quantiles.
    let mut numbers = generate::Numbers::new(5);
    let mut readings = |count: usize, lo: i64, hi: i64| {
        (0..count).map(|_| numbers.between(lo, hi) as f64 / 1e3).collect::<Vec<f64>>()
    };
    let runs = [readings(200, 1_000, 2_000), readings(150, 1_800, 5_000), readings(40, 90_000, 100_000)];
    for run in &runs {
        store(&mut test_store, run).await;
    }
    let statistics = test_store.store.statistics(&[3, 1, 2]).await.expect("answers");
    let range_statistics = |statistics: &RunStatistics| {
        let range = statistics.stages.iter().find(|stage| stage.stage == *"range").expect("stored");
        assert_eq!(range.unit, "m");
        range.statistics
    };
    assert_eq!(
        (range_statistics(&statistics[0]).p95, range_statistics(&statistics[1]).p99),
        (None, None),
        "40 readings are too few for the 95 % quantile, and 200 for the 99 % quantile"
    );
    let merged = RunStatistics::merged(&statistics);
    let merged_range = range_statistics(&merged);

    let mut all_readings = runs.concat();
    all_readings.sort_by(f64::total_cmp);
    let mean = all_readings.iter().sum::<f64>() / all_readings.len() as f64;
    let std = (all_readings.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
        / (all_readings.len() - 1) as f64)
        .sqrt();
    assert_eq!(
        (merged_range.count, merged_range.min, merged_range.max),
        (390, all_readings[0], all_readings[389])
    );
    assert!((merged_range.mean - mean).abs() < 1e-9 * mean, "{merged_range:?} {mean}");
    assert!((merged_range.std.expect("many") - std).abs() < 1e-9 * std, "{merged_range:?} {std}");
    for (q, quantile) in [(0.5, Some(merged_range.p50)), (0.95, merged_range.p95), (0.99, merged_range.p99)] {
        let rank = q * 389.0_f64;
        let (below, above) = (all_readings[rank.floor() as usize], all_readings[rank.ceil() as usize]);
        let (exact, quantile) = (below + (above - below) * rank.fract(), quantile.expect("enough readings"));
        // The error of a sketch is at most 1 %; the remaining tolerance is for rounding.
        assert!((quantile - exact).abs() <= 0.0101 * exact, "{q}: {quantile} {exact}");
    }
    let range = merged.mergeable.summary("range").expect("still mergeable");
    assert_eq!((range.count(), range.moments.max), (390, all_readings[389]));

    // Bounds of delays are also merged.
    let bound = merged.mergeable.bound(&stage::UPLOAD).expect("judged");
    let bounds_of_runs: Vec<_> =
        statistics.iter().filter_map(|run| run.mergeable.bound(&stage::UPLOAD)).collect();
    assert_eq!(bound.verdicts[0].1, bounds_of_runs.iter().map(|bound| bound.verdicts[0].1).sum::<u64>());
    assert_eq!(bound.half_width.map(|width| width.count), Some(390));
    assert!(merged.bounds.contains(&bound));
}
