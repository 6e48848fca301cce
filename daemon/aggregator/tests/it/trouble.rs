//! Tests of agents that are refused, crash, repeat batches or send invalid data.

use peernet_logger::RunId;
use peernet_stream::{Chain, Hello, Notice, StreamId, ToAgent, ToAggregator};
use sqlx::Connection;

use crate::agent::Agent;
use crate::bed::Bed;
use crate::generate;
use crate::raw::{Raw, Reply};

#[tokio::test]
async fn a_second_host_of_one_name_is_refused_and_shown() {
    let mut bed = Bed::new().await;
    let mut first = bed.agent("edge").await;
    first.until_up().await;
    let mut second = bed.agent("edge").await;
    let is_refusal = |notice: &Notice| matches!(notice, Notice::Refused(_));
    second.until("it is refused", |agent| agent.notices.iter().any(is_refusal)).await;
    let Some(Notice::Refused(reason)) = second.notices.last() else { panic!("{:?}", second.notices) };
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
    assert!(after.notices.iter().all(|notice| !matches!(notice, Notice::Refused(_))), "{:?}", after.notices);
    after.offer([generate::run_started(RunId::random(), "line", generate::at(0.0))]);
    after.until_stored().await;
    assert_eq!(bed.picture("the host", |picture| picture.hosts.len() == 1).await.hosts[0].id, id);
    bed.stop().await;
}

#[tokio::test]
async fn repeated_missing_and_early_batches_are_told_apart() {
    let mut bed = Bed::new().await;
    let mut raw = Raw::new(&bed).await;
    let batches = [raw.next(), raw.next(), raw.next()];
    raw.wire.send_frame(batches[0].clone()).await;
    raw.expect(Reply::Unknown).await;
    let hello = raw.hello("edge");
    let hello = Hello { oldest: 1, before: Chain::START, ..hello };
    assert!(matches!(raw.wire.greet(&hello).await, ToAgent::Welcome { stored: 0, .. }));
    raw.wire.send_frame(batches[2].clone()).await;
    raw.expect(Reply::Resend(1)).await;
    raw.wire.send_frame(batches[0].clone()).await;
    raw.expect(Reply::Ack(1)).await;
    for _ in 0..3 {
        raw.wire.send_frame(batches[0].clone()).await;
        raw.expect(Reply::Ack(1)).await;
    }
    raw.wire.send_frame(batches[1].clone()).await;
    raw.expect(Reply::Ack(2)).await;
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 2);
    bed.picture("three duplicates", |picture| {
        picture.hosts.first().is_some_and(|host| host.stored.duplicates == 3)
    })
    .await;
    // The host id is not sufficient on another connection.
    let stranger = Raw::new(&bed).await;
    stranger.wire.send_frame(batches[2].clone()).await;
    stranger.expect(Reply::Unknown).await;
    stranger.wire.send(&ToAggregator::Goodbye(raw.host)).await;
    stranger.expect(Reply::Unknown).await;
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 2);
    bed.stop().await;
}

#[tokio::test]
async fn what_is_damaged_is_asked_for_again_and_put_aside_at_the_third_time() {
    let mut bed = Bed::new().await;
    let mut raw = Raw::welcome(&bed, "edge").await;
    raw.wire.send_frame(vec![0xc1; 100]).await;
    raw.expect(Reply::Unknown).await;
    let first = raw.next();
    let damaged = first[..first.len() - 30].to_vec();
    raw.wire.send_frame(damaged.clone()).await;
    raw.expect(Reply::Resend(1)).await;
    raw.wire.send_frame(first).await;
    raw.expect(Reply::Ack(1)).await;

    let second = raw.next();
    let mut damaged = second.clone();
    *damaged.last_mut().expect("a body") ^= 1;
    for _ in 0..2 {
        raw.wire.send_frame(damaged.clone()).await;
        raw.expect(Reply::Resend(2)).await;
    }
    raw.wire.send_frame(damaged).await;
    raw.expect(Reply::Ack(2)).await;
    raw.send_next().await;
    raw.expect(Reply::Ack(3)).await;
    assert_eq!(bed.count("SELECT count(*) FROM quarantine WHERE number = 2 AND events IS NULL").await, 1);
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 2);
    assert_eq!(bed.count("SELECT count(*) FROM gap WHERE count = 1").await, 1);
    let picture = bed.picture("the quarantined batch", |picture| {
        // The third batch may be in a separate transaction.
        picture.hosts.first().is_some_and(|host| {
            host.stored.quarantined == 1 && host.arrivals.damaged == 4 && host.stored.nodes >= 42
        })
    });
    assert_eq!(picture.await.hosts[0].stored.nodes, 42);
    bed.stop().await;
}

#[tokio::test]
async fn what_matches_its_hash_and_is_no_event_is_put_aside_at_once() {
    let mut bed = Bed::new().await;
    let mut raw = Raw::welcome(&bed, "edge").await;
    let frames = [
        raw.next_with(7, &[0xc1; 100]),
        raw.next_with(u32::MAX, &[0xc0; 10]),
        raw.next_with(0, &[]),
        raw.next(),
    ];
    for (frame, number) in frames.into_iter().zip(1..) {
        raw.wire.send_frame(frame).await;
        raw.expect(Reply::Ack(number)).await;
    }
    assert_eq!(bed.count("SELECT count(*) FROM quarantine WHERE number < 3 AND length(frame) > 80").await, 2);
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 1);
    assert_eq!(bed.count("SELECT missing FROM host WHERE name = 'edge'").await, 7);
    bed.stop().await;
}

#[tokio::test]
async fn a_flipped_byte_anywhere_harms_nothing_else() {
    let mut bed = Bed::new().await;
    let mut raw = Raw::welcome(&bed, "edge").await;
    let mut other = Raw::welcome(&bed, "other").await;
    let frame = raw.next();
    // All bytes of the head, and half of the length. With later bytes the frame is recognised as this batch, which
    // would be quarantined when it is damaged three times in a row.
    for at in 0..80 {
        let mut flipped = frame.clone();
        flipped[at] ^= 0x10;
        raw.wire.send_frame(flipped).await;
        if at % 30 == 0 {
            let number = at as u64 / 30 + 1;
            other.send_next().await;
            other.expect(Reply::Ack(number)).await;
        }
    }
    raw.wire.send_frame(frame).await;
    raw.until_stored_over_requests(1).await;
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 4);
    assert_eq!(bed.count("SELECT count(*) FROM quarantine").await, 0);
    assert_eq!(bed.count("SELECT count(*) FROM stream").await, 2);
    bed.stop().await;
}

#[tokio::test]
async fn a_batch_that_does_not_follow_is_not_stored() {
    let mut bed = Bed::new().await;
    let mut raw = Raw::welcome(&bed, "edge").await;
    raw.send_next().await;
    raw.expect(Reply::Ack(1)).await;
    // Another history with the same numbers, as of a copied spool.
    let mut copy = Raw::new(&bed).await;
    (copy.host, copy.stream) = (raw.host, raw.stream);
    let _other_first = copy.next_with(1, &[0xc0]);
    raw.wire.send_frame(copy.next()).await;
    raw.expect(Reply::Unknown).await;
    assert_eq!(bed.count("SELECT stored FROM stream").await, 1);
    raw.send_next().await;
    raw.expect(Reply::Ack(2)).await;
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 2);
    bed.stop().await;
}

#[tokio::test]
async fn whoever_ignores_the_window_gains_nothing_and_loses_nothing() {
    let mut bed = Bed::new().await;
    let mut raw = Raw::welcome(&bed, "edge").await;
    // The greeting is stored before the database is locked.
    raw.send_next().await;
    raw.expect(Reply::Ack(1)).await;
    let mut holder = bed.connection().await;
    sqlx::raw_sql("BEGIN EXCLUSIVE").execute(&mut holder).await.expect("locks");
    let frames: Vec<Vec<u8>> = (0..200).map(|_| raw.next()).collect();
    for frame in &frames {
        raw.wire.send_frame(frame.clone()).await;
    }
    assert!(raw.is_silent().await, "nothing is stored, so nothing is acknowledged");
    sqlx::raw_sql("ROLLBACK").execute(&mut holder).await.expect("unlocks");
    holder.close().await.expect("closes");
    // Rejected batches are sent again, within the window.
    let mut stored = 1;
    while stored < 201 {
        let from = match raw.wire.receive().await {
            ToAgent::Ack { through, .. } => {
                stored = through;
                through + 1
            }
            ToAgent::Resend { from, .. } => from,
            other => panic!("{other:?}"),
        };
        for frame in frames.iter().skip(from as usize - 2).take(8) {
            raw.wire.send_frame(frame.clone()).await;
        }
    }
    assert_eq!(bed.count("SELECT count(*) FROM iteration").await, 201);
    bed.stop().await;
}

#[tokio::test]
async fn a_spool_that_lost_batches_leaves_a_gap_and_a_copied_one_is_refused() {
    let mut bed = Bed::new().await;
    let mut raw = Raw::new(&bed).await;
    for _ in 0..7 {
        raw.next();
    }
    let greeting = raw.hello("edge");
    assert!(matches!(raw.wire.greet(&greeting).await, ToAgent::Welcome { .. }));
    // The gap is stored with the first batch of the host.
    raw.send_next().await;
    raw.until_stored_over_requests(8).await;
    assert_eq!(bed.count("SELECT count(*) FROM gap WHERE reason LIKE 'batches 1 to 7 of stream%'").await, 1);
    // The owner of a stream is known after a restart, too.
    bed.stop().await;
    bed.start().await;
    let mut copy = Raw::new(&bed).await;
    copy.stream = raw.stream;
    let ToAgent::Refused { reason } = copy.wire.greet(&copy.hello("copy")).await else { panic!("refused") };
    assert!(reason.contains(&raw.host.to_string()), "{reason}");
    let impossible = Hello { oldest: u64::MAX, ..greeting };
    assert!(matches!(copy.wire.greet(&impossible).await, ToAgent::Refused { .. }));
    bed.stop().await;
}

#[tokio::test]
async fn a_deleted_spool_leaves_one_gap_however_often_its_agent_comes_back() {
    let mut bed = Bed::new().await;
    let mut raw = Raw::welcome(&bed, "edge").await;
    raw.send_next().await;
    raw.expect(Reply::Ack(1)).await;
    let mut anew = Raw::new(&bed).await;
    anew.host = raw.host;
    for _ in 0..2 {
        for _ in 0..2 {
            // With the same process number, so that the aggregator does not wait for another agent's end.
            let again = Raw { stream: anew.stream, host: raw.host, ..Raw::new(&bed).await };
            assert!(matches!(
                again.wire.greet(&again.hello("edge")).await,
                ToAgent::Welcome { stored: 0, .. }
            ));
        }
        bed.stop().await;
        bed.start().await;
    }
    assert_eq!(bed.count("SELECT count(*) FROM gap WHERE reason LIKE '%deleted or replaced%'").await, 1);
    assert_eq!(bed.count("SELECT gaps FROM host WHERE name = 'edge'").await, 1);
    // A stream that continues the replaced one leaves no gap.
    let next = Raw { host: raw.host, ..Raw::new(&bed).await };
    let hello = Hello { previous: Some(anew.stream), ..next.hello("edge") };
    assert!(matches!(next.wire.greet(&hello).await, ToAgent::Welcome { .. }));
    bed.stop().await;
    assert_eq!(bed.count("SELECT count(*) FROM gap").await, 1);
    let previous = anew.stream;
    let uuid: Option<String> = sqlx::query_scalar("SELECT previous FROM stream WHERE previous IS NOT NULL")
        .fetch_one(&mut bed.connection().await)
        .await
        .expect("reads");
    assert_eq!(uuid.and_then(|uuid| uuid.parse::<StreamId>().ok()), Some(previous));
}
