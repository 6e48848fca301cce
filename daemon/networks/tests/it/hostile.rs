//! Tests with peers that send arbitrary data to the port.

use bytes::Bytes;
use peernet_clock::{Span, WallTime};
use peernet_logger::{
    Anchor, HostId, HostIndex, Measure, Node, NodeId, Tree, TreeDelta, stage, wire as logger,
};
use peernet_networks::{CloseReason, Incoming, RequestError, SessionSettings};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use zeromq::Options;

use crate::fake_cloud::FakeCloud;
use crate::support::{Cloud, TIME_LIMIT, accepted, echo, recorder, request, sample, settings, within};
use crate::wire::{self, Header, Id, Outcome, PROTOCOL, PlainSocket};

/// Epoch of the cloud at the arrival of a request.
const ARRIVAL_EPOCH: u32 = 0;

fn tree() -> Bytes {
    let anchor = Anchor { host: HostId::random(), wall: WallTime::default() };
    let mut out = Vec::new();
    logger::encode(&Tree::new(stage::ITERATION, anchor), &mut out);
    out.into()
}

/// Returns the header of a request whose sample has `part_count` payload parts.
fn plain_request(session: &Id, number: u64, part_count: usize) -> Header {
    let parts = vec![("bytes".to_owned(), Vec::new(), None); part_count];
    Header::Request(session.clone(), number, wire::Departure(5, 5, 0, None), (parts, String::new(), None))
}

/// Opens a session over a plain socket.
pub(crate) async fn plain_session(cloud: &mut Cloud) -> (PlainSocket, Id) {
    let plain_socket = PlainSocket::dealer(&cloud.address(), Options::default()).await;
    plain_socket.send_message(&wire::open(PROTOCOL), Vec::new()).await;
    cloud.next_open().await.accept(accepted(cloud.host));
    match plain_socket.receive_message().await {
        (Header::Accepted { session, .. }, _) => (plain_socket, session),
        other => panic!("{other:?}"),
    }
}

/// Checks that the port serves a new session. Then waits until the listener has counted the `expected` malformed
/// messages, and checks that it has counted no more.
async fn check_malformed_count(cloud: &mut Cloud, expected: u64) {
    let (session, _) = cloud.session(settings()).await;
    echo(cloud, &session, "the port still serves").await;
    within(session.close()).await;
    within(async {
        while cloud.listener.statistics().malformed_messages < expected {
            tokio::select! {
                incoming = cloud.listener.next() => assert!(matches!(incoming, Some(Incoming::Closed { .. }))),
                () = tokio::task::yield_now() => {}
            }
        }
    })
    .await;
    assert_eq!(cloud.listener.statistics().malformed_messages, expected);
}

#[tokio::test]
async fn plain_zeromq_socket_is_served_as_edge() {
    let mut cloud = Cloud::start().await;
    let (plain_socket, session) = plain_session(&mut cloud).await;
    plain_socket.send_message(&plain_request(&session, 7, 1), vec![tree(), "payload".into()]).await;
    let incoming = cloud.next_request().await;
    assert_eq!(incoming.sample.parts[0].bytes, "payload");
    incoming.reply.send(incoming.recorder, Ok(sample("answer")));
    let (header, frames) = plain_socket.receive_message().await;
    assert!(
        matches!(header, Header::Reply(s, 7, Some(_), ARRIVAL_EPOCH, Outcome::Answer(_)) if s == session)
    );
    assert_eq!((frames.len(), &frames[1]), (2, &Bytes::from("answer")));
}

#[tokio::test]
async fn bytes_that_are_not_zmtp_are_dropped_and_counted() {
    let mut cloud = Cloud::start().await;
    let address = (cloud.address().host(), cloud.address().port());
    for garbage in
        [&b"GET / HTTP/1.1\r\nHost: cloud\r\nAccept: */*\r\nUser-Agent: curl/8.0\r\n\r\n"[..], &[0xff; 4096]]
    {
        let mut stream = TcpStream::connect(address.clone()).await.expect("the port is open");
        stream.write_all(garbage).await.expect("sent");
        // Reads until the listener closes the connection, with or without a reset.
        let _ = within(stream.read_to_end(&mut Vec::new())).await;
    }
    check_malformed_count(&mut cloud, 2).await;
}

#[tokio::test]
async fn frames_that_are_no_message_are_dropped_and_counted() {
    let mut cloud = Cloud::start().await;
    let (plain_socket, session) = plain_session(&mut cloud).await;
    let garbage: Vec<Vec<Bytes>> = vec![
        vec![Bytes::new()],
        vec!["hello".into()],
        vec![vec![0xff; 100].into(), vec![0; 100].into()],
        // A map and an array that claim four billion entries.
        vec![Bytes::from_static(&[0xdf, 0xff, 0xff, 0xff, 0xff])],
        vec![Bytes::from_static(&[0xdd, 0xff, 0xff, 0xff, 0xff])],
        vec![vec![0x91; 60_000].into()],
        vec![vec![0xc0; 70_000].into()],
        vec![Bytes::new(); 100],
    ];
    let mut expected = garbage.len() as u64;
    for frames in garbage {
        plain_socket.send_frames(frames).await;
    }
    let misplaced_headers = [
        Header::Refused {
            protocol: 1,
            newest: None,
            since: None,
            kind: "refused".into(),
            reason: "me too".into(),
        },
        Header::Reply(session.clone(), 0, None, ARRIVAL_EPOCH, Outcome::Failed("no".into())),
        Header::Clock { session: session.clone(), clock: wire::host_clock(1) },
        Header::Goodbye { session: Id::from([9; 16]), reason: "whose?".into(), ordered: None },
    ];
    for header in &misplaced_headers {
        plain_socket.send_message(header, Vec::new()).await;
        expected += 1;
    }
    check_malformed_count(&mut cloud, expected).await;
}

#[tokio::test]
async fn invalid_requests_are_answered_as_failed() {
    let mut cloud = Cloud::start().await;
    let (plain_socket, session) = plain_session(&mut cloud).await;
    // Number of payload parts that the header describes, and the frames after the header.
    let cases: Vec<(usize, Vec<Bytes>)> = vec![
        (0, vec![]),
        (0, vec!["no tree".into()]),
        (0, vec![tree().slice(1..)]),
        (0, vec![tree().slice(..tree().len() - 1)]),
        (1, vec![tree()]),
        (0, vec![tree(), "not described".into()]),
        (1_000, vec![tree(), "too few".into()]),
    ];
    let count = cases.len() as u64;
    for (number, (part_count, frames)) in cases.into_iter().enumerate() {
        let number = number as u64;
        plain_socket.send_message(&plain_request(&session, number, part_count), frames).await;
        let (header, _) = tokio::select! {
            received = plain_socket.receive_message() => received,
            incoming = cloud.next() => panic!("the listener returned {incoming:?}"),
        };
        assert!(
            matches!(&header, Header::Reply(_, n, None, _, Outcome::Failed(_)) if *n == number),
            "{number}: {header:?}"
        );
    }
    check_malformed_count(&mut cloud, count).await;
}

#[tokio::test]
async fn session_of_another_connection_is_unknown() {
    let mut cloud = Cloud::start().await;
    let (_owner, session) = plain_session(&mut cloud).await;
    let (other_socket, _) = plain_session(&mut cloud).await;
    for (number, session) in [(3, session), (4, Id::from([7; 16]))] {
        other_socket.send_message(&plain_request(&session, number, 1), vec![tree(), "x".into()]).await;
        let (header, _) = tokio::select! {
            received = other_socket.receive_message() => received,
            incoming = cloud.next() => panic!("the listener returned {incoming:?}"),
        };
        assert!(
            matches!(&header, Header::UnknownSession { session: s, request } if *s == session && *request == number),
            "{header:?}"
        );
    }
}

#[tokio::test]
async fn requests_above_limit_are_answered_as_overload() {
    let two_in_flight = SessionSettings { max_in_flight: 2, ..settings() };
    let mut cloud = Cloud::start_at("tcp://127.0.0.1:0", two_in_flight).await;
    let (plain_socket, session) = plain_session(&mut cloud).await;
    for number in 0..3 {
        plain_socket.send_message(&plain_request(&session, number, 0), vec![tree()]).await;
    }
    let held_requests = [cloud.next_request().await, cloud.next_request().await];
    let (header, _) = tokio::select! {
        received = plain_socket.receive_message() => received,
        incoming = cloud.next() => panic!("the listener returned {incoming:?}"),
    };
    assert!(matches!(header, Header::Reply(_, 2, None, _, Outcome::Overloaded(_))), "{header:?}");
    drop(held_requests);
}

#[tokio::test]
async fn memory_of_all_requests_is_bounded() {
    let small_memory = SessionSettings { max_in_flight_bytes: 100_000, ..settings() };
    let mut cloud = Cloud::start_at("tcp://127.0.0.1:0", small_memory).await;
    let (first_socket, first_session) = plain_session(&mut cloud).await;
    let (second_socket, second_session) = plain_session(&mut cloud).await;
    let payload = || vec![tree(), Bytes::from(vec![1; 40_000])];
    let mut held_requests = Vec::new();
    for number in 0..2 {
        first_socket.send_message(&plain_request(&first_session, number, 1), payload()).await;
        held_requests.push(cloud.next_request().await);
    }
    second_socket.send_message(&plain_request(&second_session, 0, 1), payload()).await;
    let (header, _) = tokio::select! {
        received = second_socket.receive_message() => received,
        incoming = cloud.next() => panic!("the listener returned {incoming:?}"),
    };
    let Header::Reply(_, 0, None, _, Outcome::Overloaded(reason)) = header else { panic!("{header:?}") };
    assert!(reason.contains("max_in_flight_bytes, 100000"), "{reason}");
    // Requests that are answered make room, also for requests of other sessions.
    held_requests.clear();
    second_socket.send_message(&plain_request(&second_session, 1, 1), payload()).await;
    assert_eq!(cloud.next_request().await.sample.payload_bytes(), 40_000);
}

#[tokio::test]
async fn silent_connections_do_not_block_new_edges() {
    let mut cloud = Cloud::start().await;
    let address = (cloud.address().host(), cloud.address().port());
    let mut silent_connections = Vec::new();
    for _ in 0..300 {
        silent_connections.push(TcpStream::connect(address.clone()).await.expect("the port is open"));
    }
    let (session, _) = cloud.session(settings()).await;
    echo(&mut cloud, &session, "still served").await;
    // The connections are closed when the time limit for the handshake has passed.
    check_malformed_count(&mut cloud, 300).await;
    drop(silent_connections);
}

#[tokio::test]
async fn peer_that_chooses_its_routing_id_is_refused() {
    let mut cloud = Cloud::start().await;
    let plain_socket = PlainSocket::dealer(&cloud.address(), Options::default().identity("robot-1")).await;
    plain_socket.send_message(&wire::open(PROTOCOL), Vec::new()).await;
    check_malformed_count(&mut cloud, 1).await;
}

#[tokio::test]
async fn oversize_message_ends_only_its_connection() {
    let small_messages = SessionSettings { max_message_bytes: 100_000, ..settings() };
    let mut cloud = Cloud::start_at("tcp://127.0.0.1:0", small_messages).await;
    let (good_session, _) = cloud.session(settings()).await;
    let (plain_socket, session) = plain_session(&mut cloud).await;
    plain_socket.send_message(&plain_request(&session, 0, 1), vec![tree(), vec![0; 1_000_000].into()]).await;
    cloud.next_closed().await;
    echo(&mut cloud, &good_session, "not my fault").await;
}

#[tokio::test]
async fn session_unknown_to_cloud_ends() {
    let cloud = FakeCloud::start().await;
    let (session, edge_identity, id) = cloud.session().await;
    let pending = request(&session, "do you know me?", TIME_LIMIT);
    let (_, header) = cloud.receive_message().await;
    let Header::Request(_, number, ..) = header else { panic!("{header:?}") };
    cloud
        .send_message(&edge_identity, &Header::UnknownSession { session: id, request: number }, Vec::new())
        .await;
    let completed = within(pending).await.expect("no panic");
    assert!(matches!(completed.result, Err(RequestError::Lost(_))), "{:?}", completed.result);
    assert_eq!(within(session.closed()).await, CloseReason::UnknownSession);
}

/// Returns a delta with one node, for an edge's tree with the three nodes root, encode and upload. The valid delta of
/// the fake cloud is `delta(3, 2, 2, 1)`: based on three nodes, of host 2, closing node 2, with a node of the second
/// host of the tree.
fn delta(base: u32, host: u8, closed: u32, node_host: u8) -> Bytes {
    let anchor = Anchor { host: HostId::from_bytes([host; 16]), wall: WallTime::default() };
    let node = Node {
        parent: Some(NodeId::ROOT),
        name: stage::INFERENCE,
        host: HostIndex(node_host),
        start: Span::ZERO,
        measure: Measure::Timer(Some(Span::ZERO)),
    };
    let closed = (NodeId(closed), WallTime::default());
    let delta = TreeDelta { base, anchor, others: Vec::new(), closed, nodes: vec![node] };
    let mut out = Vec::new();
    logger::encode_tree_delta(&delta, &mut out);
    out.into()
}

#[tokio::test]
async fn invalid_answers_change_no_tree() {
    let cloud = FakeCloud::start().await;
    let (session, edge_identity, id) = cloud.session().await;
    let invalid_deltas = [
        Bytes::from("garbage"),
        // Another number of nodes, another host, another closed node, a node of the edge, a node of an unknown host.
        delta(2, 2, 2, 1),
        delta(3, 9, 2, 1),
        delta(3, 2, 1, 1),
        delta(3, 2, 2, 0),
        delta(3, 2, 2, 7),
    ];
    let count = invalid_deltas.len() as u64;
    for delta in invalid_deltas {
        let pending = request(&session, "x", TIME_LIMIT);
        let (_, header) = cloud.receive_message().await;
        let Header::Request(_, number, ..) = header else { panic!("{header:?}") };
        let answer = Outcome::Answer((Vec::new(), String::new(), None));
        cloud
            .send_message(
                &edge_identity,
                &Header::Reply(
                    id.clone(),
                    number,
                    Some(wire::Departure(1, 1, 0, None)),
                    ARRIVAL_EPOCH,
                    answer,
                ),
                vec![delta],
            )
            .await;
        let completed = within(pending).await.expect("no panic");
        assert!(matches!(completed.result, Err(RequestError::Failed(_))), "{:?}", completed.result);
        assert_eq!((completed.download, completed.recorder.tree().anchors().len()), (None, 1));
    }
    assert_eq!(session.statistics().malformed_messages, count);

    let error = wire::Interval { lo: 1, hi: 0 };
    let impossible_clock = wire::HostClock {
        claim: Some(wire::ClockClaim { source: "chrony".into(), error }),
        ..wire::host_clock(1)
    };
    // A reply to a request that was never sent, messages of other sessions, a second acceptance and an invalid clock
    // state do not affect the session.
    for header in [
        Header::Reply(id.clone(), 1_000, None, ARRIVAL_EPOCH, Outcome::Failed(String::new())),
        Header::Reply(Id::from([8; 16]), 0, None, ARRIVAL_EPOCH, Outcome::Failed(String::new())),
        FakeCloud::accepted(id.clone(), PROTOCOL),
        Header::Clock { session: Id::from([8; 16]), clock: wire::host_clock(1) },
        Header::Clock { session: id.clone(), clock: impossible_clock },
    ] {
        cloud.send_message(&edge_identity, &header, Vec::new()).await;
    }
    let pending = tokio::spawn({
        let session = session.clone();
        async move { session.request(recorder(), &sample("y"), TIME_LIMIT).await }
    });
    let (_, header) = cloud.receive_message().await;
    let Header::Request(_, number, ..) = header else { panic!("{header:?}") };
    let answer = Outcome::Answer((Vec::new(), String::new(), None));
    cloud
        .send_message(
            &edge_identity,
            &Header::Reply(id, number, Some(wire::Departure(1, 1, 0, None)), ARRIVAL_EPOCH, answer),
            vec![delta(3, 2, 2, 1)],
        )
        .await;
    assert!(within(pending).await.expect("no panic").result.is_ok());
    assert_eq!(session.statistics().malformed_messages, count + 5);
}

#[tokio::test]
async fn version_five_reply_without_raw_stamps_is_invalid() {
    let cloud = FakeCloud::start().await;
    let (session, edge_identity, id) = cloud.session_of_version(5).await;
    let pending = tokio::spawn({
        let session = session.clone();
        async move { session.request(recorder(), &sample("x"), TIME_LIMIT).await }
    });
    let (_, header) = cloud.receive_message().await;
    let Header::Request(_, number, ..) = header else { panic!("{header:?}") };
    let answer = Outcome::Answer((Vec::new(), String::new(), None));
    cloud
        .send_message(
            &edge_identity,
            &Header::Reply(id, number, Some(wire::Departure(1, 1, 0, None)), ARRIVAL_EPOCH, answer),
            vec![delta(3, 2, 2, 1)],
        )
        .await;
    let completed = within(pending).await.expect("no panic");
    let Err(RequestError::Failed(reason)) = completed.result else { panic!("{:?}", completed.result) };
    assert!(reason.contains("the stamps of the cloud's free-running clock are missing"), "{reason}");
    assert_eq!((completed.observation, session.statistics().malformed_messages), (None, 1));
}
