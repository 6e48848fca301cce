//! Tests of the proof that two processes read one clock, with real sockets.

use std::io::{ErrorKind, Read, Write};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{
    ClockFaults, ClockIdentity, FaultyClock, SharedClock, Span, SystemClock, time_namespace,
};
use peernet_logger::HostId;
use peernet_networks::{ClockSocketName, SESSION_VERSIONS, SessionHello, SessionId};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio_util::task::AbortOnDropHandle;

use super::messages::{ClockAnswer, ClockQuery};
use super::{ClockPeers, ClockResponder, ClockSocket, NotProven, prove};

const WAIT_TIMEOUT: Duration = Duration::from_secs(20);

fn system_clock() -> SharedClock {
    let identity = ClockIdentity::from_system(ClockIdentity::SYSTEM).expect("linux has a boot id");
    Arc::new(SystemClock::new(identity))
}

/// Returns the system's clock with clock fault injection that injects no fault.
fn faulty_clock() -> SharedClock {
    let clock = system_clock();
    let (identity, since) = (clock.identity().clone(), clock.wall());
    let faults = ClockFaults { offset: Span::ZERO, drift_ppm: 0.0, steps: Vec::new(), since };
    Arc::new(FaultyClock::new(clock, identity, faults))
}

/// Returns the id of the session of this number.
fn session(number: u8) -> SessionId {
    serde_json::from_str(&format!("\"f81d4fae-7dec-11d0-a765-00a0c91e6b{number:02x}\"")).expect("a UUID")
}

fn hello(clock: &SharedClock, clock_socket: Option<ClockSocketName>) -> SessionHello {
    SessionHello {
        versions: SESSION_VERSIONS,
        host: HostId::random(),
        name: "edge".parse().expect("a name"),
        clock: clock.identity().clone(),
        pipeline: "line".parse().expect("a name"),
        model: None,
        device: None,
        clock_socket,
    }
}

/// Starts the edge's end. Returns the receiver of the results of the proof.
fn start_proving(
    peers: ClockPeers,
    clock: SharedClock,
) -> (mpsc::Receiver<Result<(), NotProven>>, AbortOnDropHandle<()>) {
    let (report_proof, proofs) = mpsc::channel(64);
    let task = tokio::spawn(async move {
        let report_proof = |proof| report_proof.try_send(proof).expect("the test receives every result");
        match prove(&peers, &clock, report_proof).await {}
    });
    (proofs, AbortOnDropHandle::new(task))
}

async fn receive_result(proofs: &mut mpsc::Receiver<Result<(), NotProven>>) -> Result<(), NotProven> {
    tokio::time::timeout(WAIT_TIMEOUT, proofs.recv()).await.expect("in time").expect("the task lives")
}

/// Starts the cloud's end in the session of this number.
fn start_responder(
    hello: &SessionHello,
    session_number: u8,
    clock: &SharedClock,
) -> Option<AbortOnDropHandle<()>> {
    let responder = ClockResponder::connect(hello, session(session_number), clock)?;
    Some(AbortOnDropHandle::new(tokio::spawn(responder.answer())))
}

fn listen(clock: &SharedClock) -> ClockSocket {
    ClockSocket::listen(&**clock).expect("the kernel's time is shown, and there are abstract sockets")
}

fn connect(name: ClockSocketName) -> std::io::Result<UnixStream> {
    UnixStream::connect_addr(&SocketAddr::from_abstract_name(name.to_string())?)
}

#[tokio::test]
async fn cloud_of_the_session_proves_one_clock() {
    let clock = system_clock();
    let socket = listen(&clock);
    let _responder = start_responder(&hello(&clock, Some(socket.name())), 1, &clock).expect("connects");
    let name = socket.name();
    let (mut proofs, _task) = start_proving(socket.into_peers(session(1)), clock);
    assert!(receive_result(&mut proofs).await.is_ok());
    assert_eq!(connect(name).expect_err("the socket is closed").kind(), ErrorKind::ConnectionRefused);
}

#[tokio::test]
async fn cloud_of_another_session_proves_nothing() {
    let clock = system_clock();
    let socket = listen(&clock);
    let _responder = start_responder(&hello(&clock, Some(socket.name())), 2, &clock).expect("connects");
    let (mut proofs, _task) = start_proving(socket.into_peers(session(1)), clock);
    assert!(matches!(receive_result(&mut proofs).await, Err(NotProven::Foreign)));
}

#[tokio::test]
async fn process_with_clock_fault_neither_listens_nor_connects() {
    let (kernel_clock, other_clock) = (system_clock(), faulty_clock());
    assert!(ClockSocket::listen(&*other_clock).is_none());
    let socket = listen(&kernel_clock);
    assert!(start_responder(&hello(&kernel_clock, Some(socket.name())), 1, &other_clock).is_none());
    let (mut proofs, _task) = start_proving(socket.into_peers(session(1)), kernel_clock);
    assert!(matches!(receive_result(&mut proofs).await, Err(NotProven::NotConnected)));
}

#[tokio::test]
async fn cloud_does_not_connect_to_edge_of_another_boot() {
    let clock = system_clock();
    let socket = listen(&clock);
    let other = ClockIdentity::new("another", ClockIdentity::SYSTEM);
    let hello = SessionHello { clock: other, ..hello(&clock, Some(socket.name())) };
    assert!(start_responder(&hello, 1, &clock).is_none());
}

#[tokio::test]
async fn cloud_continues_without_listener_or_with_full_queue() {
    let clock = system_clock();
    let name = ClockSocketName::new([3; ClockSocketName::BYTES]);
    assert!(start_responder(&hello(&clock, Some(name)), 1, &clock).is_none());
    // The listener accepts no connection, so a blocking `connect` would wait once the queue is full. The responder must
    // not wait.
    let address = SocketAddr::from_abstract_name(name.to_string()).expect("a short name");
    let _listener = UnixListener::bind_addr(&address).expect("the name is free");
    let mut waiting = Vec::new();
    while let Some(responder) = start_responder(&hello(&clock, Some(name)), 1, &clock) {
        waiting.push(responder);
        assert!(waiting.len() < 10_000, "the queue is bounded");
    }
}

#[tokio::test]
async fn garbage_and_silence_do_not_hide_the_cloud() {
    let clock = system_clock();
    let socket = listen(&clock);
    let mut garbage = connect(socket.name()).expect("the edge listens");
    garbage.write_all(&[0x55; 4 * ClockAnswer::BYTES]).expect("there is room");
    let mut silent = connect(socket.name()).expect("the edge listens");
    let _closed = connect(socket.name()).map(drop);
    let _responder = start_responder(&hello(&clock, Some(socket.name())), 1, &clock).expect("connects");
    let (mut proofs, _task) = start_proving(socket.into_peers(session(1)), clock);
    assert!(receive_result(&mut proofs).await.is_ok());
    for stream in [&mut garbage, &mut silent] {
        stream.set_read_timeout(Some(WAIT_TIMEOUT)).expect("a timeout");
        let mut query = [0; ClockQuery::BYTES];
        stream.read_exact(&mut query).expect("the edge sent a query");
        // The edge has closed the connection. A connection with unread bytes is reset instead.
        match stream.read(&mut query) {
            Ok(bytes) => assert_eq!(bytes, 0),
            Err(error) => assert_eq!(error.kind(), ErrorKind::ConnectionReset),
        }
    }
}

#[tokio::test]
async fn cloud_closes_connection_after_invalid_query() {
    let clock = system_clock();
    let name = ClockSocketName::new([4; ClockSocketName::BYTES]);
    let address = SocketAddr::from_abstract_name(name.to_string()).expect("a short name");
    let listener = UnixListener::bind_addr(&address).expect("the name is free");
    let responder =
        ClockResponder::connect(&hello(&clock, Some(name)), session(1), &clock).expect("connects");
    let (mut stream, _) = listener.accept().expect("the responder connected");
    stream.write_all(&[0x55; ClockQuery::BYTES]).expect("there is room");
    tokio::time::timeout(WAIT_TIMEOUT, responder.answer()).await.expect("the responder ends");
    let mut bytes = Vec::new();
    assert_eq!(stream.read_to_end(&mut bytes).expect("the cloud has closed the connection"), 0);
}

/// This test takes as long as a proof is valid.
#[tokio::test]
async fn proof_expires_without_answers_and_is_renewed_by_answers() {
    let clock = system_clock();
    let socket = listen(&clock);
    let cloud = connect(socket.name()).expect("the edge listens");
    let (mut proofs, _task) = start_proving(socket.into_peers(session(1)), SharedClock::clone(&clock));
    cloud.set_nonblocking(true).expect("a socket");
    let mut cloud = tokio::net::UnixStream::from_std(cloud).expect("a socket");
    answer(&mut cloud, &clock).await;
    assert!(receive_result(&mut proofs).await.is_ok());
    assert!(matches!(receive_result(&mut proofs).await, Err(NotProven::Expired)));
    // The edge has waited too long for this answer, so the answer proves nothing and the next query is sent at once.
    answer(&mut cloud, &clock).await;
    answer(&mut cloud, &clock).await;
    assert!(receive_result(&mut proofs).await.is_ok());
    drop(cloud);
    assert!(matches!(receive_result(&mut proofs).await, Err(NotProven::Ended(_))));
}

/// Answers one query as the cloud of session 1 does.
async fn answer(cloud: &mut tokio::net::UnixStream, clock: &SharedClock) {
    let mut query = [0; ClockQuery::BYTES];
    cloud.read_exact(&mut query).await.expect("the edge sends a query");
    let answer = ClockAnswer {
        nonce: ClockQuery::from_bytes(&query).expect("a query").nonce,
        session: *session(1).as_bytes(),
        time_namespace: time_namespace().expect("the kernel shows the time namespace"),
        shows_kernel_time: clock.shows_kernel_time(),
        raw: clock.raw(),
    };
    cloud.write_all(&answer.to_bytes()).await.expect("the edge reads");
}
