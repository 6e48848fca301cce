//! Stopping: what has begun is finished and handed over.

use std::sync::Arc;
use std::time::Duration;

use peernet_logger::stream::Outcome;

use crate::harness::{Aggregator, Manners, TestAgent, assert_contiguous};

const SLOW: &str = "[[model]]\nname = 'slow'\nkind = 'sleep'\ninference_ms = 100\nworkers = 4\n\
    [[pipeline]]\nname = 'line'\nsensor = { kind = 'synthetic', size_bytes = 1 }\nwarm_up = { iterations = 0 }\n\
    placement = { kind = 'local', model = 'slow' }\nload = { mode = 'rate', hz = 40.0 }\n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_under_way_is_finished_and_handed_over() {
    let aggregator = Aggregator::start().await;
    let agent = TestAgent::start("edge", Some(&aggregator.address), SLOW).await;
    aggregator.until(|seen| seen.iterations().len() >= 4).await;
    let host = agent.running.live().host;
    agent.stop().await.expect("stops well");
    let seen = aggregator.until(|seen| !seen.goodbyes.is_empty()).await;
    assert_eq!(seen.goodbyes, [host]);
    assert_eq!(seen.ended()[0].reason, "stopped");
    assert_contiguous(&seen.iterations());
    assert!(seen.iterations().iter().all(|iteration| iteration.outcome == Outcome::Ok));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_takes_too_long_is_recorded_as_lost() {
    let aggregator = Aggregator::start().await;
    let tables = format!(
        "[agent]\nstop_timeout_ms = 400\n{}",
        SLOW.replace("inference_ms = 100", "inference_ms = 1500")
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    aggregator.until(|seen| !seen.runs().is_empty()).await;
    agent.stop().await.expect("stops well");
    let seen = aggregator.until(|seen| !seen.goodbyes.is_empty()).await;
    let lost = |outcome: &Outcome| matches!(outcome, Outcome::Lost(reason) if reason.contains("stopped"));
    assert!(seen.iterations().iter().any(|iteration| lost(&iteration.outcome)), "{:?}", seen.iterations());
    assert_contiguous(&seen.iterations());
    assert_eq!(seen.ended().len(), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_model_that_computes_for_long_is_not_waited_for() {
    let aggregator = Aggregator::start().await;
    let tables = format!(
        "[agent]\nstop_timeout_ms = 400\n{}",
        SLOW.replace("inference_ms = 100", "inference_ms = 86400000")
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    aggregator.until(|seen| !seen.runs().is_empty()).await;
    agent.stop().await.expect("stops well");
    let seen = aggregator.until(|seen| !seen.goodbyes.is_empty()).await;
    assert_eq!(seen.ended().len(), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_left_is_handed_over_as_long_as_it_is_taken_and_the_end_of_the_run_always() {
    // Half of the time to stop is too short for the rest, and all of it too.
    let manners = Manners { slow: Some(Duration::from_millis(40)), ..Manners::default() };
    let aggregator = Aggregator::start_at("tcp://127.0.0.1:0", Arc::default(), manners).await;
    let tables = "[agent]\nstop_timeout_ms = 2000\nbatch_nodes = 50\nbatch_delay_ms = 10\n\
        [[model]]\nname = 'echo'\nkind = 'echo'\n\
        [[pipeline]]\nname = 'line'\nsensor = { kind = 'synthetic', size_bytes = 1 }\n\
        placement = { kind = 'local', model = 'echo' }\nload = { mode = 'rate', hz = 1000.0 }";
    let agent = TestAgent::start("edge", Some(&aggregator.address), tables).await;
    agent.until(|live| live.accounting.waiting > 1000).await;
    let stored = agent.running.live().accounting.stored;
    agent.stop().await.expect("stops well");
    let seen = aggregator.until(|seen| !seen.ended().is_empty()).await;
    assert_eq!(seen.ended()[0].reason, "stopped");
    assert!(seen.events.len() as u64 > stored + 20, "{stored}, then {}", seen.events.len());
    assert!(seen.runs().iter().all(|run| run.run == seen.ended()[0].run));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_an_aggregator_the_agent_measures_and_stops_all_the_same() {
    let agent = TestAgent::start("edge", None, SLOW).await;
    agent.until_state(|state| *state == peernet_logger::stream::PipelineState::Running).await;
    agent.stop().await.expect("stops well");
}
