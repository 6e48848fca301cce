//! Tests of the cloud's state machine: single steps, and arbitrary steps of many edges.

use std::collections::HashSet;

use peernet_clock::ClockIdentity;
use peernet_logger::HostId;
use peernet_stream::Hardware;
use proptest::prelude::*;

use super::*;
use crate::message::{Departure, SampleHeader, strategies};

fn peer(connection: u64) -> Peer {
    Peer { connection: ConnectionId(connection), address: None }
}

fn hello() -> Header {
    let hello = SessionHello {
        versions: SESSION_VERSIONS,
        host: HostId::from_bytes([1; 16]),
        name: "edge".parse().expect("a name"),
        clock: ClockIdentity::new("b", "c"),
        pipeline: "p".parse().expect("a name"),
        model: Some("m".parse().expect("a name")),
        device: None,
        clock_socket: None,
    };
    Header::Open(Box::new(Open { hello, max_message_bytes: 1_000 }))
}

fn accepted() -> SessionAccepted {
    SessionAccepted {
        host: HostId::from_bytes([2; 16]),
        name: "cloud".parse().expect("a name"),
        clock: ClockIdentity::new("b", "c"),
        version: String::new(),
        model: "m".parse().expect("a name"),
        device: String::new(),
        facts: Vec::new(),
        host_clock: PeerClock::default(),
        probes: None,
        instance: 1,
        probe_key: None,
        conditions: Vec::new(),
        hardware: Hardware::default(),
    }
}

fn request(session: SessionId, request: u64) -> Header {
    let departure = Departure {
        sent: Default::default(),
        sent_since_anchor: Default::default(),
        epoch: 0,
        sent_raw: None,
    };
    let sample = SampleHeader { parts: Vec::new(), source: String::new(), label: None };
    Header::Request(Request { session, request, departure, sample })
}

fn server() -> Server {
    Server::new(&SessionSettings { max_sessions: 6, max_in_flight: 2, ..SessionSettings::default() })
}

fn open_session(server: &mut Server, connection: u64) -> SessionId {
    match server.receive(&peer(connection), hello()) {
        EdgeMessageEffect::Open(session, _) => session,
        other => panic!("{other:?}"),
    }
}

#[test]
fn answer_is_routed_once_to_the_requesting_connection() {
    let mut server = server();
    let session = open_session(&mut server, 5);
    assert!(
        matches!(server.receive(&peer(5), request(session, 0)), EdgeMessageEffect::Malformed(_)),
        "the session is not accepted yet"
    );
    let (to, header) = server.accept(session, accepted()).expect("the edge is there");
    assert_eq!(to.connection, ConnectionId(5));
    assert!(matches!(header, Header::Accepted(accepted) if accepted.session == session));
    assert!(matches!(server.receive(&peer(5), request(session, 7)), EdgeMessageEffect::Request(_)));
    assert!(
        matches!(server.receive(&peer(5), request(session, 7)), EdgeMessageEffect::Malformed(_)),
        "the request is in flight already"
    );
    let route = server.finish_request(session, 7);
    let FinishedRequest::Send(route, _) = route else { panic!("{route:?}") };
    assert_eq!((route.peer.connection, route.max_message_bytes), (ConnectionId(5), 1_000));
    assert!(matches!(server.finish_request(session, 7), FinishedRequest::Unknown));
}

#[test]
fn cancelled_request_needs_no_answer() {
    let mut server = server();
    let session = open_session(&mut server, 5);
    server.accept(session, accepted()).expect("the edge is there");
    assert!(matches!(server.receive(&peer(5), request(session, 7)), EdgeMessageEffect::Request(_)));
    let control = server.request_control(session, 7).expect("in flight");
    let cancel = |request| Header::Cancel(Cancel { session, request });
    assert!(
        matches!(
            server.receive(&peer(6), cancel(7)),
            EdgeMessageEffect::AnswerWith(Header::UnknownSession(_))
        ),
        "only the connection of the session may cancel the request"
    );
    assert!(!control.is_cancelled());
    assert_eq!(server.receive(&peer(5), cancel(7)), EdgeMessageEffect::Handled);
    assert!(control.is_cancelled());
    assert!(matches!(server.finish_request(session, 7), FinishedRequest::Cancelled));
    assert_eq!(
        server.receive(&peer(5), cancel(7)),
        EdgeMessageEffect::Handled,
        "the request has ended already"
    );
}

#[test]
fn end_of_session_cancels_its_requests() {
    let mut server = server();
    let session = open_session(&mut server, 5);
    server.accept(session, accepted()).expect("the edge is there");
    server.receive(&peer(5), request(session, 7));
    let control = server.request_control(session, 7).expect("in flight");
    assert_eq!(server.remove_connection(ConnectionId(5)), [session]);
    assert!(control.is_cancelled());
}

#[test]
fn refused_session_is_unknown() {
    let mut server = server();
    let session = open_session(&mut server, 1);
    let (_, header) = server.refuse(session, "no".into()).expect("the edge is there");
    assert!(matches!(header, Header::Refused(refused) if refused.reason == "no"));
    assert!(server.accept(session, accepted()).is_none() && server.refuse(session, "no".into()).is_none());
    assert!(matches!(
        server.receive(&peer(1), request(session, 0)),
        EdgeMessageEffect::AnswerWith(Header::UnknownSession(_))
    ));
}

#[test]
fn goodbye_from_own_connection_frees_session() {
    let mut server = server();
    let sessions: Vec<_> = (0..3).map(|connection| open_session(&mut server, connection)).collect();
    assert!(matches!(server.receive(&peer(9), hello()), EdgeMessageEffect::AnswerWith(Header::Refused(_))));
    let bye =
        |session| Header::Goodbye(Goodbye { session, reason: String::new(), planned_iterations: Some(9) });
    assert!(
        matches!(server.receive(&peer(1), bye(sessions[0])), EdgeMessageEffect::Malformed(_)),
        "a goodbye from another connection"
    );
    assert_eq!(server.receive(&peer(0), bye(sessions[0])), EdgeMessageEffect::Closed(sessions[0], Some(9)));
    open_session(&mut server, 9);
}

#[test]
fn session_limit_per_connection_is_named_in_refusal() {
    let mut server = Server::new(&SessionSettings::default());
    for _ in 0..SESSIONS_PER_CONNECTION {
        open_session(&mut server, 1);
    }
    let EdgeMessageEffect::AnswerWith(Header::Refused(refused)) = server.receive(&peer(1), hello()) else {
        panic!("the session exceeds the limit")
    };
    assert!(
        refused.reason.contains("this connection") && !refused.reason.contains("max_sessions"),
        "{refused:?}"
    );
    open_session(&mut server, 2);
}

#[test]
fn session_limit_per_host_leaves_room_for_other_hosts() {
    let mut server = Server::new(&SessionSettings::default());
    let mut opened_count = |host: u8, connections: std::ops::Range<u64>| {
        let Header::Open(open) = hello() else { unreachable!("a hello is an open") };
        let mut accepts = |connection| {
            let mut open = open.clone();
            open.hello.host = HostId::from_bytes([host; 16]);
            matches!(server.receive(&peer(connection), Header::Open(open)), EdgeMessageEffect::Open(..))
        };
        connections.filter(|connection| accepts(*connection)).count()
    };
    // A host may have half of the 256 sessions that other hosts do not use: 128 of 256, then 64 of 128.
    assert_eq!([opened_count(1, 0..256), opened_count(2, 256..512), opened_count(3, 512..514)], [128, 64, 2]);
}

#[test]
fn session_limit_per_address_counts_all_hosts_of_address() {
    let mut server = Server::new(&SessionSettings::default());
    let mut open = |address: &str, host: u16| {
        let Header::Open(mut open) = hello() else { unreachable!("a hello is an open") };
        let mut id = [0; 16];
        id[..2].copy_from_slice(&host.to_be_bytes());
        open.hello.host = HostId::from_bytes(id);
        let peer = Peer { connection: ConnectionId(u64::from(host)), address: address.parse().ok() };
        server.receive(&peer, Header::Open(open))
    };
    let opened_count =
        (0..300).filter(|host| matches!(open("192.0.2.1:5", *host), EdgeMessageEffect::Open(..))).count();
    // An address may have three quarters of the 256 sessions.
    assert_eq!(opened_count, 192);
    let EdgeMessageEffect::AnswerWith(Header::Refused(refused)) = open("192.0.2.1:5", 301) else {
        panic!("the session exceeds the limit")
    };
    assert!(refused.reason.contains("max_sessions is 256"), "{refused:?}");
    assert!(matches!(open("192.0.2.2:5", 302), EdgeMessageEffect::Open(..)));
}

#[test]
fn end_of_connection_ends_only_its_sessions() {
    let mut server = server();
    let (a, b, c) =
        (open_session(&mut server, 1), open_session(&mut server, 2), open_session(&mut server, 1));
    assert_eq!(server.remove_connection(ConnectionId(1)), [a, c]);
    assert_eq!(server.remove_connection(ConnectionId(1)), []);
    assert!(server.accept(a, accepted()).is_none());
    assert!(server.accept(b, accepted()).is_some());
    let goodbyes = server.end_all_sessions("bye");
    assert!(
        matches!(&goodbyes[..], [(to, Header::Goodbye(bye))] if to.connection.0 == 2 && bye.session == b)
    );
}

#[test]
fn clock_announcement_reaches_open_and_later_sessions() {
    let mut server = server();
    let (open, requested) = (open_session(&mut server, 1), open_session(&mut server, 2));
    server.accept(open, accepted()).expect("the edge is there");
    let clock = PeerClock { epoch: 3, ..PeerClock::default() };
    let headers = server.update_clock(clock.clone());
    assert!(matches!(
        &headers[..],
        [(to, Header::Clock(update))] if to.connection.0 == 1 && update.session == open && update.clock == clock
    ));
    let (_, header) = server.accept(requested, accepted()).expect("the edge is there");
    assert!(matches!(header, Header::Accepted(acceptance) if acceptance.accepted.host_clock == clock));
}

#[derive(Clone, Debug)]
enum Step {
    Open(u64),
    /// Any message on a connection. It names the session at this index of all sessions that were opened so far.
    Receive(u64, prop::sample::Index, Box<Header>),
    Request(u64, prop::sample::Index, u64),
    Accept(prop::sample::Index),
    Refuse(prop::sample::Index),
    Finish(prop::sample::Index, u64),
    CloseConnection(u64),
}

fn step() -> impl Strategy<Value = Step> {
    let connection = || 0..4_u64;
    let session = any::<prop::sample::Index>;
    prop_oneof![
        4 => connection().prop_map(Step::Open),
        2 => (connection(), session(), strategies::header(Vec::new()))
            .prop_map(|(connection, session, header)| Step::Receive(connection, session, Box::new(header))),
        8 => (connection(), session(), 0..4_u64).prop_map(|(c, s, n)| Step::Request(c, s, n)),
        4 => session().prop_map(Step::Accept),
        1 => session().prop_map(Step::Refuse),
        6 => (session(), 0..4_u64).prop_map(|(s, n)| Step::Finish(s, n)),
        1 => connection().prop_map(Step::CloseConnection),
    ]
}

/// Returns the message with another session id.
fn with_session(mut header: Header, session: SessionId) -> Header {
    match &mut header {
        Header::Request(request) => request.session = session,
        Header::Reply(reply) => reply.session = session,
        Header::PartialReply(partial_answer) => partial_answer.session = session,
        Header::PartialAnswersRead(read) => read.session = session,
        Header::Cancel(cancel) => cancel.session = session,
        Header::Clock(update) => update.session = session,
        Header::Statistics(report) => report.session = session,
        Header::UnknownSession(unknown) => unknown.session = session,
        Header::Goodbye(goodbye) => goodbye.session = session,
        Header::Accepted(accepted) => accepted.session = session,
        Header::Open(_) | Header::Refused(_) => {}
    }
    header
}

proptest! {
    #[test]
    fn limits_hold_and_requests_end_once_for_any_messages(steps in proptest::collection::vec(step(), 0..120)) {
        let mut server = server();
        let mut sessions = vec![SessionId::random()];
        let (mut in_flight, mut cancelled) = (HashSet::new(), HashSet::new());
        for step in steps {
            match step {
                Step::Open(connection) => {
                    if let EdgeMessageEffect::Open(session, _) = server.receive(&peer(connection), hello()) {
                        prop_assert!(!sessions.contains(&session));
                        sessions.push(session);
                    }
                }
                Step::Receive(connection, session, header) => {
                    let header = with_session(*header, *session.get(&sessions));
                    let cancelled_request = match &header {
                        Header::Cancel(cancel) => Some((cancel.session, cancel.request)),
                        _ => None,
                    };
                    match server.receive(&peer(connection), header) {
                        EdgeMessageEffect::Open(session, _) => sessions.push(session),
                        EdgeMessageEffect::Request(request) => {
                            prop_assert!(in_flight.insert((request.session, request.request)));
                        }
                        EdgeMessageEffect::Closed(session, _) => {
                            in_flight.retain(|(request_session, _)| *request_session != session);
                        }
                        EdgeMessageEffect::Handled => {
                            cancelled.extend(cancelled_request.filter(|key| in_flight.contains(key)));
                        }
                        EdgeMessageEffect::AnswerWith(_) | EdgeMessageEffect::Malformed(_) => {}
                    }
                }
                Step::Request(connection, session, number) => {
                    let session = *session.get(&sessions);
                    let effect = server.receive(&peer(connection), request(session, number));
                    if let EdgeMessageEffect::Request(_) = effect {
                        prop_assert!(in_flight.insert((session, number)));
                    }
                }
                Step::Accept(session) => drop(server.accept(*session.get(&sessions), accepted())),
                Step::Refuse(session) => {
                    let session = *session.get(&sessions);
                    drop(server.refuse(session, String::new()));
                    in_flight.retain(|(request_session, _)| *request_session != session);
                }
                Step::Finish(session, number) => {
                    let session = *session.get(&sessions);
                    let key = (session, number);
                    let expected = match (in_flight.remove(&key), cancelled.remove(&key)) {
                        (true, false) => "send",
                        (true, true) => "cancelled",
                        (false, _) => "unknown",
                    };
                    let finished = match server.finish_request(session, number) {
                        FinishedRequest::Send(..) => "send",
                        FinishedRequest::Cancelled => "cancelled",
                        FinishedRequest::Unknown => "unknown",
                    };
                    prop_assert_eq!(finished, expected);
                }
                Step::CloseConnection(connection) => {
                    for session in server.remove_connection(ConnectionId(connection)) {
                        in_flight.retain(|(request_session, _)| *request_session != session);
                    }
                }
            }
            prop_assert_eq!(server.in_flight_count(), in_flight.len());
            prop_assert!(server.sessions.len() <= 6);
            let host_sessions = server.sessions.values().filter(|entry| entry.host == HostId::from_bytes([1; 16])).count();
            prop_assert!(host_sessions <= 3, "one host has at most half of the sessions");
            prop_assert!(server.sessions.values().all(|entry| entry.in_flight.0.len() <= 2));
            let listed_sessions: usize = server.connections.values().map(Vec::len).sum();
            prop_assert_eq!(listed_sessions, server.sessions.len());
        }
    }
}
