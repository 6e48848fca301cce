//! Tests of agents that end, and of the next agents, which deliver the events that are still in the spool.

use std::time::Duration;

use peernet_stream::{EndReason, Event, IncidentKind, PipelineState};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

use super::{address_without_aggregator, idle_config, pipeline, spooled_events, state};
use crate::harness::{Aggregator, AggregatorBehaviour, TestAgent, assert_contiguous};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn spool_of_killed_agent_is_delivered_exactly_once() {
    let (address, received_events) = address_without_aggregator().await;
    let keys = "load = { mode = 'rate', hz = 500.0 }\nmax_in_flight = 64";
    // The first agent creates the id of the host, which all further agents must keep.
    let agent = TestAgent::start("edge", Some(&address), "").await;
    let host = agent.running.live_update().host;
    let state = agent.stop_and_keep().await.expect("stops well");

    let agent = TestAgent::start_in(state, &address, pipeline(keys)).await;
    let account = agent.until(|live| live.accounting.spooled >= 200).await.accounting;
    let file = agent.spool();
    let state = agent.crash().await;
    let left_events = spooled_events(&file).await;
    assert!(left_events.len() as u64 >= account.spooled, "{} < {}", left_events.len(), account.spooled);

    // The next agent crashes while it delivers the events.
    let agent = TestAgent::start_in(state, &address, idle_config()).await;
    let restarted = agent.running.live_update().accounting;
    assert_eq!(
        (restarted.spooled, restarted.waiting >= left_events.len() as u64),
        (left_events.len() as u64, true),
        "{restarted:?}"
    );
    let aggregator = Aggregator::restart((address, received_events)).await;
    aggregator.until(|received_events| !received_events.iterations().is_empty()).await;
    let state = agent.crash().await;
    let agent = TestAgent::start_in(state, &aggregator.address, idle_config()).await;
    let received_events =
        aggregator.until(|received_events| received_events.events.len() >= left_events.len()).await;
    assert_eq!(received_events.events[..left_events.len()], left_events);
    assert_contiguous(&received_events.iterations());
    let account = agent.until(|live| live.accounting.waiting == 0).await.accounting;
    // Events that had not reached the spool are counted as lost.
    assert_eq!(account.produced, account.stored + account.dropped);

    assert!(
        received_events.streams.iter().all(|stream| *stream == received_events.streams[0]),
        "all hellos name one stream: {:?}",
        received_events.streams
    );
    assert!(received_events.missing_batches.is_empty() && received_events.replaced_streams.is_empty());
    assert_eq!(agent.running.live_update().host, host);
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stop_without_aggregator_keeps_events_in_spool() {
    let (address, received_events) = address_without_aggregator().await;
    let keys = "load = { mode = 'rate', hz = 500.0 }\nmax_in_flight = 64";
    let mut config = pipeline(keys);
    config.agent.stop_timeout_ms = 60_000;
    let agent = TestAgent::start_in(state(), &address, config).await;
    agent.until_state(|state| *state == PipelineState::Running).await;
    agent.until(|live| live.accounting.produced >= 100).await;
    let file = agent.spool();
    // The agent stops at once, because no aggregator is there to wait for.
    let stopping = tokio::time::timeout(Duration::from_secs(20), agent.stop_and_keep()).await;
    let state = stopping.expect("does not wait for the aggregator").expect("stops well");
    let left_events = spooled_events(&file).await;
    assert!(
        left_events
            .iter()
            .any(|event| matches!(event, Event::RunEnded(ended) if ended.reason == EndReason::Stopped))
    );

    let aggregator = Aggregator::restart((address, received_events)).await;
    let agent = TestAgent::start_in(state, &aggregator.address, idle_config()).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.events[..left_events.len()], left_events);
    assert_contiguous(&received_events.iterations());
    let account = agent.until(|live| live.accounting.waiting == 0).await.accounting;
    assert_eq!((account.dropped, account.produced), (0, account.stored));
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn undelivered_events_are_sent_after_next_start() {
    let behaviour =
        AggregatorBehaviour { batch_delay: Some(Duration::from_millis(40)), ..Default::default() };
    let aggregator = Aggregator::start_at("tcp://127.0.0.1:0", Default::default(), behaviour).await;
    let mut config = pipeline("load = { mode = 'rate', hz = 1000.0 }\nmax_in_flight = 64");
    config.agent.stop_timeout_ms = 1000;
    config.agent.batch_nodes = std::num::NonZeroUsize::new(50).expect("not zero");
    // Batches are small, so few events are in flight. Otherwise the aggregator would store all events before it
    // receives the goodbye.
    config.agent.batch_bytes = std::num::NonZeroUsize::new(4096).expect("not zero");
    config.agent.batch_delay_ms = 10;
    let agent = TestAgent::start_in(state(), &aggregator.address, config).await;
    agent.until(|live| live.accounting.waiting > 1000).await;
    let before = agent.running.live_update().accounting.stored;
    let state = agent.stop_and_keep().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
    assert!(received_events.events.len() as u64 > before, "some events were sent while the agent stopped");
    assert!(received_events.run_ends().is_empty(), "not all events were sent");

    let aggregator = Aggregator::restart(aggregator.stop().await).await;
    let agent = TestAgent::start_in(state, &aggregator.address, idle_config()).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_contiguous(&received_events.iterations());
    assert_eq!((received_events.run_ends()[0].reason.as_str(), received_events.gaps().len()), ("stopped", 0));
    agent.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn intact_batches_of_damaged_spool_are_stored_once() {
    let (address, received_events) = address_without_aggregator().await;
    let mut config = pipeline("load = { mode = 'rate', hz = 500.0 }\nmax_in_flight = 64");
    config.agent.batch_nodes = std::num::NonZeroUsize::new(50).expect("not zero");
    let agent = TestAgent::start_in(state(), &address, config).await;
    agent.until(|live| live.accounting.produced >= 200).await;
    let file = agent.spool();
    let state = agent.stop_and_keep().await.expect("stops well");
    // The test damages a batch in the middle, as a worn memory card does. The file `spool.sqlite-condemned` says that
    // the agent has noticed the damage.
    let mut connection = SqliteConnectOptions::new().filename(&file).connect().await.expect("opens");
    let (batches, damaged): (i64, i64) = sqlx::query_as("SELECT COUNT(*), COUNT(*) / 2 FROM batch")
        .fetch_one(&mut connection)
        .await
        .expect("reads");
    sqlx::query("UPDATE batch SET body = zeroblob(length(body)) WHERE number = ?")
        .bind(damaged)
        .execute(&mut connection)
        .await
        .expect("changed");
    let intact: i64 = sqlx::query_scalar("SELECT SUM(events) FROM batch WHERE number < ?")
        .bind(damaged)
        .fetch_one(&mut connection)
        .await
        .expect("reads");
    connection.close().await.expect("closes");
    std::fs::write(state.path().join("spool.sqlite-condemned"), "a page was broken").expect("written");

    let aggregator = Aggregator::restart((address, received_events)).await;
    let agent = TestAgent::start_in(state, &aggregator.address, idle_config()).await;
    let received_events =
        aggregator.until(|received_events| !received_events.incidents(IncidentKind::Gap).is_empty()).await;
    let text = &received_events.incidents(IncidentKind::Gap)[0].text;
    let expected = [
        format!("a new spool has the {} batches before the damage, with {intact} events", damaged - 1),
        format!("{} batches from the damage on, with at least ", batches - damaged + 1),
    ];
    assert!(expected.iter().all(|words| text.contains(words)), "{expected:?}: {text}");
    let account = agent.until(|live| live.accounting.waiting == 0).await.accounting;
    assert_eq!(account.produced, account.stored + account.dropped, "{account:?}");
    let state = agent.stop_and_keep().await.expect("stops well");
    // A further start sends nothing again.
    let agent = TestAgent::start_in(state, &aggregator.address, idle_config()).await;
    let received_events = aggregator.until(|received_events| received_events.hellos >= 2).await;
    agent.until(|live| live.accounting.waiting == 0).await;
    agent.stop().await.expect("stops well");
    let iterations = received_events.iterations();
    assert_contiguous(&iterations);
    assert!(
        !iterations.is_empty() && received_events.repeated_batches == 0,
        "{} batches were sent twice",
        received_events.repeated_batches
    );
    assert!(received_events.streams.windows(2).all(|pair| pair[0] == pair[1]), "all hellos name one stream");
}
