use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use axum::body::Body;
use axum::routing::get;
use bytes::Bytes;
use futures::stream;
use peernet_clock::{ClockIdentity, SystemClock};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpSocket;
use tokio::sync::{Notify, Semaphore};
use tokio::task::JoinHandle;

use super::*;

const HOUR: Duration = Duration::from_secs(3_600);
const SOON: Duration = Duration::from_millis(20);
const PATIENT: Limits =
    Limits { connections: 8, streams: 8, streams_per_address: 8, silence: HOUR, unread: HOUR, grace: HOUR };

/// A server whose `/wait` answers only when a permit is added.
struct Server {
    address: SocketAddr,
    stop: CancellationToken,
    task: JoinHandle<()>,
    /// Requests to `/wait` that may be answered.
    answers: Arc<Semaphore>,
    entered: Arc<Notify>,
    inside: Arc<AtomicUsize>,
    most: Arc<AtomicUsize>,
}

impl Server {
    async fn start(limits: Limits) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("binds");
        let address = listener.local_addr().expect("an address");
        let stop = CancellationToken::new();
        let clock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let answers = Arc::new(Semaphore::new(0));
        let entered = Arc::new(Notify::new());
        let (inside, most) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let shared = (answers.clone(), entered.clone(), inside.clone(), most.clone());
        let wait = move || {
            let (answers, entered, inside, most) = shared.clone();
            async move {
                let now = inside.fetch_add(1, Ordering::SeqCst) + 1;
                most.fetch_max(now, Ordering::SeqCst);
                entered.notify_one();
                answers.acquire().await.expect("open").forget();
                inside.fetch_sub(1, Ordering::SeqCst);
                "waited"
            }
        };
        let endless = || async {
            Body::from_stream(stream::repeat(Ok::<_, Infallible>(Bytes::from(vec![b'x'; 1 << 16]))))
        };
        let router = Router::new()
            .route("/", get(|| async { "here" }))
            .route("/wait", get(wait))
            .route("/endless", get(endless));
        let task = tokio::spawn(accept(listener, router, clock, stop.clone(), limits));
        Self { address, stop, task, answers, entered, inside, most }
    }

    async fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).await.expect("connects")
    }

    /// Returns a connection that sent this.
    async fn sent(&self, text: &str) -> TcpStream {
        let mut stream = self.connect().await;
        stream.write_all(text.as_bytes()).await.expect("sends");
        stream
    }

    /// Returns a connection that had its first answer and is still open.
    async fn answered(&self) -> TcpStream {
        let mut stream = self.sent("GET / HTTP/1.1\r\nHost: here\r\n\r\n").await;
        let mut heard = String::new();
        while !heard.ends_with("here") {
            let mut chunk = [0; 512];
            let length = stream.read(&mut chunk).await.expect("reads");
            assert_ne!(length, 0, "closed early: {heard}");
            heard.push_str(&String::from_utf8_lossy(&chunk[..length]));
        }
        stream
    }

    /// Sends the request again until its connection is not closed because all places are taken.
    async fn finds_a_place(&self, request: &str) {
        loop {
            let mut stream = self.connect().await;
            let sent = stream.write_all(request.as_bytes()).await;
            let mut answer = String::new();
            let heard = stream.read_to_string(&mut answer).await;
            if sent.is_ok() && heard.is_ok() && answer.starts_with("HTTP/1.1 200") {
                return;
            }
        }
    }

    async fn inside(&self, count: usize) {
        while self.inside.load(Ordering::SeqCst) < count {
            self.entered.notified().await;
        }
    }
}

/// Returns the data received until the other side closed.
async fn rest(mut stream: TcpStream) -> String {
    let mut rest = String::new();
    stream.read_to_string(&mut rest).await.expect("closed in order");
    rest
}

const WAIT: &str = "GET /wait HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n";

#[tokio::test]
async fn connections_that_ask_for_nothing_are_closed() {
    let server = Server::start(Limits { silence: SOON, ..PATIENT }).await;
    let silent = [server.connect().await, server.connect().await, server.connect().await];
    let slow = server.sent("GET / HTTP/1.1\r\nHo").await;
    let idle = server.answered().await;
    let mut half = server.answered().await;
    half.write_all(b"GET / HT").await.expect("sends");
    for stream in silent.into_iter().chain([slow, idle, half]) {
        assert!(!rest(stream).await.contains("here"));
    }
}

#[tokio::test]
async fn connections_whose_peer_reads_nothing_are_closed() {
    let server = Server::start(Limits { connections: 1, unread: SOON, ..PATIENT }).await;
    let unread = server.sent("GET /endless HTTP/1.1\r\nHost: here\r\n\r\n").await;
    // It had the only place.
    server.finds_a_place(&WAIT.replace("/wait", "/")).await;
    drop(unread);
}

#[tokio::test]
async fn a_request_in_progress_is_not_silence() {
    let server = Server::start(Limits { silence: SOON, ..PATIENT }).await;
    let waiting = server.sent(WAIT).await;
    server.inside(1).await;
    // By the time this one is closed for its silence, the other has been waiting as long.
    rest(server.connect().await).await;
    server.answers.add_permits(1);
    assert!(rest(waiting).await.ends_with("waited"));
}

#[tokio::test]
async fn connections_beyond_the_limit_are_closed() {
    let server = Server::start(Limits { connections: 2, ..PATIENT }).await;
    let held = [server.sent(WAIT).await, server.sent(WAIT).await];
    server.inside(2).await;
    assert_eq!(rest(server.connect().await).await, "");
    server.answers.add_permits(3);
    for stream in held {
        assert!(rest(stream).await.ends_with("waited"));
    }
    // Both places are free again, at the latest when their tasks have ended.
    server.finds_a_place(WAIT).await;
    assert_eq!(server.most.load(Ordering::SeqCst), 2);
}

#[tokio::test]
async fn another_address_takes_the_place_of_the_oldest_connection() {
    let server = Server::start(Limits { connections: 2, ..PATIENT }).await;
    let oldest = server.sent(WAIT).await;
    server.inside(1).await;
    let second = server.sent(WAIT).await;
    server.inside(2).await;
    // All of 127.0.0.0/8 is this machine.
    let socket = TcpSocket::new_v4().expect("a socket");
    socket.bind("127.0.0.2:0".parse().expect("an address")).expect("binds");
    let mut other = socket.connect(server.address).await.expect("connects");
    other.write_all(WAIT.as_bytes()).await.expect("sends");
    assert_eq!(rest(oldest).await, "");
    server.answers.add_permits(2);
    for stream in [second, other] {
        assert!(rest(stream).await.ends_with("waited"));
    }
}

#[tokio::test]
async fn stopping_waits_for_no_connection_without_a_request() {
    let server = Server::start(PATIENT).await;
    let _silent = server.connect().await;
    let _first = server.sent("GET / HTTP/1.1\r\nHo").await;
    let _idle = server.answered().await;
    let mut half = server.answered().await;
    half.write_all(b"GET / HT").await.expect("sends");
    server.stop.cancel();
    server.task.await.expect("ends");
}

#[tokio::test]
async fn a_request_in_progress_is_answered_after_the_stop() {
    let server = Server::start(PATIENT).await;
    let waiting = server.sent(WAIT).await;
    server.inside(1).await;
    server.stop.cancel();
    server.answers.add_permits(1);
    server.task.await.expect("ends");
    assert!(rest(waiting).await.ends_with("waited"));
}

#[tokio::test]
async fn a_request_that_outlasts_the_grace_is_cut_off() {
    let server = Server::start(Limits { grace: SOON, ..PATIENT }).await;
    let waiting = server.sent(WAIT).await;
    server.inside(1).await;
    server.stop.cancel();
    server.task.await.expect("ends");
    assert_eq!(rest(waiting).await, "");
}

#[tokio::test]
async fn streams_are_limited_by_address_and_in_all() {
    let places = FairPlaces::new(3, 2);
    let of = async |address: &str| {
        let address = AddressGroup::of(format!("{address}:1").parse().expect("an address"));
        let leave = CancellationToken::new();
        Streams { places: places.clone(), address, leave }.take().await
    };
    let _held = [of("192.0.2.1").await, of("192.0.2.1").await].map(|place| place.expect("free"));
    let refused = of("192.0.2.1").await.expect_err("too many").to_string();
    assert!(refused.starts_with("2 live streams are open from this address"), "{refused}");
    let _other = of("192.0.2.2").await.expect("free");
    let refused = of("192.0.2.2").await.expect_err("too many").to_string();
    assert!(refused.starts_with("3 live streams are open, "), "{refused}");
}

async fn with_headers(length: usize) -> String {
    let server = Server::start(PATIENT).await;
    let begin = "GET / HTTP/1.1\r\nHost: here\r\nConnection: close\r\nX-Long: ";
    let filler = "x".repeat(length - begin.len() - 4);
    let mut stream = server.connect().await;
    let mut answer = Vec::new();
    // The server may close before it has read everything.
    let _ = stream.write_all(format!("{begin}{filler}\r\n\r\n").as_bytes()).await;
    let _ = stream.read_to_end(&mut answer).await;
    String::from_utf8(answer).expect("text")
}

#[tokio::test]
async fn headers_beyond_the_limit_are_refused() {
    assert!(with_headers(HEADER).await.starts_with("HTTP/1.1 200"));
    for length in [HEADER + 1, 100_000, 1_000_000] {
        assert!(with_headers(length).await.starts_with("HTTP/1.1 431"), "{length}");
    }
}
