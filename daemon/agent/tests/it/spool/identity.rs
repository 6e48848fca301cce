//! Tests of spools that are missing, are damaged, or belong to another host.

use peernet_agent::StartError;
use peernet_stream::IncidentKind;

use super::{idle_config, pipeline, state};
use crate::harness::{Aggregator, TestAgent, clock};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn deleted_spool_begins_new_stream() {
    let aggregator = Aggregator::start().await;
    let agent =
        TestAgent::start_in(state(), &aggregator.address, pipeline("limit = { iterations = 20 }")).await;
    aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let file = agent.spool();
    let state = agent.stop_and_keep().await.expect("stops well");
    std::fs::remove_file(file).expect("removed");
    let agent =
        TestAgent::start_in(state, &aggregator.address, pipeline("limit = { iterations = 20 }")).await;
    let received_events = aggregator.until(|received_events| received_events.run_ends().len() == 2).await;
    assert_eq!(received_events.iterations().len(), 40);
    assert_ne!(received_events.streams.first(), received_events.streams.last());
    assert_eq!(
        received_events.replaced_streams,
        received_events.streams[..1],
        "the aggregator sees that the stream was replaced"
    );
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn damaged_spool_is_quarantined_and_measuring_starts() {
    let (aggregator, state) = (Aggregator::start().await, state());
    let file = state.path().join("spool.sqlite");
    std::fs::write(&file, b"not a database".repeat(100)).expect("written");
    let agent =
        TestAgent::start_in(state, &aggregator.address, pipeline("limit = { iterations = 20 }")).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.iterations().len(), 20);
    let reported = received_events.incidents(IncidentKind::Gap);
    assert_eq!(reported.len(), 1, "{reported:?}");
    let (_, quarantined) = reported[0].text.split_once("moved to ").expect("the text names the new path");
    let (quarantined, _) = quarantined.split_once(',').expect("a comma follows the path");
    assert!(
        std::fs::read(quarantined).expect("the file is in quarantine").starts_with(b"not a database"),
        "{quarantined}"
    );
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_agents_cannot_use_one_spool() {
    let (aggregator, shared) = (Aggregator::start().await, tempfile::tempdir().expect("a folder"));
    let mut config = idle_config();
    config.spool.file = Some(shared.path().join("deep").join("spool.sqlite"));
    let first = TestAgent::start_in(state(), &aggregator.address, config.clone()).await;
    let start =
        |config| TestAgent::try_start(clock("system"), "other", Some(&aggregator.address), config, state());
    let refused = start(config.clone()).await.err().expect("the first agent has locked the spool");
    assert!(matches!(&refused, StartError::Spool(_)), "{refused}");
    assert!(refused.to_string().contains("another agent uses the spool"), "{refused}");
    first.stop().await.expect("stops well");
    // The spool contains the events of another host.
    let refused = start(config).await.err().expect("the spool belongs to another host").to_string();
    assert!(refused.contains("has events of the host"), "{refused}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn agent_without_aggregator_has_no_spool() {
    let agent = TestAgent::start("edge", None, "").await;
    assert!(!agent.spool().exists());
    agent.stop().await.expect("stops well");
}
