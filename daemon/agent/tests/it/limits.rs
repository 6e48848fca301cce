//! Tests of closed loops on one host: numbers, warm-up, limits, episodes, the tree.

use peernet_analysis::rows::FIXED_COLUMNS;
use peernet_external::exec::{ReplyAssembler, Role};
use peernet_stream::{EndReason, Outcome, PipelineState, PlacementKind};

use crate::harness::{Aggregator, TestAgent, assert_adds_up, assert_contiguous, value};

fn pipeline(keys: &str) -> String {
    format!(
        "[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 100 }}\n\
         placement = {{ kind = 'local', model = 'echo' }}\n{keys}"
    )
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn warm_up_and_limit_are_exact() {
    let aggregator = Aggregator::start().await;
    let keys = "warm_up = { iterations = 3 }\nlimit = { iterations = 20 }";
    let agent = TestAgent::start("edge", Some(&aggregator.address), &pipeline(keys)).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;

    let iterations = received_events.iterations();
    assert_eq!(iterations.len(), 23);
    assert!(iterations.iter().map(|iteration| iteration.number).eq(1..=23), "in order, one at a time");
    assert!(iterations.iter().all(|iteration| iteration.warm_up == (iteration.number <= 3)));
    assert!(iterations.iter().all(|iteration| iteration.outcome == Outcome::Ok));
    for iteration in &iterations {
        assert_adds_up(iteration);
        assert!(iteration.tree.find(&["sensing", "capture"]).is_some());
        assert!(iteration.tree.find(&["sensing", "transform"]).is_none(), "no transform is configured");
        assert!(value(&iteration.tree, "inference").is_some());
    }
    let (runs, ended) = (received_events.run_starts(), received_events.run_ends());
    assert_eq!((runs.len(), ended.len()), (1, 1));
    assert_eq!((ended[0].run, ended[0].reason.as_str()), (runs[0].run, "finished"));
    assert!(iterations.iter().all(|iteration| iteration.run == runs[0].run));
    assert_eq!(runs[0].placement.model.as_str(), "echo");
    assert!(runs[0].configuration.contains("size_bytes = 100"), "{}", runs[0].configuration);
    assert_eq!(agent.pipeline().state, PipelineState::Finished);
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn environment_of_program_is_set_and_recorded_without_values() {
    let aggregator = Aggregator::start().await;
    let tables = "[[pipeline]]\nname = 'line'\nplacement = { kind = 'none' }\nlimit = { total = 2 }\n\
        sensor = { kind = 'exec', env = { API_KEY = 'hunter2' }, \
        command = '[ \"$API_KEY\" = hunter2 ] || exit 1; while read x; do echo answer 1 text/plain; printf a; done' }\n\
        actuator = { kind = 'exec', command = 'cat', env = { API_KEY = 'hunter3' } }";
    let agent = TestAgent::start("edge", Some(&aggregator.address), tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.iterations().len(), 2);
    assert!(received_events.iterations().iter().all(|iteration| iteration.outcome == Outcome::Ok));
    let first_configuration = received_events.run_starts()[0].configuration.clone();
    assert_eq!(first_configuration.matches("API_KEY = \"(not told)\"").count(), 2, "{first_configuration}");
    // The sensor's command itself contains `hunter2`.
    assert!(!first_configuration.replace("= hunter2 ]", "").contains("hunter"), "{first_configuration}");
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn live_statistics_are_bounded_and_exclude_warm_up() {
    let aggregator = Aggregator::start().await;
    let keys = "warm_up = { iterations = 7 }\nlimit = { iterations = 500 }";
    let agent = TestAgent::start("edge", Some(&aggregator.address), &pipeline(keys)).await;
    // A later update of a second replaces the earlier update.
    let latest_seconds = |lives: &[peernet_stream::LiveUpdate]| {
        let mut seconds = std::collections::BTreeMap::new();
        for second in lives.iter().flat_map(|live| &live.pipelines).flat_map(|pipeline| &pipeline.seconds) {
            seconds.insert(second.at, second.clone());
        }
        seconds.into_values().collect::<Vec<_>>()
    };
    let received_events = aggregator
        .until(|received_events| {
            latest_seconds(&received_events.live_updates)
                .iter()
                .map(|second| second.counts.total())
                .sum::<u64>()
                == 500
        })
        .await;
    for second in latest_seconds(&received_events.live_updates) {
        let (_, latency) = second.values.iter().find(|(name, _)| *name == "total").expect("totals");
        assert_eq!(latency.count(), second.counts.ok);
        assert!(second.values.len() <= 64);
    }
    for live in &received_events.live_updates {
        assert_eq!(live.pipelines.len(), 1);
        assert!(live.pipelines[0].seconds.len() <= 8);
        assert!(live.pipelines[0].seconds.is_sorted_by(|a, b| a.at > b.at), "newest first");
        let account = &live.accounting;
        assert_eq!(account.produced, account.stored + account.waiting + account.dropped);
    }
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn episodes_are_numbered_and_a_duration_ends_the_run() {
    let aggregator = Aggregator::start().await;
    let keys = "episode_steps = 4\nwarm_up = { iterations = 0, steps = 1 }\n\
                load = { mode = 'rate', hz = 200.0 }\nlimit = { duration_s = 0.25 }";
    let agent = TestAgent::start("edge", Some(&aggregator.address), &pipeline(keys)).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let iterations = received_events.iterations();
    assert_contiguous(&iterations);
    for iteration in &iterations {
        let index = iteration.number - 1;
        assert_eq!((u64::from(iteration.episode), u64::from(iteration.step)), (index / 4, index % 4));
        assert_eq!(iteration.warm_up, iteration.step == 0);
        assert_adds_up(iteration);
        assert!(
            iteration.tree.find(&["send-queue"]).is_some() && iteration.tree.find(&["lateness"]).is_some()
        );
    }
    // Every intended start is within the duration, counted from the first start that is not warm-up.
    let start = |index: usize| iterations[index].tree.anchors()[0].wall;
    let first =
        (0..iterations.len()).filter(|index| !iterations[*index].warm_up).map(start).min().expect("measured");
    let last = (0..iterations.len()).map(start).max().expect("measured");
    assert!((last - first).seconds() < 0.2505, "{}", last - first);
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ended_sensor_finishes_pipeline() {
    let aggregator = Aggregator::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["a.png", "b.png", "c.png"] {
        image::RgbImage::new(8, 6).save(folder.path().join(name)).expect("written");
    }
    let tables = format!(
        "[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nplacement = {{ kind = 'local', model = 'echo' }}\n\
         sensor = {{ kind = 'images', path = '{}', repeat = false }}\n\
         transforms = [{{ kind = 'resize', width = 4, height = 3 }}]",
        folder.path().display()
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.iterations().len(), 3);
    for iteration in received_events.iterations() {
        assert_eq!(iteration.outcome, Outcome::Ok);
        assert!(iteration.tree.find(&["sensing", "transform"]).is_some());
    }
    assert_eq!(received_events.run_ends()[0].reason, EndReason::Finished);
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pipeline_that_only_senses_runs_until_total() {
    let aggregator = Aggregator::start().await;
    let tables = "[[pipeline]]\nname = 'line'\nsensor = { kind = 'text', length = 100 }\n\
                  placement = { kind = 'none' }\nwarm_up = { iterations = 3 }\nlimit = { total = 20 }";
    let agent = TestAgent::start("edge", Some(&aggregator.address), tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let iterations = received_events.iterations();
    assert_eq!(iterations.len(), 20, "the total includes the warm-up");
    assert_eq!(iterations.iter().filter(|iteration| iteration.warm_up).count(), 3);
    for iteration in &iterations {
        assert_eq!(iteration.outcome, Outcome::Ok);
        assert_adds_up(iteration);
        assert!(iteration.tree.find(&["sensing", "capture"]).is_some());
        for absent in ["queue", "inference", "upload", "actuation", "top-1"] {
            assert!(iteration.tree.find(&[absent]).is_none(), "{absent}");
        }
    }
    let placement = &received_events.run_starts()[0].placement;
    assert_eq!((placement.kind, placement.model.as_str()), (PlacementKind::None, "none"));
    assert_eq!((&placement.peer, &placement.device), (&None, &None));
    assert_eq!(agent.pipeline().placement, *placement);
    assert_eq!(received_events.run_ends()[0].reason, EndReason::Finished);
    agent.stop().await.expect("stops well");
}

#[test]
fn program_cannot_report_columns_of_results() {
    for (name, _) in FIXED_COLUMNS {
        let line = format!("value {name} 1");
        let refusal = ReplyAssembler::new(Role::Model).push_line(line.as_bytes()).expect_err(name);
        assert!(refusal.to_string().contains("a reserved name"), "{refusal}");
    }
}
