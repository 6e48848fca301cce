//! Tests of a spool that cannot be written while the agent runs.

use std::num::NonZeroUsize;

use peernet_stream::{IncidentKind, PipelineState};

use super::{address_without_aggregator, idle_config, pipeline, state};
use crate::harness::{Aggregator, TestAgent, assert_contiguous};

const RATE: &str = "load = { mode = 'rate', hz = 500.0 }\nmax_in_flight = 64";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn events_are_sent_from_memory_while_file_is_missing() {
    let aggregator = Aggregator::start().await;
    let agent = TestAgent::start_in(state(), &aggregator.address, pipeline(RATE)).await;
    aggregator.until(|received_events| received_events.iterations().len() >= 50).await;
    let (file, moved_file) = (agent.spool(), agent.spool().with_extension("away"));
    std::fs::rename(&file, &moved_file).expect("moved");
    let trouble = agent.until(|live| live.accounting.trouble.is_some()).await.accounting.trouble;
    assert!(trouble.as_ref().is_some_and(|text| text.contains("moved")), "{trouble:?}");
    let received_events =
        aggregator.until(|received_events| !received_events.incidents(IncidentKind::Gap).is_empty()).await;
    let reported = &received_events.incidents(IncidentKind::Gap)[0].text;
    assert!(reported.contains("spool.sqlite") && reported.contains("measuring continues"), "{reported}");
    let before = received_events.iterations().len();
    aggregator.until(|received_events| received_events.iterations().len() >= before + 100).await;

    std::fs::rename(&moved_file, &file).expect("moved back");
    agent.until(|live| live.accounting.trouble.is_none()).await;
    // The condition is true at once, so this is the current number.
    let before = aggregator.until(|_| true).await.iterations().len();
    aggregator.until(|received_events| received_events.iterations().len() >= before + 50).await;
    let state = agent.stop_and_keep().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_contiguous(&received_events.iterations());
    assert_eq!(
        (received_events.gaps().len(), received_events.incidents(IncidentKind::Gap).len()),
        (0, 2),
        "one incident reports the failure, the other the recovery"
    );

    // The file is consistent with the batches that were sent from memory.
    let agent =
        TestAgent::start_in(state, &aggregator.address, pipeline("limit = { iterations = 20 }")).await;
    let received_events = aggregator.until(|received_events| received_events.run_ends().len() == 2).await;
    assert!(received_events.missing_batches.is_empty() && received_events.replaced_streams.is_empty());
    assert!(received_events.streams.iter().all(|stream| *stream == received_events.streams[0]));
    let account = agent.until(|live| live.accounting.waiting == 0).await.accounting;
    assert_eq!((account.dropped, account.produced), (0, account.stored));
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn events_beyond_memory_are_counted_without_file_and_aggregator() {
    let (address, received_events) = address_without_aggregator().await;
    let mut config =
        pipeline("limit = { iterations = 5000 }\nload = { mode = 'rate', hz = 5000.0 }\nmax_in_flight = 64");
    config.agent.queue_events = NonZeroUsize::new(500).expect("not zero");
    let agent = TestAgent::start_in(state(), &address, config).await;
    let (file, moved_file) = (agent.spool(), agent.spool().with_extension("away"));
    std::fs::rename(&file, &moved_file).expect("moved");
    agent.until(|live| live.accounting.trouble.is_some() && live.accounting.dropped > 500).await;
    std::fs::rename(&moved_file, &file).expect("moved back");
    agent.until_state(|state| *state == PipelineState::Finished).await;
    let aggregator = Aggregator::restart((address, received_events)).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let account = agent.until(|live| live.accounting.waiting == 0).await.accounting;
    assert_eq!((account.produced, account.trouble), (account.stored + account.dropped, None));
    drop(received_events);
    let received_events =
        aggregator.until(|received_events| received_events.events.len() as u64 == account.stored).await;
    let missing: u64 = received_events.gaps().iter().map(|gap| gap.count).sum();
    assert_eq!(missing, account.dropped);
    // Each of the 5000 iterations is stored or missing. Other events may be missing, too.
    let stored_iterations = received_events.iterations().len() as u64;
    assert!(stored_iterations < 5000 && stored_iterations + missing >= 5000, "{stored_iterations} {missing}");
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stop_without_file_and_aggregator_ends_at_deadline() {
    let (address, received_events) = address_without_aggregator().await;
    let mut config = pipeline(RATE);
    config.agent.stop_timeout_ms = 600;
    let agent = TestAgent::start_in(state(), &address, config).await;
    agent.until(|live| live.accounting.spooled >= 100).await;
    let (file, moved_file) = (agent.spool(), agent.spool().with_extension("away"));
    std::fs::rename(&file, &moved_file).expect("moved");
    let spooled = agent.until(|live| live.accounting.trouble.is_some()).await.accounting.spooled;
    let state = agent.stop_and_keep().await.expect("stops well");
    std::fs::rename(&moved_file, &file).expect("moved back");

    let aggregator = Aggregator::restart((address, received_events)).await;
    let agent = TestAgent::start_in(state, &aggregator.address, idle_config()).await;
    let account = agent.until(|live| live.accounting.waiting == 0).await.accounting;
    let received_events =
        aggregator.until(|received_events| received_events.events.len() as u64 == account.stored).await;
    assert!(account.stored >= spooled, "{account:?}");
    assert_contiguous(&received_events.iterations());
    assert!(received_events.run_ends().is_empty(), "the end of the run was in memory only");
    agent.stop().await.expect("stops well");
}
