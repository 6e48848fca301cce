//! Tests of agents that are refused, crash, repeat batches or send invalid data.

use peernet_logger::RunId;
use peernet_stream::{ChainHash, Hello, Notice, StreamId, ToAgent, ToAggregator};
use sqlx::Connection;

use crate::agent::Agent;
use crate::generate;
use crate::scripted_agent::{Reply, ScriptedAgent};
use crate::testbed::Testbed;

#[tokio::test]
async fn another_host_with_same_name_is_refused_and_shown() {
    let mut testbed = Testbed::new().await;
    let mut first = testbed.agent("edge").await;
    first.until_up().await;
    let mut second = testbed.agent("edge").await;
    let is_refusal = |notice: &Notice| matches!(notice, Notice::Refused(_));
    second.until("the second agent is refused", |agent| agent.notices.iter().any(is_refusal)).await;
    let Some(Notice::Refused(reason)) = second.notices.last() else { panic!("{:?}", second.notices) };
    assert!(
        reason.contains("the name edge is taken by the host with the id") && reason.contains("another name")
    );
    let snapshot = testbed.snapshot("the refusal", |snapshot| !snapshot.refused.is_empty()).await;
    assert_eq!(
        (snapshot.hosts.len(), snapshot.refused[0].name.as_str(), &snapshot.refused[0].reason),
        (1, "edge", reason)
    );
    assert!(snapshot.refused[0].address.as_deref().is_some_and(|address| address.starts_with("127.0.0.1:")));
    testbed.stop().await;
}

#[tokio::test]
async fn crashed_agent_reconnects_with_same_id() {
    let mut testbed = Testbed::new().await;
    let mut crashed = testbed.agent("edge").await;
    crashed.until_up().await;
    let id = crashed.id;
    drop(crashed);
    let mut restarted = Agent::with_id(id, "edge", &testbed.address, &testbed.clock).await;
    restarted.until_up().await;
    assert!(
        restarted.notices.iter().all(|notice| !matches!(notice, Notice::Refused(_))),
        "{:?}",
        restarted.notices
    );
    restarted.offer([generate::run_started(RunId::random(), "line", generate::at(0.0))]);
    restarted.until_stored().await;
    assert_eq!(testbed.snapshot("the host", |snapshot| snapshot.hosts.len() == 1).await.hosts[0].id, id);
    testbed.stop().await;
}

#[tokio::test]
async fn duplicate_missing_and_early_batches_are_distinguished() {
    let mut testbed = Testbed::new().await;
    let mut scripted_agent = ScriptedAgent::new(&testbed).await;
    let batches = [scripted_agent.next(), scripted_agent.next(), scripted_agent.next()];
    scripted_agent.socket.send_frame(batches[0].clone()).await;
    scripted_agent.expect(Reply::Unknown).await;
    // The three batches exist already. `hello` alone would announce a stream that continues after these batches.
    let hello = scripted_agent.hello("edge");
    let hello = Hello { oldest: 1, chain_before_oldest: ChainHash::START, ..hello };
    assert!(matches!(scripted_agent.socket.greet(&hello).await, ToAgent::Welcome { stored: 0, .. }));
    scripted_agent.socket.send_frame(batches[2].clone()).await;
    scripted_agent.expect(Reply::Resend(1)).await;
    scripted_agent.socket.send_frame(batches[0].clone()).await;
    scripted_agent.expect(Reply::Ack(1)).await;
    for _ in 0..3 {
        scripted_agent.socket.send_frame(batches[0].clone()).await;
        scripted_agent.expect(Reply::Ack(1)).await;
    }
    scripted_agent.socket.send_frame(batches[1].clone()).await;
    scripted_agent.expect(Reply::Ack(2)).await;
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 2);
    testbed
        .snapshot("three duplicates", |snapshot| {
            snapshot.hosts.first().is_some_and(|host| host.stored.duplicates == 3)
        })
        .await;
    // On another connection, the host id alone does not give access.
    let stranger = ScriptedAgent::new(&testbed).await;
    stranger.socket.send_frame(batches[2].clone()).await;
    stranger.expect(Reply::Unknown).await;
    stranger.socket.send(&ToAggregator::Goodbye(scripted_agent.host)).await;
    stranger.expect(Reply::Unknown).await;
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 2);
    testbed.stop().await;
}

#[tokio::test]
async fn damaged_batch_is_requested_again_then_quarantined() {
    let mut testbed = Testbed::new().await;
    let mut scripted_agent = ScriptedAgent::welcome(&testbed, "edge").await;
    // This frame has the form of a batch from an unknown host.
    scripted_agent.socket.send_frame(vec![0xc1; 100]).await;
    scripted_agent.expect(Reply::Unknown).await;
    let first = scripted_agent.next();
    let damaged = first[..first.len() - 30].to_vec();
    scripted_agent.socket.send_frame(damaged.clone()).await;
    scripted_agent.expect(Reply::Resend(1)).await;
    scripted_agent.socket.send_frame(first).await;
    scripted_agent.expect(Reply::Ack(1)).await;

    let second = scripted_agent.next();
    let mut damaged = second.clone();
    *damaged.last_mut().expect("a body") ^= 1;
    for _ in 0..2 {
        scripted_agent.socket.send_frame(damaged.clone()).await;
        scripted_agent.expect(Reply::Resend(2)).await;
    }
    scripted_agent.socket.send_frame(damaged).await;
    scripted_agent.expect(Reply::Ack(2)).await;
    scripted_agent.send_next().await;
    scripted_agent.expect(Reply::Ack(3)).await;
    assert_eq!(testbed.count("SELECT count(*) FROM quarantine WHERE number = 2 AND events IS NULL").await, 1);
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 2);
    assert_eq!(testbed.count("SELECT count(*) FROM gap WHERE count = 1").await, 1);
    let snapshot = testbed.snapshot("the quarantined batch", |snapshot| {
        // The third batch may be in a separate transaction.
        snapshot.hosts.first().is_some_and(|host| {
            host.stored.quarantined == 1 && host.rejected_batches.damaged == 4 && host.stored.nodes >= 42
        })
    });
    assert_eq!(snapshot.await.hosts[0].stored.nodes, 42);
    testbed.stop().await;
}

#[tokio::test]
async fn undecodable_batch_is_quarantined_at_once() {
    let mut testbed = Testbed::new().await;
    let mut scripted_agent = ScriptedAgent::welcome(&testbed, "edge").await;
    let frames = [
        scripted_agent.next_with_body(7, &[0xc1; 100]),
        scripted_agent.next_with_body(u32::MAX, &[0xc0; 10]),
        scripted_agent.next_with_body(0, &[]),
        scripted_agent.next(),
    ];
    for (frame, number) in frames.into_iter().zip(1..) {
        scripted_agent.socket.send_frame(frame).await;
        scripted_agent.expect(Reply::Ack(number)).await;
    }
    assert_eq!(
        testbed.count("SELECT count(*) FROM quarantine WHERE number < 3 AND length(frame) > 80").await,
        2
    );
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 1);
    // The second batch states more events than its bytes can hold, so only the 7 events of the first batch are counted.
    assert_eq!(testbed.count("SELECT missing FROM host WHERE name = 'edge'").await, 7);
    testbed.stop().await;
}

#[tokio::test]
async fn flipped_byte_affects_no_other_batch() {
    let mut testbed = Testbed::new().await;
    let mut scripted_agent = ScriptedAgent::welcome(&testbed, "edge").await;
    let mut other = ScriptedAgent::welcome(&testbed, "other").await;
    let frame = scripted_agent.next();
    // Only bytes of the head are flipped: 80 of its 98 bytes. A flipped byte of the body leaves the head intact. The
    // batch would then be quarantined when it arrives damaged three times in a row.
    for index in 0..80 {
        let mut flipped = frame.clone();
        flipped[index] ^= 0x10;
        scripted_agent.socket.send_frame(flipped).await;
        if index % 30 == 0 {
            let number = index as u64 / 30 + 1;
            other.send_next().await;
            other.expect(Reply::Ack(number)).await;
        }
    }
    scripted_agent.socket.send_frame(frame).await;
    scripted_agent.wait_for_acknowledgement(1).await;
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 4);
    assert_eq!(testbed.count("SELECT count(*) FROM quarantine").await, 0);
    assert_eq!(testbed.count("SELECT count(*) FROM stream").await, 2);
    testbed.stop().await;
}

#[tokio::test]
async fn batch_of_another_history_is_not_stored() {
    let mut testbed = Testbed::new().await;
    let mut scripted_agent = ScriptedAgent::welcome(&testbed, "edge").await;
    scripted_agent.send_next().await;
    scripted_agent.expect(Reply::Ack(1)).await;
    // Another history with the same numbers, as the copy of a spool has.
    let mut copy = ScriptedAgent::new(&testbed).await;
    (copy.host, copy.stream) = (scripted_agent.host, scripted_agent.stream);
    let _other_first = copy.next_with_body(1, &[0xc0]);
    scripted_agent.socket.send_frame(copy.next()).await;
    scripted_agent.expect(Reply::Unknown).await;
    assert_eq!(testbed.count("SELECT stored FROM stream").await, 1);
    scripted_agent.send_next().await;
    scripted_agent.expect(Reply::Ack(2)).await;
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 2);
    testbed.stop().await;
}

#[tokio::test]
async fn sender_that_ignores_window_loses_nothing() {
    let mut testbed = Testbed::new().await;
    let mut scripted_agent = ScriptedAgent::welcome(&testbed, "edge").await;
    // The hello is stored before the database is locked.
    scripted_agent.send_next().await;
    scripted_agent.expect(Reply::Ack(1)).await;
    let mut holder = testbed.connection().await;
    sqlx::raw_sql("BEGIN EXCLUSIVE").execute(&mut holder).await.expect("locks");
    let frames: Vec<Vec<u8>> = (0..200).map(|_| scripted_agent.next()).collect();
    for frame in &frames {
        scripted_agent.socket.send_frame(frame.clone()).await;
    }
    assert!(scripted_agent.is_silent().await, "nothing is stored, so nothing is acknowledged");
    sqlx::raw_sql("ROLLBACK").execute(&mut holder).await.expect("unlocks");
    holder.close().await.expect("closes");
    // Rejected batches are sent again, within the window.
    let mut stored = 1;
    while stored < 201 {
        let from = match scripted_agent.socket.receive().await {
            ToAgent::Ack { through, .. } => {
                stored = through;
                through + 1
            }
            ToAgent::Resend { from, .. } => from,
            other => panic!("{other:?}"),
        };
        // `frames[0]` is batch 2.
        for frame in frames.iter().skip(from as usize - 2).take(8) {
            scripted_agent.socket.send_frame(frame.clone()).await;
        }
    }
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 201);
    testbed.stop().await;
}

#[tokio::test]
async fn batches_missing_at_first_hello_are_stored_as_gap() {
    let mut testbed = Testbed::new().await;
    let mut scripted_agent = ScriptedAgent::new(&testbed).await;
    for _ in 0..7 {
        scripted_agent.next();
    }
    let hello = scripted_agent.hello("edge");
    assert!(matches!(scripted_agent.socket.greet(&hello).await, ToAgent::Welcome { .. }));
    // The gap is stored with the first batch of the host.
    scripted_agent.send_next().await;
    scripted_agent.wait_for_acknowledgement(8).await;
    assert_eq!(
        testbed.count("SELECT count(*) FROM gap WHERE reason LIKE 'from before this database: batches 1 to 7 of stream%'").await,
        1
    );
    testbed.stop().await;
}

#[tokio::test]
async fn stream_of_another_host_is_refused_after_restart() {
    let mut testbed = Testbed::new().await;
    let mut scripted_agent = ScriptedAgent::welcome(&testbed, "edge").await;
    scripted_agent.send_next().await;
    scripted_agent.expect(Reply::Ack(1)).await;
    testbed.stop().await;
    testbed.start().await;
    let mut copy = ScriptedAgent::new(&testbed).await;
    copy.stream = scripted_agent.stream;
    let ToAgent::Refused { reason } = copy.socket.greet(&copy.hello("copy")).await else { panic!("refused") };
    assert!(reason.contains(&scripted_agent.host.to_string()), "{reason}");
    testbed.stop().await;
}

#[tokio::test]
async fn hello_with_impossible_batch_number_is_refused() {
    let mut testbed = Testbed::new().await;
    let scripted_agent = ScriptedAgent::new(&testbed).await;
    let impossible = Hello { oldest: u64::MAX, ..scripted_agent.hello("edge") };
    assert!(matches!(scripted_agent.socket.greet(&impossible).await, ToAgent::Refused { .. }));
    testbed.stop().await;
}

#[tokio::test]
async fn deleted_spool_leaves_one_gap_despite_reconnections() {
    let mut testbed = Testbed::new().await;
    let mut scripted_agent = ScriptedAgent::welcome(&testbed, "edge").await;
    scripted_agent.send_next().await;
    scripted_agent.expect(Reply::Ack(1)).await;
    let mut replacement = ScriptedAgent::new(&testbed).await;
    replacement.host = scripted_agent.host;
    for _ in 0..2 {
        for _ in 0..2 {
            // The hello has the same process number, so that the aggregator does not wait for another agent's end.
            let reconnection = ScriptedAgent {
                stream: replacement.stream,
                host: scripted_agent.host,
                ..ScriptedAgent::new(&testbed).await
            };
            assert!(matches!(
                reconnection.socket.greet(&reconnection.hello("edge")).await,
                ToAgent::Welcome { stored: 0, .. }
            ));
        }
        testbed.stop().await;
        testbed.start().await;
    }
    assert_eq!(testbed.count("SELECT count(*) FROM gap WHERE reason LIKE '%deleted or replaced%'").await, 1);
    assert_eq!(testbed.count("SELECT gaps FROM host WHERE name = 'edge'").await, 1);
    // A stream that names its previous stream leaves no gap.
    let next = ScriptedAgent { host: scripted_agent.host, ..ScriptedAgent::new(&testbed).await };
    let hello = Hello { previous_stream: Some(replacement.stream), ..next.hello("edge") };
    assert!(matches!(next.socket.greet(&hello).await, ToAgent::Welcome { .. }));
    testbed.stop().await;
    assert_eq!(testbed.count("SELECT count(*) FROM gap").await, 1);
    let previous = replacement.stream;
    let uuid: Option<String> = sqlx::query_scalar("SELECT previous FROM stream WHERE previous IS NOT NULL")
        .fetch_one(&mut testbed.connection().await)
        .await
        .expect("reads");
    assert_eq!(uuid.and_then(|uuid| uuid.parse::<StreamId>().ok()), Some(previous));
}
