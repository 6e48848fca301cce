//! Agents that are refused, crash, repeat themselves or send nonsense.

use peernet_logger::stream::codec::encode;
use peernet_logger::stream::{Batch, Hello, Notice, PROTOCOL, StreamId, ToAgent, ToAggregator};
use peernet_logger::{HostId, RunId};

use crate::agent::{Agent, Wire};
use crate::bed::Bed;
use crate::generate;

fn hello(host: HostId, name: &str, stream: StreamId) -> ToAggregator {
    let host = generate::host(host, name);
    ToAggregator::Hello(Hello { protocol: PROTOCOL, host, stream, oldest: 1, process: 1 })
}

fn batch(host: HostId, stream: StreamId, number: u64, run: RunId) -> ToAggregator {
    let mut random = generate::Numbers(number);
    let iteration = generate::iteration(run, number, (host, HostId::from_bytes([7; 16])), &mut random);
    let events = vec![peernet_logger::stream::Event::Iteration(iteration)];
    ToAggregator::Batch(Batch { host, stream, number, events })
}

#[tokio::test]
async fn a_second_host_of_one_name_is_refused_and_shown() {
    let mut bed = Bed::new().await;
    let mut first = bed.agent("edge").await;
    first.until_up().await;
    let mut second = bed.agent("edge").await;
    second.until("it is refused", |agent| !agent.notices.is_empty()).await;
    let Notice::Refused(reason) = &second.notices[0] else { panic!("refused: {:?}", second.notices) };
    assert!(
        reason.contains("the name edge is taken by the host with the id") && reason.contains("another name")
    );
    let picture = bed.picture("the refusal", |picture| !picture.refused.is_empty()).await;
    assert_eq!(
        (picture.hosts.len(), picture.refused[0].name.as_str(), &picture.refused[0].reason),
        (1, "edge", reason)
    );
    assert!(picture.refused[0].address.as_deref().is_some_and(|address| address.starts_with("127.0.0.1:")));
    bed.stop().await;
}

#[tokio::test]
async fn a_crashed_agent_comes_back_under_its_own_id() {
    let mut bed = Bed::new().await;
    let mut before = bed.agent("edge").await;
    before.until_up().await;
    let id = before.id;
    drop(before);
    let mut after = Agent::with(id, "edge", &bed.address, &bed.clock).await;
    after.until_up().await;
    assert!(
        after.notices.iter().all(|notice| matches!(notice, Notice::Welcomed { .. })),
        "{:?}",
        after.notices
    );
    after.offer([generate::run_started(RunId::random(), "line", generate::at(0.0))]);
    after.until_stored().await;
    assert_eq!(bed.picture("the host", |picture| picture.hosts.len() == 1).await.hosts[0].id, id);
    bed.stop().await;
}

#[tokio::test]
async fn repeated_missing_and_early_batches_are_told_apart() {
    let mut bed = Bed::new().await;
    let wire = Wire::to(&bed.address).await;
    let (host, stream, run) = (HostId::random(), StreamId::random(), RunId::random());
    wire.send(&batch(host, stream, 1, run)).await;
    assert_eq!(wire.receive().await, ToAgent::Unknown, "no hello yet");
    wire.send(&hello(host, "edge", stream)).await;
    assert!(matches!(wire.receive().await, ToAgent::Welcome { stored: 0, .. }));
    wire.send(&batch(host, stream, 3, run)).await;
    assert_eq!(wire.receive().await, ToAgent::Resend { stream, from: 1 });
    wire.send(&batch(host, stream, 1, run)).await;
    assert_eq!(wire.receive().await, ToAgent::Ack { stream, through: 1 });
    for _ in 0..3 {
        wire.send(&batch(host, stream, 1, run)).await;
        assert_eq!(wire.receive().await, ToAgent::Ack { stream, through: 1 });
    }
    wire.send(&batch(host, stream, 2, run)).await;
    assert_eq!(wire.receive().await, ToAgent::Ack { stream, through: 2 });
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 2);
    bed.picture("three duplicates", |picture| {
        picture.hosts.first().is_some_and(|host| host.stored.duplicates == 3)
    })
    .await;
    // From another connection the host id alone opens nothing.
    let stranger = Wire::to(&bed.address).await;
    stranger.send(&batch(host, stream, 3, run)).await;
    assert_eq!(stranger.receive().await, ToAgent::Unknown);
    stranger.send(&ToAggregator::Goodbye(host)).await;
    assert_eq!(stranger.receive().await, ToAgent::Unknown);
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 2);
    bed.stop().await;
}

#[tokio::test]
async fn a_batch_that_cannot_be_read_is_put_aside_and_the_stream_goes_on() {
    let mut bed = Bed::new().await;
    let wire = Wire::to(&bed.address).await;
    let (host, stream, run) = (HostId::random(), StreamId::random(), RunId::random());
    wire.send_frame(vec![0xc1; 100]).await;
    wire.send(&hello(host, "edge", stream)).await;
    assert!(matches!(wire.receive().await, ToAgent::Welcome { stored: 0, .. }));
    let mut damaged = encode(&batch(host, stream, 1, run));
    damaged.truncate(damaged.len() - 30);
    wire.send_frame(damaged).await;
    assert_eq!(wire.receive().await, ToAgent::Ack { stream, through: 1 });
    wire.send(&batch(host, stream, 2, run)).await;
    assert_eq!(wire.receive().await, ToAgent::Ack { stream, through: 2 });
    assert_eq!(bed.count("SELECT count(*) FROM quarantine WHERE number = 1 AND events IS NULL").await, 1);
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 1);
    let picture = bed.picture("the quarantined batch", |picture| {
        picture.hosts.first().is_some_and(|host| host.stored.quarantined == 1)
    });
    assert_eq!(picture.await.hosts[0].stored.nodes, 21);
    bed.stop().await;
}

#[tokio::test]
async fn a_spool_that_lost_batches_leaves_a_gap_and_a_copied_one_is_refused() {
    let mut bed = Bed::new().await;
    let wire = Wire::to(&bed.address).await;
    let (host, stream, run) = (HostId::random(), StreamId::random(), RunId::random());
    let ToAggregator::Hello(mut greeting) = hello(host, "edge", stream) else { panic!("a hello") };
    greeting.oldest = 8;
    wire.send(&ToAggregator::Hello(greeting.clone())).await;
    assert!(matches!(wire.receive().await, ToAgent::Welcome { .. }));
    assert_eq!(wire.receive().await, ToAgent::Ack { stream, through: 7 }, "the gap is stored");
    wire.send(&batch(host, stream, 8, run)).await;
    assert_eq!(wire.receive().await, ToAgent::Ack { stream, through: 8 });
    assert_eq!(bed.count("SELECT count(*) FROM gap WHERE reason LIKE 'batches 1 to 7 of stream%'").await, 1);
    // The owner of a stream is known across restarts.
    bed.stop().await;
    bed.start().await;
    let copy = Wire::to(&bed.address).await;
    copy.send(&hello(HostId::random(), "copy", stream)).await;
    let ToAgent::Refused { reason } = copy.receive().await else { panic!("refused") };
    assert!(reason.contains(&host.to_string()), "{reason}");
    greeting.oldest = u64::MAX;
    copy.send(&ToAggregator::Hello(greeting)).await;
    assert!(matches!(copy.receive().await, ToAgent::Refused { .. }));
    bed.stop().await;
}
