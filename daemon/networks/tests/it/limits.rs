//! Tests of the limits of a listening port, with real sockets.

use std::net::SocketAddr;
use std::time::Duration;

use bytes::Bytes;
use peernet_networks::zmtp::{ListenerLimits, Rejection, ZmtpListener};
use peernet_networks::{Frames, ListenerEvent, Peer, SendFailure};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use zeromq::{Message, Options, Socket, SocketType};

use crate::support::within;

/// Length of the listener's READY command after its first two bytes.
const READY_REST_BYTES: usize = 28;

/// A time that is longer than any test.
const LONG_TIME: Duration = Duration::from_secs(60);

fn limits() -> ListenerLimits {
    ListenerLimits {
        max_connections: 400,
        max_message_bytes: 4 * 1024 * 1024,
        max_unfinished_bytes: 16 * 1024 * 1024,
        hello_timeout: LONG_TIME,
        max_queued_messages: 16,
        max_queued_bytes: 4 * 1024 * 1024,
        heartbeat_interval: Duration::from_secs(20),
        heartbeat_timeout: LONG_TIME,
    }
}

async fn bind(limits: ListenerLimits) -> ZmtpListener {
    ZmtpListener::bind("127.0.0.1:0", limits).await.expect("the port is free")
}

/// Returns the next message. Other events are ignored.
async fn next_message(listener: &mut ZmtpListener) -> (Peer, Frames) {
    within(async {
        loop {
            if let ListenerEvent::Message(peer, frames) = listener.receive().await.expect("the port is open")
            {
                return (peer, frames);
            }
        }
    })
    .await
}

/// Waits until `count` connections were rejected for this reason, and asserts that no further connection was rejected
/// for it.
async fn wait_for_rejections(listener: &ZmtpListener, reason: Rejection, count: u64) {
    let rejections = listener.rejections();
    within(async {
        while rejections.count(reason) < count {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await;
    assert_eq!(rejections.count(reason), count, "{reason:?}");
}

/// A ZMTP 3.1 peer that can send arbitrary bytes.
struct RawPeer(TcpStream);

impl RawPeer {
    async fn connect(to: SocketAddr) -> Self {
        let mut greeting = vec![0xff, 0, 0, 0, 0, 0, 0, 0, 1, 0x7f, 3, 1];
        greeting.extend_from_slice(b"NULL");
        greeting.resize(64, 0);
        greeting.extend_from_slice(b"\x04\x1c\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER");
        let mut stream = TcpStream::connect(to).await.expect("the port is open");
        stream.write_all(&greeting).await.expect("sends");
        // Reads the greeting of the listener and the first bytes of its READY. The listener sends READY after it has
        // handled our greeting.
        within(stream.read_exact(&mut [0; 64 + 2])).await.expect("the listener answers");
        Self(stream)
    }

    /// Starts a frame that claims `claimed_bytes` bytes, and sends `sent_bytes` of these bytes.
    async fn begin_frame(&mut self, claimed_bytes: u64, sent_bytes: usize) -> std::io::Result<()> {
        // The flag 2 says that a length of eight bytes follows.
        self.0.write_all(&[&[2][..], &claimed_bytes.to_be_bytes()].concat()).await?;
        self.0.write_all(&vec![7; sent_bytes]).await
    }

    /// Sends a message of one short frame.
    async fn send_message(&mut self, text: &[u8]) {
        self.0.write_all(&[&[0, text.len() as u8][..], text].concat()).await.expect("sends");
    }

    async fn wait_for_close(mut self) {
        // The connection may be closed in any way.
        let _reset = within(self.0.read_to_end(&mut Vec::new())).await;
    }
}

/// Returns a peer whose hello was accepted.
async fn admitted_peer(listener: &mut ZmtpListener) -> (RawPeer, Peer) {
    let mut raw_peer = RawPeer::connect(listener.address()).await;
    raw_peer.send_message(b"hello").await;
    let (peer, frames) = next_message(listener).await;
    assert_eq!(frames, ["hello"]);
    listener.sender().admit(peer.connection);
    (raw_peer, peer)
}

#[tokio::test]
async fn large_claimed_length_before_hello_closes_connection() {
    let listener = bind(limits()).await;
    for claimed_bytes in [65_536, 4_000_000, u64::MAX >> 1] {
        let mut raw_peer = RawPeer::connect(listener.address()).await;
        raw_peer.begin_frame(claimed_bytes, 0).await.expect("sends");
        raw_peer.wait_for_close().await;
    }
    wait_for_rejections(&listener, Rejection::LargeBeforeHello, 3).await;
}

#[tokio::test]
async fn connection_without_hello_is_closed_after_timeout() {
    let mut listener = bind(ListenerLimits { hello_timeout: Duration::from_millis(100), ..limits() }).await;
    let (mut remaining_peer, _) = admitted_peer(&mut listener).await;
    RawPeer::connect(listener.address()).await.wait_for_close().await;
    wait_for_rejections(&listener, Rejection::NoHello, 1).await;
    // A connection that has lost its session has the same time limit.
    let (leaving_peer, peer) = admitted_peer(&mut listener).await;
    listener.sender().demote(peer.connection);
    leaving_peer.wait_for_close().await;
    wait_for_rejections(&listener, Rejection::NoHello, 2).await;
    remaining_peer.send_message(b"still here").await;
    assert_eq!(next_message(&mut listener).await.1, ["still here"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hello_timeout_holds_for_peer_that_sends_without_pause() {
    let mut listener = bind(ListenerLimits { hello_timeout: Duration::from_millis(100), ..limits() }).await;
    let rejections = listener.rejections();
    let RawPeer(stream) = RawPeer::connect(listener.address()).await;
    let mut stream = stream.into_std().expect("a socket");
    stream.set_nonblocking(false).expect("a socket");
    // A thread fills the socket's buffers faster than the listener handles the messages.
    let messages = b"\0\x01x".repeat(20_000);
    let sending =
        std::thread::spawn(move || while std::io::Write::write_all(&mut stream, &messages).is_ok() {});
    within(async {
        while rejections.count(Rejection::NoHello) == 0 {
            listener.receive().await.expect("the port is open");
        }
    })
    .await;
    sending.join().expect("ends with the connection");
}

#[tokio::test]
async fn unfinished_messages_share_one_budget() {
    let mut listener = bind(limits()).await;
    let (mut raw_peers, mut connections) = (Vec::new(), Vec::new());
    for _ in 0..8 {
        let (mut raw_peer, peer) = admitted_peer(&mut listener).await;
        // Sending fails if the connection was closed in the meantime.
        let _closed = raw_peer.begin_frame(4_000_000, 3_900_000).await;
        raw_peers.push(raw_peer);
        connections.push(peer.connection);
    }
    // The budget of 16 MiB has room for four of the eight messages.
    wait_for_rejections(&listener, Rejection::NoMemory, 4).await;
    drop(raw_peers);
    // The memory of the closed connections is returned before their ends are reported. Only the ends of the first four
    // connections are awaited, because `admitted_peer` may have read the ends of the rejected connections.
    connections.truncate(4);
    within(async {
        while !connections.is_empty() {
            if let Some(ListenerEvent::Gone(gone, _)) = listener.receive().await {
                connections.retain(|connection| *connection != gone);
            }
        }
    })
    .await;
    let (mut raw_peer, _) = admitted_peer(&mut listener).await;
    raw_peer.begin_frame(4_000_000, 4_000_000).await.expect("sends");
    assert_eq!(next_message(&mut listener).await.1[0].len(), 4_000_000);
}

#[tokio::test]
async fn stalled_frame_ends_connection() {
    let short_heartbeats = ListenerLimits {
        heartbeat_interval: Duration::from_millis(50),
        heartbeat_timeout: Duration::from_millis(200),
        ..limits()
    };
    let mut listener = bind(short_heartbeats).await;
    let (mut raw_peer, _) = admitted_peer(&mut listener).await;
    raw_peer.begin_frame(1_000_000, 1_000).await.expect("sends");
    raw_peer.wait_for_close().await;
    wait_for_rejections(&listener, Rejection::Silent, 1).await;
}

#[tokio::test]
async fn new_connection_replaces_oldest_silent_connection() {
    let mut listener = bind(ListenerLimits { max_connections: 40, ..limits() }).await;
    let (mut first_peer, _) = admitted_peer(&mut listener).await;
    let mut silent_peers = Vec::new();
    for _ in 0..30 {
        silent_peers.push(RawPeer::connect(listener.address()).await);
    }
    // At most a quarter of `max_connections`, 10, may wait for a hello from one address.
    wait_for_rejections(&listener, Rejection::Replaced, 20).await;
    for closed_peer in silent_peers.drain(..20) {
        closed_peer.wait_for_close().await;
    }
    first_peer.send_message(b"untouched").await;
    assert_eq!(next_message(&mut listener).await.1, ["untouched"]);
    silent_peers[9].send_message(b"in time").await;
    assert_eq!(next_message(&mut listener).await.1, ["in time"]);
}

#[tokio::test]
async fn admitted_connections_at_limit_are_not_replaced() {
    let mut listener = bind(ListenerLimits { max_connections: 4, ..limits() }).await;
    let mut admitted_peers = Vec::new();
    for _ in 0..4 {
        admitted_peers.push(admitted_peer(&mut listener).await);
    }
    let refused_stream = TcpStream::connect(listener.address()).await.expect("the port is open");
    RawPeer(refused_stream).wait_for_close().await;
    wait_for_rejections(&listener, Rejection::TooMany, 1).await;
    admitted_peers[0].0.send_message(b"here").await;
    assert_eq!(next_message(&mut listener).await.1, ["here"]);
}

#[tokio::test]
async fn peer_that_does_not_read_uses_bounded_memory() {
    let mut listener = bind(limits()).await;
    let (mut raw_peer, peer) = admitted_peer(&mut listener).await;
    let sender = listener.sender();
    let payload = Bytes::from(vec![3; 500_000]);
    let mut sent = 0;
    let failure = loop {
        match sender.try_send(peer.connection, vec![payload.clone()]) {
            Ok(()) => sent += 1,
            Err(failure) => break failure,
        }
        assert!(sent < 200, "the queue is bounded");
    };
    assert_eq!(failure, SendFailure::Full);
    // The accepted messages arrive whole. Then the queue has room again. Each frame has nine bytes before its content:
    // one byte of flags and eight bytes of length.
    let mut bytes = vec![0; sent * 500_009];
    let mut ready = [0; READY_REST_BYTES];
    within(raw_peer.0.read_exact(&mut ready)).await.expect("the rest of READY");
    within(raw_peer.0.read_exact(&mut bytes)).await.expect("all accepted messages");
    assert!(bytes.chunks(500_009).all(|frame| frame[0] == 2 && frame[9..] == payload[..]));
    sender.try_send(peer.connection, vec![payload]).expect("there is room");
}

#[tokio::test]
async fn pings_of_peer_that_does_not_read_are_throttled() {
    let mut listener = bind(limits()).await;
    let (mut raw_peer, _) = admitted_peer(&mut listener).await;
    let pings = b"\x04\x17\x04PING\x00\x000123456789abcdef".repeat(4_096);
    let flood = async {
        for _ in 0..1_000 {
            raw_peer.0.write_all(&pings).await.expect("sends");
        }
    };
    let result = tokio::time::timeout(Duration::from_secs(2), flood).await;
    assert!(result.is_err(), "100 MB of PINGs were read");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_of_all_sizes_arrive_in_order() {
    let mut listener = bind(limits()).await;
    let sender = listener.sender();
    let socket = Socket::new(SocketType::Dealer, Options::default().max_message_size(8 << 20));
    socket.connect(format!("tcp://{}", listener.address())).await.expect("connects");
    let echo = tokio::spawn(async move {
        let mut count = 0;
        while count < 60 {
            match listener.receive().await {
                Some(ListenerEvent::Message(peer, frames)) => {
                    listener.sender().admit(peer.connection);
                    sender.try_send(peer.connection, frames).expect("there is room");
                    count += 1;
                }
                other => panic!("{other:?}"),
            }
        }
        listener.close(LONG_TIME).await;
    });
    for number in 0..60_usize {
        let size = [0, 1, 255, 256, 9_000, 16_384, 70_000, 1_200_000, 3_000_000][number % 9];
        let parts: Vec<Bytes> = vec![vec![number as u8; size].into(), Bytes::new(), vec![1; number].into()];
        let parts = if number == 0 { vec![Bytes::from("hello")] } else { parts };
        within(socket.send(Message::multipart(parts.clone()))).await.expect("sends");
        let answer: Vec<Bytes> = within(socket.recv()).await.expect("receives").iter().collect();
        assert_eq!(answer, parts, "message {number}");
    }
    within(echo).await.expect("closes");
}

#[tokio::test]
async fn messages_sent_before_closing_arrive() {
    let mut listener = bind(limits()).await;
    let (mut raw_peer, peer) = admitted_peer(&mut listener).await;
    let payload = Bytes::from(vec![9; 3_000_000]);
    listener.sender().try_send(peer.connection, vec![payload]).expect("there is room");
    // The peer sends a message that nobody reads. The unread message must not cause a reset.
    raw_peer.send_message(b"unread").await;
    let closing_task = tokio::spawn(listener.close(Duration::from_secs(10)));
    let mut received_bytes = Vec::new();
    within(raw_peer.0.read_to_end(&mut received_bytes)).await.expect("the connection is not reset");
    assert_eq!(received_bytes.len(), READY_REST_BYTES + 9 + 3_000_000);
    drop(raw_peer);
    within(closing_task).await.expect("ends");
}
