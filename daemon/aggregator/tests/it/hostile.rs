//! Tests with hostile or defective peers: silent connections, many names, a database that disappears.

use std::sync::Arc;

use peernet_aggregator::Readiness;
use peernet_clock::{Interval, OneWayDelay, RawTime, Span, WallTime};
use peernet_logger::{HostId, Measure, RunId};
use peernet_store::LinkKey;
use peernet_stream::{Event, HostClock, NetworkName, ToAgent, ToAggregator};
use tokio::io::AsyncReadExt;
use tokio::net::TcpStream;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::agent::AgentSocket;
use crate::scripted_agent::{Reply, ScriptedAgent};
use crate::testbed::Testbed;
use crate::{clocks, generate};

#[tokio::test]
async fn silent_connections_do_not_block_agents() {
    let mut testbed = Testbed::new().await;
    let address = testbed.address.strip_prefix("tcp://").expect("TCP").to_owned();
    // A connection that is closed by the aggregator is opened again at once.
    let mut silent = JoinSet::new();
    let open_connections = Arc::new(Semaphore::new(0));
    for _ in 0..300 {
        let (address, open_connections) = (address.clone(), Arc::clone(&open_connections));
        silent.spawn(async move {
            loop {
                let mut connection = TcpStream::connect(&address).await.expect("connects");
                open_connections.add_permits(1);
                let mut ignored = Vec::new();
                let _closed = connection.read_to_end(&mut ignored).await;
            }
        });
    }
    let _permits = open_connections.acquire_many(300).await.expect("open");
    let mut agent = testbed.agent("edge").await;
    agent.until_up().await;
    silent.shutdown().await;
    testbed.stop().await;
}

#[tokio::test]
async fn hosts_per_connection_are_limited() {
    let mut testbed = Testbed::new().await;
    let socket = AgentSocket::connect(&testbed.address).await;
    for n in 0..65 {
        // Each hello comes from another host. All hellos are sent on the same connection.
        let hello = ScriptedAgent::new(&testbed).await.hello(&format!("host-{n}"));
        match socket.greet(&hello).await {
            ToAgent::Welcome { .. } => assert!(n < 64),
            ToAgent::Refused { reason } => {
                assert!(n == 64 && reason.contains("let each agent open its own"), "{n}: {reason}");
            }
            other => panic!("{other:?}"),
        }
    }
    // Other connections are accepted.
    let mut agent = testbed.agent("edge").await;
    agent.until_up().await;
    testbed.stop().await;
}

#[tokio::test]
async fn hosts_welcomed_together_do_not_exceed_limit() {
    let mut testbed = Testbed::with_max_hosts(2).await;
    let mut first = ScriptedAgent::welcome(&testbed, "first").await;
    first.send_next().await;
    first.expect(Reply::Ack(1)).await;
    let mut second = ScriptedAgent::welcome(&testbed, "second").await;
    let mut third = ScriptedAgent::welcome(&testbed, "third").await;
    second.send_next().await;
    second.expect(Reply::Ack(1)).await;
    third.send_next().await;
    third.expect(Reply::Unknown).await;
    let answer = third.socket.greet(&third.hello("third")).await;
    assert!(
        matches!(&answer, ToAgent::Refused { reason } if reason.contains("raise max_hosts")),
        "{answer:?}"
    );
    assert_eq!(testbed.count("SELECT count(*) FROM host WHERE name IS NOT NULL").await, 2);
    second.send_next().await;
    second.expect(Reply::Ack(2)).await;
    testbed.stop().await;
}

#[tokio::test]
async fn unreadable_and_unknown_messages_are_counted() {
    let mut testbed = Testbed::new().await;
    let mut stranger = ScriptedAgent::new(&testbed).await;
    for unreadable in [&b""[..], b"\xff\xff\xff", &[7; 10_000]] {
        stranger.socket.send_frame(unreadable.to_vec()).await;
    }
    stranger.send_next().await;
    stranger.expect(Reply::Unknown).await;
    stranger.socket.send(&ToAggregator::Goodbye(stranger.host)).await;
    stranger.expect(Reply::Unknown).await;
    let snapshot_with_counts = testbed.snapshot("the counts of all messages", |snapshot| {
        let refused = snapshot.totals.refused;
        (refused.unreadable, refused.strangers) == (3, 2)
    });
    let snapshot = snapshot_with_counts.await;
    assert!(snapshot.hosts.is_empty() && snapshot.totals.stored.events == 0);
    testbed.stop().await;
}

#[tokio::test]
async fn hostile_clock_values_are_bounded_and_stored() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    agent.until_up().await;
    // The first update has more links than an update may have, the second update has as many as it may have.
    let mut links: Vec<_> = (0..1_024)
        .map(|_| {
            let mut sample = clocks::sample(HostId::random(), 1, 40);
            sample.at = testbed.clock.wall();
            sample.max_drift_ppm = f64::NAN;
            let mut link = clocks::link(sample);
            link.networks = vec![String::new(); 64];
            link
        })
        .collect();
    links[0].networks = vec!["x".repeat(300_000)];
    let clock = HostClock { text: "y".repeat(300_000), ..HostClock::default() };
    let too_many_links = [&links[..], &links[..1]].concat();
    agent.live_with(vec![], too_many_links, clock.clone()).await;
    agent.live_with(vec![], links, clock).await;
    let snapshot = testbed.snapshot("some links", |snapshot| !snapshot.links.is_empty()).await;
    assert_eq!(snapshot.links.len(), 64);
    // Of the 1,024 links of the second update, 64 are shown. 63 of these links have 64 networks, of which 32 are shown.
    assert_eq!(snapshot.hosts[0].live_left_out, 1_024 - 64 + 63 * 32);
    assert!(serde_json::to_string(&*snapshot).expect("serialises").len() < 1_000_000);

    // Extreme bit patterns in the durable lane. The aggregator must store the batches that contain them.
    let extreme_sample = |second: i64, nanos: i64| {
        let mut sample = clocks::sample(HostId::from_bytes([7; 16]), second, 40);
        (sample.relation_period, sample.max_drift_ppm) = (nanos.cast_unsigned(), f64::NEG_INFINITY);
        for exchange in [&mut sample.upper, &mut sample.lower].into_iter().flatten() {
            exchange.sent = RawTime::from_nanos(nanos);
            exchange.replied = RawTime::from_nanos(!nanos);
            exchange.uncertainty = Span::from_nanos(nanos);
        }
        let offset = sample.offset.as_mut().expect("known");
        offset.estimate = Span::from_nanos(nanos);
        offset.bounds = Interval { lo: Span::from_nanos(!nanos), hi: Span::from_nanos(nanos) };
        offset.exchanges = nanos.cast_unsigned();
        sample
    };
    let run = RunId::random();
    let mut numbers = generate::Numbers::new(3);
    let hosts = (agent.id, HostId::from_bytes([7; 16]));
    agent.offer((1..=50).map(|n| {
        let mut iteration = generate::iteration(run, n, hosts, &mut numbers);
        // This delay is not a delay of hosts with one clock, so `recompute` below judges it again.
        let (upload, _) = iteration.tree.find(&["upload"]).expect("measured");
        if let Some(Measure::Transit(transit)) = iteration.tree.measure_mut(upload) {
            transit.delay = Some(OneWayDelay::unsynchronised(Span::from_nanos(i64::MIN)));
        }
        Event::Iteration(iteration)
    }));
    let samples =
        [i64::MIN, i64::MAX, -1, 0].into_iter().zip(1..).map(|(nanos, second)| extreme_sample(second, nanos));
    agent.offer(samples.map(|sample| Event::Clock(Box::new(sample))));
    agent.until_stored().await;
    assert_eq!(testbed.count("SELECT count(*) FROM quarantine").await, 0);
    assert_eq!(testbed.count("SELECT count(*) FROM clock_sample").await, 4);
    let store = testbed.aggregator().store();
    let (from, to) = (WallTime::from_unix_nanos(i64::MIN), WallTime::from_unix_nanos(i64::MAX));
    let key = LinkKey { edge: agent.id, cloud: hosts.1, network: NetworkName::default() };
    let series = store.clock_series(&key, from, to, 600).await.expect("answers");
    assert_eq!(series.points.len(), 4);
    let recomputed = store.recompute(1).await.expect("answers").expect("exists");
    assert_eq!(recomputed.stages.len(), 2);
    testbed.stop().await;
}

#[tokio::test]
async fn nothing_is_acknowledged_while_database_file_is_moved() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    let run = RunId::random();
    agent.offer([generate::run_started(run, "line", generate::at(0.0))]);
    agent.until_stored().await;
    let moved = testbed.database.with_extension("away");
    std::fs::rename(&testbed.database, &moved).expect("moves");
    // The move is detected although nothing is to be stored.
    agent
        .until("the missing file is detected", |_| {
            testbed.aggregator().current_readiness() != Readiness::Ready
        })
        .await;
    let Readiness::NotStoring(reason) = testbed.aggregator().current_readiness() else {
        panic!("not storing")
    };
    assert!(reason.contains("deleted, moved or replaced") && reason.contains("put it back"), "{reason}");
    let mut numbers = generate::Numbers::new(3);
    let hosts = (agent.id, HostId::from_bytes([7; 16]));
    agent.offer((1..=50).map(|n| Event::Iteration(generate::iteration(run, n, hosts, &mut numbers))));
    agent.sending.flush(testbed.clock.wall());
    // While the file is in its place, an acknowledgement arrives within a small part of this time.
    let exchange_until = testbed.clock.mono() + Span::from_seconds(1);
    agent.until("a second has passed", |_| testbed.clock.mono() >= exchange_until).await;
    assert_eq!((agent.accounting().stored, agent.accounting().waiting), (1, 50));

    std::fs::rename(&moved, &testbed.database).expect("moves back");
    agent.until_stored().await;
    assert_eq!(testbed.aggregator().current_readiness(), Readiness::Ready);
    assert_eq!(testbed.count("SELECT ok FROM run").await, 50);
    testbed.stop().await;
}

#[tokio::test]
async fn unnamed_run_gets_name_from_live_lane() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    let run = RunId::random();
    let mut numbers = generate::Numbers::new(3);
    let hosts = (agent.id, HostId::from_bytes([7; 16]));
    agent.offer((4..=9).map(|n| Event::Iteration(generate::iteration(run, n, hosts, &mut numbers))));
    agent.until_stored().await;
    // The run has no name yet, and the aggregator knows this after a restart, too.
    assert_eq!(testbed.count("SELECT count(*) FROM run WHERE model = 'unknown'").await, 1);
    testbed.stop().await;
    testbed.start().await;
    agent.until_up().await;
    let mut new_process =
        crate::agent::Agent::with_id(agent.id, "edge", &testbed.address, &testbed.clock).await;
    drop(agent);
    new_process.until_up().await;
    let second = testbed.clock.wall().unix_seconds();
    new_process.live(vec![crate::lanes::live(run, second, &[0.020])]).await;
    new_process.offer([Event::Iteration(generate::iteration(run, 10, hosts, &mut numbers))]);
    new_process.until_stored().await;
    assert_eq!(
        testbed
            .count(
                "SELECT count(*) FROM run_list WHERE pipeline = 'line' AND placement = 'remote' AND ok = 7"
            )
            .await,
        1
    );
    let snapshot = testbed
        .snapshot("the events of both processes", |snapshot| {
            snapshot.hosts.first().is_some_and(|host| host.stored.events == 7)
        })
        .await;
    assert_eq!(snapshot.hosts.len(), 1);
    testbed.stop().await;
}
