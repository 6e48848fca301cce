//! Tests of the outbox: no event is lost without being counted, and no event is stored twice.

use std::sync::Arc;

use peernet_stream::IncidentKind;

use crate::harness::{Aggregator, AggregatorBehaviour, TestAgent, assert_contiguous};

/// Returns a pipeline with the default warm-up, whose five iterations a limit of iterations does not count.
fn pipeline(keys: &str) -> String {
    format!(
        "[agent]\nbatch_delay_ms = 20\n[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 100 }}\n\
         placement = {{ kind = 'local', model = 'echo' }}\n{keys}"
    )
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_event_arrives_exactly_once_over_reconnects() {
    // The aggregator ends after storing the third batch and before acknowledging it. The agent must send this batch
    // again, and the aggregator must not store it twice.
    let behaviour = AggregatorBehaviour { end_before_ack: Some(3), ..AggregatorBehaviour::default() };
    let aggregator = Aggregator::start_at("tcp://127.0.0.1:0", Arc::default(), behaviour).await;
    let keys = "load = { mode = 'rate', hz = 200.0 }\nmax_in_flight = 64\nlimit = { iterations = 300 }";
    let agent = TestAgent::start("edge", Some(&aggregator.address), &pipeline(keys)).await;
    aggregator.until(|received_events| !received_events.iterations().is_empty()).await;
    let aggregator = Aggregator::restart(aggregator.wait_for_end().await).await;
    let received_events = aggregator.until(|received_events| received_events.iterations().len() >= 150).await;
    assert_eq!((received_events.hellos, received_events.run_starts().len()), (2, 1));
    let aggregator = Aggregator::restart(aggregator.stop().await).await;

    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_contiguous(&received_events.iterations());
    assert_eq!(received_events.iterations().len(), 305);
    assert!(received_events.gaps().is_empty());
    assert!(received_events.hellos >= 3);
    assert_eq!(agent.running.live_update().accounting.dropped, 0);
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn refusal_of_aggregator_is_retried_and_reported_once() {
    let behaviour = AggregatorBehaviour {
        refusal: Some("another host is named edge".into()),
        ..AggregatorBehaviour::default()
    };
    let aggregator = Aggregator::start_at("tcp://127.0.0.1:0", Arc::default(), behaviour).await;
    let agent =
        TestAgent::start("edge", Some(&aggregator.address), &pipeline("limit = { iterations = 5 }")).await;
    aggregator.until(|received_events| received_events.hellos >= 2).await;
    let aggregator = Aggregator::restart(aggregator.stop().await).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.iterations().len(), 10, "measured while the aggregator refused the agent");
    let refused = received_events.incidents(IncidentKind::Refused);
    assert_eq!(refused.len(), 1, "{refused:?}");
    assert!(refused[0].text.contains("another host is named edge"), "{}", refused[0].text);
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn run_starts_are_repeated_to_emptied_aggregator() {
    let aggregator = Aggregator::start().await;
    let keys = "load = { mode = 'rate', hz = 100.0 }";
    let agent = TestAgent::start("edge", Some(&aggregator.address), &pipeline(keys)).await;
    agent.until(|live| live.accounting.stored >= 20).await;
    let (address, _) = aggregator.stop().await;
    let emptied_aggregator = Aggregator::restart((address, Arc::default())).await;
    let received_events = emptied_aggregator
        .until(|received_events| {
            !received_events.iterations().is_empty() && !received_events.run_starts().is_empty()
        })
        .await;
    assert_eq!(received_events.run_starts()[0].pipeline.as_str(), "line");
    assert_eq!(received_events.run_starts()[0].run, received_events.iterations()[0].run);
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn silent_listener_is_reported_once_and_retried() {
    let behaviour = AggregatorBehaviour { is_silent: true, ..AggregatorBehaviour::default() };
    let silent_aggregator = Aggregator::start_at("tcp://127.0.0.1:0", Arc::default(), behaviour).await;
    let agent =
        TestAgent::start("edge", Some(&silent_aggregator.address), &pipeline("limit = { iterations = 5 }"))
            .await;
    // 13 events are the loaded model, start and end of the run, and ten iterations. One more event is the report of the
    // silent listener.
    agent.until(|live| live.accounting.waiting > 13).await;
    let aggregator = Aggregator::restart(silent_aggregator.stop().await).await;
    let received_events = aggregator
        .until(|received_events| !received_events.incidents(IncidentKind::Connected).is_empty())
        .await;
    let reported = received_events.incidents(IncidentKind::Disconnected);
    assert_eq!(reported.len(), 1, "{reported:?}");
    assert!(reported[0].text.contains("no aggregator answers there"), "{}", reported[0].text);
    assert_eq!(received_events.iterations().len(), 10);
    agent.stop().await.expect("stops well");
}
