//! Tests of a full queue and of data that arrives hours after its time.

use peernet_logger::{HostId, RunId};
use peernet_stream::{Event, Incident, IncidentKind, ToAgent};
use sqlx::Connection;

use crate::generate;
use crate::scripted_agent::{Reply, ScriptedAgent};
use crate::testbed::Testbed;

/// Returns a batch of nearly the largest size.
fn large_batch(scripted_agent: &mut ScriptedAgent) -> Vec<u8> {
    let incident = Incident {
        at: generate::at(1.0),
        kind: IncidentKind::Control,
        pipeline: None,
        run: None,
        peer: None,
        text: "x".repeat(4_000_000),
    };
    scripted_agent.next_with_events(&[Event::Incident(incident)])
}

#[tokio::test]
async fn deferred_batches_are_requested_when_queue_has_capacity() {
    let mut testbed = Testbed::new().await;
    let mut agents = Vec::new();
    for name in ["one", "two", "late"] {
        let mut scripted_agent = ScriptedAgent::welcome(&testbed, name).await;
        scripted_agent.send_next().await;
        scripted_agent.expect(Reply::Ack(1)).await;
        agents.push(scripted_agent);
    }
    let mut holder = testbed.connection().await;
    sqlx::raw_sql("BEGIN EXCLUSIVE").execute(&mut holder).await.expect("locks");
    // These batches are compressed and therefore small on the network. In the queue they take the size of the
    // decompressed events: 25 of these 32 batches fill the queue.
    for scripted_agent in &mut agents[..2] {
        for _ in 0..16 {
            let frame = large_batch(scripted_agent);
            scripted_agent.socket.send_frame(frame).await;
        }
    }
    let second_batch = agents[2].next();
    testbed.snapshot("deferred batches", |snapshot| snapshot.totals.rejected_batches.deferred >= 6).await;
    let third_batch = large_batch(&mut agents[2]);
    agents[2].socket.send_frame(second_batch.clone()).await;
    agents[2].socket.send_frame(third_batch.clone()).await;
    testbed
        .snapshot("a deferred batch of the third agent", |snapshot| {
            snapshot
                .hosts
                .iter()
                .any(|host| host.description.name.as_str() == "late" && host.rejected_batches.deferred > 0)
        })
        .await;
    sqlx::raw_sql("ROLLBACK").execute(&mut holder).await.expect("unlocks");
    // The aggregator requests the deferred batches, and stores all of them.
    let mut resend_requests = 0;
    loop {
        match agents[2].socket.receive().await {
            ToAgent::Resend { from, .. } => {
                resend_requests += 1;
                let deferred_batches = [&second_batch, &third_batch];
                for frame in &deferred_batches[usize::try_from(from).expect("small") - 2..] {
                    agents[2].socket.send_frame((*frame).clone()).await;
                }
            }
            ToAgent::Ack { through: 3, .. } => break,
            ToAgent::Ack { .. } => {}
            other => panic!("{other:?}"),
        }
    }
    assert!(resend_requests > 0);
    assert_eq!(
        testbed
            .count("SELECT stored FROM stream JOIN host ON host.id = stream.host WHERE name = 'late'")
            .await,
        3
    );
    testbed.stop().await;
}

#[tokio::test]
async fn repeated_hello_is_welcomed_while_queue_is_full() {
    let mut testbed = Testbed::new().await;
    let mut agents = Vec::new();
    for name in ["one", "two"] {
        let mut scripted_agent = ScriptedAgent::welcome(&testbed, name).await;
        scripted_agent.send_next().await;
        scripted_agent.expect(Reply::Ack(1)).await;
        agents.push(scripted_agent);
    }
    let repeated_hello = agents[0].hello("one");
    let mut holder = testbed.connection().await;
    sqlx::raw_sql("BEGIN EXCLUSIVE").execute(&mut holder).await.expect("locks");
    // 25 large batches leave less than 1 MiB of the queue. The small batches fill this rest.
    for _ in 0..26 {
        let frame = large_batch(&mut agents[0]);
        agents[0].socket.send_frame(frame).await;
    }
    testbed.snapshot("a deferred batch", |snapshot| snapshot.totals.rejected_batches.deferred > 0).await;
    for _ in 0..1_100 {
        agents[1].send_next().await;
    }
    testbed
        .snapshot("a deferred batch of the second agent", |snapshot| {
            snapshot
                .hosts
                .iter()
                .any(|host| host.description.name.as_str() == "two" && host.rejected_batches.deferred > 0)
        })
        .await;
    let answer = agents[0].socket.greet(&repeated_hello).await;
    assert!(matches!(answer, ToAgent::Welcome { stored: 1, .. }), "{answer:?}");
    sqlx::raw_sql("ROLLBACK").execute(&mut holder).await.expect("unlocks");
    holder.close().await.expect("closes");
    testbed.stop().await;
}

#[tokio::test]
async fn late_data_is_counted_in_buckets_of_its_time() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    let run = RunId::random();
    let hosts = (agent.id, HostId::from_bytes([7; 16]));
    let mut random = generate::Numbers::new(5);
    agent.offer([generate::run_started(run, "line", generate::at(0.0))]);
    // The parts are hours apart and unordered. Each part is in a separate commit. The aggregator restarts after the
    // third part.
    for (part, hour) in [5, 0, 3, 5, 1].into_iter().enumerate() {
        let start_s = f64::from(hour) * 3600.0 + part as f64 * 7.0;
        agent.offer((0..60_u32).map(|n| {
            let at = generate::at(start_s + f64::from(n) * 0.31);
            let number = part as u64 * 60 + u64::from(n) + 1;
            Event::Iteration(generate::iteration_at(run, number, hosts, at, &mut random))
        }));
        agent.until_stored().await;
        if part == 2 {
            testbed.stop().await;
            testbed.start().await;
        }
    }
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 300);
    // Quantity 0 is the value of a node. Resolution 0 is the whole run.
    let wrong = testbed.count(
        "WITH width (s) AS (VALUES (1), (10), (60), (3600)), \
         truth AS (SELECT s, started_ns / 1000000000 / s * s AS bucket, count(*) AS count FROM width, iteration GROUP BY 1, 2), \
         stored AS (SELECT resolution_s, bucket_s, count FROM rollup JOIN name ON name.id = rollup.name \
                  WHERE name.text = 'total' AND quantity = 0 AND resolution_s > 0) \
         SELECT (SELECT count(*) FROM (SELECT * FROM truth EXCEPT SELECT * FROM stored)) \
              + (SELECT count(*) FROM (SELECT * FROM stored EXCEPT SELECT * FROM truth))",
    );
    assert_eq!(wrong.await, 0);
    testbed.stop().await;
}

#[tokio::test]
async fn running_aggregator_pins_and_unpins_run() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    agent.offer([generate::run_started(RunId::random(), "line", generate::at(0.0))]);
    agent.until_stored().await;
    assert!(testbed.aggregator().pin(1, true).await.expect("writes"));
    assert!(!testbed.aggregator().pin(2, true).await.expect("writes"), "there is no such run");
    assert_eq!(testbed.count("SELECT pinned FROM run").await, 1);
    assert!(testbed.aggregator().pin(1, false).await.expect("writes"));
    assert_eq!(testbed.count("SELECT pinned FROM run").await, 0);
    testbed.stop().await;
}
