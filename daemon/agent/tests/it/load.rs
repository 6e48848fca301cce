//! Tests of rates that cannot be kept: every skipped start is counted.

use peernet_stream::{Iteration, Outcome};

use crate::harness::{Aggregator, TestAgent, assert_adds_up, assert_contiguous, value};

/// Returns a pipeline with a model that sleeps, and with further keys of both tables.
fn slow_pipeline(inference_ms: u32, model_keys: &str, pipeline_keys: &str) -> String {
    format!(
        "[[model]]\nname = 'slow'\nkind = 'sleep'\npreprocessing_ms = 0\npostprocessing_ms = 0\n\
         inference_ms = {inference_ms}\n{model_keys}\n\
         [[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 10 }}\n\
         placement = {{ kind = 'local', model = 'slow' }}\nwarm_up = {{ iterations = 0 }}\n{pipeline_keys}"
    )
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn overload_counts_skips_and_latency_from_intended_start() {
    let aggregator = Aggregator::start().await;
    // 100 starts per second, 2 answers per 40 ms: half of the starts have to be skipped.
    let pipeline = "load = { mode = 'rate', hz = 100.0 }\nmax_in_flight = 2\nlimit = { iterations = 40 }";
    let tables = slow_pipeline(40, "workers = 2", pipeline);
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;

    let mut iterations = received_events.iterations();
    assert_eq!(iterations.len(), 40);
    assert_contiguous(&iterations);
    iterations.sort_by_key(|iteration| iteration.number);
    iterations.iter().for_each(|iteration| assert_adds_up(iteration));
    // The intended starts, as stored in the trees, are multiples of the period after the first one. The missing
    // multiples in between must have been counted as skipped starts.
    let start = |it: &Iteration| it.tree.anchors()[0].wall;
    let mut skipped_in_all = 0.0;
    for pair in iterations.windows(2) {
        let periods = ((start(pair[1]) - start(pair[0])).seconds() * 100.0).round();
        let skipped = value(&pair[1].tree, "skipped-starts").unwrap_or(0.0);
        assert_eq!(periods, 1.0 + skipped, "between {} and {}", pair[0].number, pair[1].number);
        skipped_in_all += skipped;
    }
    assert!(skipped_in_all >= 20.0, "{skipped_in_all}");
    // Latency counts from the intended start: the lateness of an iteration is added to the model's 40 ms.
    for iteration in &iterations {
        let (total, lateness) = (value(&iteration.tree, "total"), value(&iteration.tree, "lateness"));
        assert!(
            total >= lateness.map(|late| late + 0.04),
            "the total includes the lateness: {total:?}, {lateness:?}"
        );
    }
    assert!(iterations.iter().any(|iteration| value(&iteration.tree, "lateness") > Some(0.0)));
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn full_queue_fails_samples_with_reason() {
    let aggregator = Aggregator::start().await;
    let pipeline = "load = { mode = 'rate', hz = 200.0 }\nmax_in_flight = 8\nlimit = { iterations = 30 }";
    let tables = slow_pipeline(50, "workers = 1\nqueue = 1", pipeline);
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let iterations = received_events.iterations();
    assert_eq!(iterations.len(), 30);
    let failed_by_full_queue = iterations.iter().filter(
        |it| matches!(&it.outcome, Outcome::Failed(reason) if reason.contains("queue of model slow is full")),
    );
    assert!(failed_by_full_queue.count() > 0);
    assert!(iterations.iter().any(|iteration| iteration.outcome == Outcome::Ok));
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn late_answer_is_timeout_and_run_continues() {
    let aggregator = Aggregator::start().await;
    let pipeline = "timeout_ms = 20\nlimit = { iterations = 3 }";
    let agent = TestAgent::start("edge", Some(&aggregator.address), &slow_pipeline(200, "", pipeline)).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.iterations().len(), 3);
    for iteration in received_events.iterations() {
        let Outcome::Timeout(reason) = &iteration.outcome else { panic!("{:?}", iteration.outcome) };
        assert!(
            reason.contains("model slow") && reason.contains("within 20") && reason.contains("timeout_ms"),
            "{reason}"
        );
        assert!(iteration.tree.find(&["sensing"]).is_some(), "the stage before the timeout is recorded");
        assert!(value(&iteration.tree, "total") >= Some(0.02));
    }
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn equal_seeds_give_equal_poisson_starts() {
    let mut intervals = Vec::new();
    for _ in 0..2 {
        let aggregator = Aggregator::start().await;
        let pipeline = "load = { mode = 'poisson', hz = 50.0, seed = 5 }\nmax_in_flight = 64\n\
                        limit = { iterations = 60 }";
        let tables = slow_pipeline(0, "workers = 1\nqueue = 64", pipeline);
        let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
        let received_events =
            aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
        let mut starts: Vec<_> =
            received_events.iterations().iter().map(|it| it.tree.anchors()[0].wall).collect();
        starts.sort();
        let tens_of_micros = |pair: &[peernet_clock::WallTime]| ((pair[1] - pair[0]).seconds() * 1e5).round();
        intervals.push(starts.windows(2).map(tens_of_micros).collect::<Vec<_>>());
        agent.stop().await.expect("stops well");
    }
    // Starts that come due while a pipeline is set up are skipped, so one of the runs may begin later in the schedule.
    // At least 12 intervals are compared.
    let are_alike = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 5.0);
    let is_continuation =
        |a: &[f64], b: &[f64]| (0..=a.len() - 12).any(|skipped| are_alike(&a[skipped..], b));
    assert!(
        is_continuation(&intervals[0], &intervals[1]) || is_continuation(&intervals[1], &intervals[0]),
        "{intervals:?}"
    );
}
