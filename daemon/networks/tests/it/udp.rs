//! Tests of `zmq-udp`: lost, duplicated and reordered datagrams, packets of other programs, large messages.

use std::time::Duration;

use bytes::Bytes;
use peernet_clock::Span;
use peernet_networks::{CloseReason, Incoming, PARTS, PARTS_SENT, RequestError, Session, SessionSettings};
use peernet_sample::{Description, Sample};
use peernet_stream::DirectionStatistics;
use tokio::net::UdpSocket;
use tokio::task::JoinSet;

use crate::support::{
    Cloud, TIME_LIMIT, TestNetwork, accepted, echo, hello, open, recorder, request, settings, within,
};
use crate::udp_relay::{PathImpairment, UdpRelay};

fn payload(size: usize, seed: usize) -> Bytes {
    (0..size).map(|i| (i * 7 + seed) as u8).collect::<Vec<u8>>().into()
}

fn sample_of(bytes: Bytes) -> Sample {
    Sample::from_part(Description::bytes(), bytes)
}

/// Answers every request with its own sample, in a separate task.
fn echo_all(mut cloud: Cloud) -> tokio::task::JoinHandle<()> {
    tokio::spawn(async move {
        while let Some(incoming) = cloud.listener.next().await {
            match incoming {
                Incoming::Open(open) => assert!(open.accept(accepted(cloud.host))),
                Incoming::Request(request) => request.reply.send(request.recorder, Ok(request.sample)),
                _ => {}
            }
        }
    })
}

/// Sends samples of these sizes, at most `max_parallel` at a time. Returns the numbers of answered and lost samples.
/// Panics for any other outcome.
async fn exchange_all(session: &Session, sizes: Vec<usize>, max_parallel: usize) -> (usize, usize) {
    let permits = std::sync::Arc::new(tokio::sync::Semaphore::new(max_parallel));
    let mut tasks = JoinSet::new();
    for (number, size) in sizes.into_iter().enumerate() {
        let (session, permits) = (session.clone(), permits.clone());
        tasks.spawn(async move {
            let _permit = permits.acquire().await.expect("open");
            let request = sample_of(payload(size, number));
            let completed = session.request(recorder(), &request, TIME_LIMIT).await;
            match completed.result {
                Ok(answer) => {
                    assert_eq!(answer, request);
                    true
                }
                Err(RequestError::Lost(reason)) => {
                    assert!(reason.contains("on the way") && reason.contains("arrived"), "{reason}");
                    false
                }
                Err(other) => panic!("{other}"),
            }
        });
    }
    let outcomes = tokio::time::timeout(4 * TIME_LIMIT, tasks.join_all()).await.expect("the test hangs");
    let answered = outcomes.iter().filter(|answered| **answered).count();
    (answered, outcomes.len() - answered)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn payloads_of_all_sizes_come_back_whole() {
    let cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let address = cloud.address();
    let _echo = echo_all(cloud);
    for datagram_bytes in [1_200, 8_192] {
        let settings = SessionSettings { datagram_bytes, ..settings() };
        let session = open(&address, hello(), settings).await.expect("accepted");
        let sizes = vec![0, 1, 1_000, 60_000, 1_200_000, 20_000_000];
        let (answered, lost) = exchange_all(&session, sizes, 1).await;
        // Loopback drops nothing while the socket's buffer has room for the bytes in flight.
        assert_eq!((answered, lost), (6, 0), "{datagram_bytes}");
        within(session.close()).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_request_is_answered_or_lost() {
    let cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let impairment = PathImpairment { loss: 2, duplication: 2, delay: 5 };
    let relay = UdpRelay::start(&cloud.address(), impairment, 2_026).await;
    let _echo = echo_all(cloud);
    let session = open(&relay.address, hello(), settings()).await.expect("accepted");
    let sizes = (0..300).map(|number| [0, 1, 1_000, 20_000][number % 4]).collect();
    let (answered, lost) = exchange_all(&session, sizes, 8).await;
    assert_eq!(answered + lost, 300);
    assert!(answered > 150 && lost > 10, "{answered} answered, {lost} lost");
    let statistics = session.statistics();
    assert_eq!((statistics.lost_messages, statistics.late_messages), (lost as u64, 0));
    within(session.close()).await;
    assert_eq!(within(session.closed()).await, CloseReason::Local);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn datagrams_of_both_directions_are_counted() {
    let cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let impairment = PathImpairment { loss: 3, duplication: 3, delay: 10 };
    let relay = UdpRelay::start(&cloud.address(), impairment, 77).await;
    let _echo = echo_all(cloud);
    let session = open(&relay.address, hello(), settings()).await.expect("accepted");
    let addresses = session.statistics_reader().addresses().expect("the connection has addresses");
    assert!(addresses.local.ip().is_loopback() && addresses.remote.to_string() == relay.address.authority());
    let (answered, _) = exchange_all(&session, vec![10_000; 200], 4).await;
    assert!(answered > 0);
    // The receiver counts a datagram as lost after one to two seconds, and reports the count in its next heartbeat.
    let is_counted = |direction: &DirectionStatistics| {
        [direction.lost, direction.duplicated, direction.reordered].iter().all(|count| *count > Some(5))
    };
    let mut ticks = tokio::time::interval(Duration::from_millis(50));
    let counting = tokio::time::timeout(TIME_LIMIT, async {
        loop {
            ticks.tick().await;
            let statistics = session.statistics();
            if is_counted(&statistics.sent) && is_counted(&statistics.received) {
                return statistics;
            }
        }
    });
    let Ok(statistics) = counting.await else { panic!("never counted: {:?}", session.statistics()) };
    // 200 messages of nine datagrams, and the hello.
    let sent = statistics.sent.datagrams.expect("this end sends them");
    assert!((1_801..2_000).contains(&sent), "{statistics:?}");
    assert!(
        statistics.sent.lost < Some(sent / 10) && statistics.received.lost < statistics.received.datagrams,
        "{statistics:?}"
    );
    assert_eq!((statistics.sent.retransmitted.is_some(), statistics.received.retransmitted), (true, None));
    let trip = statistics.round_trip.expect("heartbeats were answered");
    assert!(trip.min <= Some(trip.smoothed) && trip.smoothed < Span::from_seconds(1), "{trip:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn lost_partial_answer_is_counted_by_cloud_only() {
    let mut cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let relay = UdpRelay::start(&cloud.address(), PathImpairment::default(), 1).await;
    let opening = tokio::spawn({
        let address = relay.address.clone();
        async move { open(&address, hello(), settings()).await.expect("accepted") }
    });
    cloud.next_open().await.accept(accepted(cloud.host));
    let session = within(opening).await.expect("no panic");
    let pending = request(&session, "count", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    relay.cut();
    // A partial answer of this size is not sent again.
    assert_eq!(incoming.partial_answers.send(&sample_of(payload(200_000, 2))), Ok(()));
    // Ten datagrams are more than the heartbeats in this time, so the relay has dropped datagrams of the partial
    // answer.
    within(relay.wait_for_drops(10)).await;
    relay.restore();
    incoming.reply.send(incoming.recorder, Ok(incoming.sample));
    let completed = within(pending).await.expect("no panic");
    let count = |name: &str| completed.recorder.tree().find(&[name])?.1.measure.value();
    assert!(completed.result.is_ok(), "{:?}", completed.result);
    assert_eq!((count(PARTS.as_str()), count(PARTS_SENT.as_str())), (None, Some(1.0)));
}

#[tokio::test]
async fn interrupted_path_ends_session_and_next_session_works() {
    let mut cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let relay = UdpRelay::start(&cloud.address(), PathImpairment::default(), 1).await;
    let short_heartbeats =
        SessionSettings { heartbeat_interval_ms: 50, heartbeat_timeout_ms: 200, ..settings() };
    let edge = tokio::spawn({
        let (address, short_heartbeats) = (relay.address.clone(), short_heartbeats.clone());
        async move { open(&address, hello(), short_heartbeats).await }
    });
    cloud.next_open().await.accept(accepted(cloud.host));
    let session = within(edge).await.expect("no panic").expect("accepted");
    echo(&mut cloud, &session, "the path works").await;
    let pending = request(&session, "the path is cut", TIME_LIMIT);
    let _unanswered = cloud.next_request().await;
    relay.cut();
    let completed = within(pending).await.expect("no panic");
    assert!(matches!(completed.result, Err(RequestError::Lost(_))), "{:?}", completed.result);
    assert!(matches!(within(session.closed()).await, CloseReason::Broken(_)));
    relay.restore();
    let edge = tokio::spawn({
        let address = relay.address.clone();
        async move { open(&address, hello(), short_heartbeats).await }
    });
    loop {
        match cloud.next().await {
            Incoming::Open(open_request) => break assert!(open_request.accept(accepted(cloud.host))),
            Incoming::Closed { .. } => {}
            other => panic!("{other:?}"),
        }
    }
    let session = within(edge).await.expect("no panic").expect("accepted");
    let pending = request(&session, "again", TIME_LIMIT);
    loop {
        match cloud.next().await {
            Incoming::Request(request) => break request.reply.send(request.recorder, Ok(request.sample)),
            Incoming::Closed { .. } => {}
            other => panic!("{other:?}"),
        }
    }
    assert!(within(pending).await.expect("no panic").result.is_ok());
}

#[tokio::test]
async fn next_request_notices_restarted_cloud() {
    let mut cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let relay = UdpRelay::start(&cloud.address(), PathImpairment::default(), 1).await;
    let edge = tokio::spawn({
        let address = relay.address.clone();
        async move { open(&address, hello(), settings()).await }
    });
    cloud.next_open().await.accept(accepted(cloud.host));
    let session = within(edge).await.expect("no panic").expect("accepted");
    // The relay does not pass on the goodbye of the old cloud.
    relay.cut();
    let address = cloud.address();
    drop(cloud);
    within(relay.wait_for_drops(1)).await;
    within(async {
        while std::net::UdpSocket::bind(address.authority()).is_err() {
            tokio::task::yield_now().await;
        }
    })
    .await;
    let _cloud = Cloud::start_at(&address.to_string(), settings()).await;
    relay.restore();
    let completed = within(request(&session, "who are you?", TIME_LIMIT)).await.expect("no panic");
    let Err(RequestError::Lost(reason)) = completed.result else { panic!("{:?}", completed.result) };
    assert!(reason.contains("restarted"), "{reason}");
}

#[tokio::test]
async fn garbage_is_counted_and_changes_no_session() {
    let mut cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let (session, _) = cloud.session(settings()).await;
    let other_socket = UdpSocket::bind("127.0.0.1:0").await.expect("a free port");
    other_socket.connect(cloud.address().authority()).await.expect("an address");
    let mut sent = 0;
    for bytes in [&b""[..], b"\x07peernet", b"\x07peernet\x05", b"\x03abcdef", &[0xff; 1_200]] {
        for _ in 0..20 {
            other_socket.send(bytes).await.expect("sent");
            sent += 1;
        }
    }
    echo(&mut cloud, &session, "all is well").await;
    assert_eq!(cloud.listener.statistics().malformed_messages, sent);
}

#[tokio::test]
async fn no_request_is_lost_after_altered_heartbeat() {
    let mut cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let relay = UdpRelay::start(&cloud.address(), PathImpairment::default(), 1).await;
    let short_heartbeats = SessionSettings { heartbeat_interval_ms: 50, ..settings() };
    let edge = tokio::spawn({
        let address = relay.address.clone();
        async move { open(&address, hello(), short_heartbeats).await }
    });
    cloud.next_open().await.accept(accepted(cloud.host));
    let session = within(edge).await.expect("no panic").expect("accepted");
    for _ in 0..3 {
        echo(&mut cloud, &session, "before").await;
        within(relay.alter_heartbeat()).await;
        for _ in 0..5 {
            echo(&mut cloud, &session, "after").await;
        }
    }
    assert_eq!(cloud.listener.statistics().malformed_messages, 3);
    let statistics = session.statistics();
    assert_eq!((statistics.lost_messages, statistics.malformed_messages), (0, 0));
}

#[tokio::test]
async fn reason_of_loss_names_damaged_datagrams() {
    let mut cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let relay = UdpRelay::start(&cloud.address(), PathImpairment::default(), 1).await;
    let edge = tokio::spawn({
        let address = relay.address.clone();
        async move { open(&address, hello(), settings()).await }
    });
    cloud.next_open().await.accept(accepted(cloud.host));
    let session = within(edge).await.expect("no panic").expect("accepted");
    relay.alter_fragment();
    let pending = tokio::spawn({
        let session = session.clone();
        async move { session.request(recorder(), &sample_of(payload(60_000, 1)), TIME_LIMIT).await }
    });
    let completed = tokio::select! {
        completed = within(pending) => completed.expect("no panic"),
        incoming = cloud.next() => panic!("unexpected {incoming:?}"),
    };
    let Err(RequestError::Lost(reason)) = completed.result else { panic!("{:?}", completed.result) };
    assert!(reason.contains("all of its ") && reason.contains("damaged (wrong checksum)"), "{reason}");
}

#[tokio::test]
async fn small_socket_buffers_leave_requests_answered_or_lost() {
    let small_buffers = SessionSettings { socket_buffer_bytes: 64 << 10, ..settings() };
    let cloud = Cloud::start_at("udp://127.0.0.1:0", small_buffers.clone()).await;
    let address = cloud.address();
    let _echo = echo_all(cloud);
    let session = open(&address, hello(), small_buffers).await.expect("accepted");
    // `exchange_all` panics if a request is neither answered nor lost.
    let (answered, lost) = exchange_all(&session, vec![300_000; 20], 4).await;
    assert!(answered > 0, "{lost} lost");
}

#[tokio::test]
async fn configured_rate_is_not_exceeded() {
    let cloud = Cloud::on_network(TestNetwork::ZmqUdp).await;
    let address = cloud.address();
    let _echo = echo_all(cloud);
    let limited_rate = SessionSettings { max_send_bits_per_second: 8_000_000, ..settings() };
    let session = open(&address, hello(), limited_rate).await.expect("accepted");
    let started_at = tokio::time::Instant::now();
    let completed = within(session.request(recorder(), &sample_of(payload(300_000, 1)), TIME_LIMIT)).await;
    assert!(completed.result.is_ok(), "{:?}", completed.result);
    let duration = started_at.elapsed();
    assert!(duration >= Duration::from_millis(290), "300 kB at 1 MB/s took {duration:?}");
}
