//! Accepts the connections of subscribers.

use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use peernet_clock::LogThrottle;
use thiserror::Error;
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::{sleep, timeout};

use super::limits::{HANDSHAKE_TIMEOUT, MAX_INCOMING_CONNECTIONS};
use super::node::NodeState;
use super::publisher::PublishedTopic;
use super::socket::{configure, read_header};
use super::tcpros::{ConnectionHeader, FrameBuffer, HandshakeError, HeaderError, MAX_HEADER_BYTES};

/// Delay after a failed `accept`. Without a free descriptor the next `accept` would fail at once.
const ACCEPT_RETRY_DELAY: Duration = Duration::from_millis(100);

/// Reason why a subscriber was not connected.
#[derive(Debug, Error)]
enum AcceptError {
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("the peer closed the connection before its header")]
    Closed,
    #[error(transparent)]
    Handshake(#[from] HandshakeError),
}

/// Accepts connections until the node ends.
pub(super) async fn accept_connections(node: Arc<NodeState>, listener: TcpListener) {
    let acceptor = Arc::new(Acceptor { node, log_throttle: Mutex::default() });
    let (node, permits) = (&acceptor.node, Arc::new(Semaphore::new(MAX_INCOMING_CONNECTIONS)));
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = node.lifetime.stop().cancelled() => return,
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(node = node.name.global(), %error, "cannot accept a connection of a ROS subscriber");
                sleep(ACCEPT_RETRY_DELAY).await;
                continue;
            }
        };
        // A connection without a permit is closed at once: waiting for a permit would occupy a file descriptor.
        let Ok(permit) = Arc::clone(&permits).try_acquire_owned() else {
            acceptor.warn_not_established(peer, "too many connections of ROS subscribers");
            continue;
        };
        let acceptor = Arc::clone(&acceptor);
        node.lifetime.tasks().spawn(async move {
            let _permit = permit;
            acceptor.serve(stream, peer).await;
        });
    }
}

/// The accepting side of a node.
#[derive(Debug)]
struct Acceptor {
    node: Arc<NodeState>,
    log_throttle: Mutex<LogThrottle>,
}

impl Acceptor {
    /// Exchanges headers with a subscriber, and runs the connection until it ends.
    async fn serve(&self, mut stream: TcpStream, peer: SocketAddr) {
        let handshake = tokio::select! {
            handshake = timeout(HANDSHAKE_TIMEOUT, self.exchange_headers(&mut stream)) => handshake,
            () = self.node.lifetime.stop().cancelled() => return,
        };
        match handshake {
            Ok(Ok((topic, subscriber, answer))) => topic.run_connection(stream, subscriber, answer).await,
            Ok(Err(error)) => self.warn_not_established(peer, &error.to_string()),
            Err(_) => self.warn_not_established(peer, "the peer sent no connection header in time"),
        }
    }

    /// Logs that a connection was not established, at most once a minute for each address.
    fn warn_not_established(&self, peer: SocketAddr, reason: &str) {
        let now = self.node.clock.mono();
        let mut throttle = self.log_throttle.lock().unwrap_or_else(PoisonError::into_inner);
        let times = throttle.count_event("refused", Some(peer.ip()), now);
        drop(throttle);
        if let Some(times) = times {
            tracing::warn!(node = self.node.name.global(), %peer, reason, times, "a connection of a ROS subscriber was not established");
        }
    }

    /// Reads the subscriber's header. Returns the topic, the subscriber's name and the answer.
    ///
    /// # Errors
    /// If the header does not arrive or is refused. After [`AcceptError::Handshake`] the subscriber has been informed.
    async fn exchange_headers(
        &self,
        stream: &mut TcpStream,
    ) -> Result<(Arc<PublishedTopic>, Arc<str>, ConnectionHeader), AcceptError> {
        configure(stream)?;
        let mut buffer = FrameBuffer::new(MAX_HEADER_BYTES);
        let frame = read_header(stream, &mut buffer).await?.ok_or(AcceptError::Closed)?;
        match self.answer_request(&frame) {
            Ok(answer) => Ok(answer),
            Err(error) => {
                stream.write_all(&ConnectionHeader::error(&error.to_string()).encode()).await?;
                Err(error.into())
            }
        }
    }

    /// Finds the topic that a header requests. Returns the topic, the subscriber's name and the answer.
    fn answer_request(
        &self,
        frame: &[u8],
    ) -> Result<(Arc<PublishedTopic>, Arc<str>, ConnectionHeader), HandshakeError> {
        let request = ConnectionHeader::decode(frame)?;
        let topic = request.get("topic").ok_or(HeaderError::Missing { name: "topic" })?;
        let published = self.node.topics.find_published(topic);
        let published = published.ok_or_else(|| HandshakeError::UnknownTopic {
            topic: topic.to_owned(),
            node: self.node.name.global().to_owned(),
        })?;
        let (answer, subscriber) = published.publication.answer(&request)?;
        Ok((published, subscriber, answer))
    }
}
