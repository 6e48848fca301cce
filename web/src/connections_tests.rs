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
const LONG_LIMITS: Limits = Limits {
    connections: 8,
    streams: 8,
    streams_per_address: 8,
    header_timeout: HOUR,
    unread_timeout: HOUR,
    grace_period: HOUR,
};

/// A server that answers a request to `/wait` only when a permit is added to `answer_permits`.
struct Server {
    address: SocketAddr,
    stop: CancellationToken,
    task: JoinHandle<()>,
    /// One permit for each request to `/wait` that may be answered.
    answer_permits: Arc<Semaphore>,
    /// Notified when a request to `/wait` arrives.
    request_arrival: Arc<Notify>,
    /// Number of requests to `/wait` in progress.
    waiting_requests: Arc<AtomicUsize>,
    /// Largest number of requests to `/wait` that were in progress at one time.
    max_waiting_requests: Arc<AtomicUsize>,
}

impl Server {
    async fn start(limits: Limits) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("binds");
        let address = listener.local_addr().expect("an address");
        let stop = CancellationToken::new();
        let clock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let answer_permits = Arc::new(Semaphore::new(0));
        let request_arrival = Arc::new(Notify::new());
        let (waiting_requests, max_waiting_requests) =
            (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let shared = (
            answer_permits.clone(),
            request_arrival.clone(),
            waiting_requests.clone(),
            max_waiting_requests.clone(),
        );
        let wait = move || {
            let (answer_permits, request_arrival, waiting_requests, max_waiting_requests) = shared.clone();
            async move {
                let waiting = waiting_requests.fetch_add(1, Ordering::SeqCst) + 1;
                max_waiting_requests.fetch_max(waiting, Ordering::SeqCst);
                request_arrival.notify_one();
                answer_permits.acquire().await.expect("open").forget();
                waiting_requests.fetch_sub(1, Ordering::SeqCst);
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
        Self { address, stop, task, answer_permits, request_arrival, waiting_requests, max_waiting_requests }
    }

    async fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).await.expect("connects")
    }

    /// Returns a connection on which `text` was sent.
    async fn connect_and_send(&self, text: &str) -> TcpStream {
        let mut stream = self.connect().await;
        stream.write_all(text.as_bytes()).await.expect("sends");
        stream
    }

    /// Returns an open connection on which one request was answered.
    async fn connect_and_get_answer(&self) -> TcpStream {
        let mut stream = self.connect_and_send("GET / HTTP/1.1\r\nHost: here\r\n\r\n").await;
        let mut received = String::new();
        while !received.ends_with("here") {
            let mut chunk = [0; 512];
            let length = stream.read(&mut chunk).await.expect("reads");
            assert_ne!(length, 0, "closed early: {received}");
            received.push_str(&String::from_utf8_lossy(&chunk[..length]));
        }
        stream
    }

    /// Sends the request again until its connection gets a slot.
    async fn request_until_slot_is_free(&self, request: &str) {
        loop {
            let mut stream = self.connect().await;
            let sent = stream.write_all(request.as_bytes()).await;
            let mut answer = String::new();
            let received = stream.read_to_string(&mut answer).await;
            if sent.is_ok() && received.is_ok() && answer.starts_with("HTTP/1.1 200") {
                return;
            }
        }
    }

    /// Waits until `count` requests to `/wait` are in progress.
    async fn wait_for_requests(&self, count: usize) {
        while self.waiting_requests.load(Ordering::SeqCst) < count {
            self.request_arrival.notified().await;
        }
    }
}

/// Returns the data received until the server closed the connection.
async fn read_to_end(mut stream: TcpStream) -> String {
    let mut text = String::new();
    stream.read_to_string(&mut text).await.expect("closed cleanly");
    text
}

/// A request to `/wait`. The server closes its connection after the answer, so that
/// [`read_to_end`] returns.
const WAIT: &str = "GET /wait HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n";

#[tokio::test]
async fn connection_without_complete_header_is_closed() {
    let server = Server::start(Limits { header_timeout: SOON, ..LONG_LIMITS }).await;
    let silent_connections = [server.connect().await, server.connect().await, server.connect().await];
    let partial_header = server.connect_and_send("GET / HTTP/1.1\r\nHo").await;
    let idle_connection = server.connect_and_get_answer().await;
    let mut partial_second_header = server.connect_and_get_answer().await;
    partial_second_header.write_all(b"GET / HT").await.expect("sends");
    for stream in
        silent_connections.into_iter().chain([partial_header, idle_connection, partial_second_header])
    {
        assert!(!read_to_end(stream).await.contains("here"));
    }
}

#[tokio::test]
async fn connection_whose_peer_reads_nothing_is_closed() {
    let server = Server::start(Limits { connections: 1, unread_timeout: SOON, ..LONG_LIMITS }).await;
    let unread = server.connect_and_send("GET /endless HTTP/1.1\r\nHost: here\r\n\r\n").await;
    // The unread connection holds the only slot until the server closes it.
    server.request_until_slot_is_free(&WAIT.replace("/wait", "/")).await;
    drop(unread);
}

#[tokio::test]
async fn request_in_progress_does_not_time_out() {
    let server = Server::start(Limits { header_timeout: SOON, ..LONG_LIMITS }).await;
    let waiting = server.connect_and_send(WAIT).await;
    server.wait_for_requests(1).await;
    // When this silent connection is closed by the header timeout, the request has waited at least as long as that
    // timeout.
    read_to_end(server.connect().await).await;
    server.answer_permits.add_permits(1);
    assert!(read_to_end(waiting).await.ends_with("waited"));
}

#[tokio::test]
async fn connections_beyond_the_limit_are_closed() {
    let server = Server::start(Limits { connections: 2, ..LONG_LIMITS }).await;
    let waiting_connections = [server.connect_and_send(WAIT).await, server.connect_and_send(WAIT).await];
    server.wait_for_requests(2).await;
    assert_eq!(read_to_end(server.connect().await).await, "");
    server.answer_permits.add_permits(3);
    for stream in waiting_connections {
        assert!(read_to_end(stream).await.ends_with("waited"));
    }
    // Each slot becomes free only when the task of its connection has ended. A request before that may be closed.
    server.request_until_slot_is_free(WAIT).await;
    assert_eq!(server.max_waiting_requests.load(Ordering::SeqCst), 2);
}

#[tokio::test]
async fn connection_of_another_address_replaces_oldest() {
    let server = Server::start(Limits { connections: 2, ..LONG_LIMITS }).await;
    let oldest = server.connect_and_send(WAIT).await;
    server.wait_for_requests(1).await;
    let second = server.connect_and_send(WAIT).await;
    server.wait_for_requests(2).await;
    // All of 127.0.0.0/8 is this machine.
    let socket = TcpSocket::new_v4().expect("a socket");
    socket.bind("127.0.0.2:0".parse().expect("an address")).expect("binds");
    let mut other = socket.connect(server.address).await.expect("connects");
    other.write_all(WAIT.as_bytes()).await.expect("sends");
    assert_eq!(read_to_end(oldest).await, "");
    server.answer_permits.add_permits(2);
    for stream in [second, other] {
        assert!(read_to_end(stream).await.ends_with("waited"));
    }
}

#[tokio::test]
async fn stop_does_not_wait_for_idle_connections() {
    let server = Server::start(LONG_LIMITS).await;
    let _silent_connection = server.connect().await;
    let _partial_header = server.connect_and_send("GET / HTTP/1.1\r\nHo").await;
    let _idle_connection = server.connect_and_get_answer().await;
    let mut partial_second_header = server.connect_and_get_answer().await;
    partial_second_header.write_all(b"GET / HT").await.expect("sends");
    server.stop.cancel();
    server.task.await.expect("ends");
}

#[tokio::test]
async fn request_in_progress_is_answered_after_stop() {
    let server = Server::start(LONG_LIMITS).await;
    let waiting = server.connect_and_send(WAIT).await;
    server.wait_for_requests(1).await;
    server.stop.cancel();
    server.answer_permits.add_permits(1);
    server.task.await.expect("ends");
    assert!(read_to_end(waiting).await.ends_with("waited"));
}

#[tokio::test]
async fn request_beyond_grace_period_is_aborted() {
    let server = Server::start(Limits { grace_period: SOON, ..LONG_LIMITS }).await;
    let waiting = server.connect_and_send(WAIT).await;
    server.wait_for_requests(1).await;
    server.stop.cancel();
    server.task.await.expect("ends");
    assert_eq!(read_to_end(waiting).await, "");
}

#[tokio::test]
async fn streams_are_limited_per_address_and_in_total() {
    let (capacity, max_per_address) = (3, 2);
    let slots = FairSlots::new(capacity, max_per_address);
    let take = async |address: &str| {
        let address = AddressGroup::from_address(format!("{address}:1").parse().expect("an address"));
        let evict = CancellationToken::new();
        StreamSlots { slots: slots.clone(), address, evict }.acquire().await
    };
    let _held = [take("192.0.2.1").await, take("192.0.2.1").await].map(|slot| slot.expect("free"));
    let refusal = take("192.0.2.1").await.expect_err("too many").to_string();
    assert!(refusal.starts_with("2 live streams are open from this address"), "{refusal}");
    let _other = take("192.0.2.2").await.expect("free");
    let refusal = take("192.0.2.2").await.expect_err("too many").to_string();
    assert!(refusal.starts_with("3 live streams are open, "), "{refusal}");
}

/// Returns the answer to a request whose headers have `length` bytes.
async fn answer_to_headers_of_length(length: usize) -> String {
    let server = Server::start(LONG_LIMITS).await;
    let begin = "GET / HTTP/1.1\r\nHost: here\r\nConnection: close\r\nX-Long: ";
    let end = "\r\n\r\n";
    let filler = "x".repeat(length - begin.len() - end.len());
    let mut stream = server.connect().await;
    let mut answer = Vec::new();
    // The server may close the connection before it has read all headers.
    let _ = stream.write_all(format!("{begin}{filler}{end}").as_bytes()).await;
    let _ = stream.read_to_end(&mut answer).await;
    String::from_utf8(answer).expect("text")
}

#[tokio::test]
async fn headers_beyond_the_limit_are_refused() {
    assert!(answer_to_headers_of_length(MAX_HEADER_BYTES).await.starts_with("HTTP/1.1 200"));
    for length in [MAX_HEADER_BYTES + 1, 100_000, 1_000_000] {
        assert!(answer_to_headers_of_length(length).await.starts_with("HTTP/1.1 431"), "{length}");
    }
}
