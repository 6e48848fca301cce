//! Accepts the connections of subscribers.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::{sleep, timeout};

use super::limits::{HANDSHAKE_TIMEOUT, MAX_INCOMING_CONNECTIONS};
use super::node::NodeShared;
use super::publisher::PublishedTopic;
use super::socket::{configure, read_frame};
use super::tcpros::{ConnectionHeader, FrameBuffer, HandshakeError, HeaderError, MAX_HEADER_BYTES};

/// Pause after accepting failed: without a free descriptor it would fail again at once.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Why a connection did not become one of a subscriber.
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
pub(super) async fn run(node: Arc<NodeShared>, listener: TcpListener) {
    let places = Arc::new(Semaphore::new(MAX_INCOMING_CONNECTIONS));
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = node.stop.cancelled() => return,
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(node = &*node.name, %error, "cannot accept a connection of a ROS subscriber");
                sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            warn_refused(&node, peer, "too many connections of ROS subscribers");
            continue;
        };
        let shared = Arc::clone(&node);
        node.tasks.spawn(async move {
            let _place = place;
            serve(&shared, stream, peer).await;
        });
    }
}

async fn serve(node: &NodeShared, mut stream: TcpStream, peer: SocketAddr) {
    let handshake = tokio::select! {
        handshake = timeout(HANDSHAKE_TIMEOUT, shake_hands(node, &mut stream)) => handshake,
        () = node.stop.cancelled() => return,
    };
    match handshake {
        Ok(Ok((topic, subscriber, answer))) => topic.run_connection(stream, subscriber, answer).await,
        Ok(Err(error)) => {
            warn_refused(node, peer, &error.to_string());
        }
        Err(_) => warn_refused(node, peer, "it sent no header in time"),
    }
}

/// Logs that a connection was closed, once a minute for each address.
fn warn_refused(node: &NodeShared, peer: SocketAddr, reason: &str) {
    let times = node.log_throttle().count("refused", Some(peer.ip()), node.clock.mono());
    if let Some(times) = times {
        tracing::warn!(node = &*node.name, %peer, reason, times, "a ROS subscriber was refused");
    }
}

/// Reads the subscriber's header and returns the topic, the subscriber's name and the answer. A refusal has been sent.
async fn shake_hands(
    node: &NodeShared,
    stream: &mut TcpStream,
) -> Result<(Arc<PublishedTopic>, Arc<str>, ConnectionHeader), AcceptError> {
    configure(stream)?;
    let mut buffer = FrameBuffer::new(MAX_HEADER_BYTES);
    let (frame, _) = read_frame(stream, &mut buffer, None).await?.ok_or(AcceptError::Closed)?;
    match answer(node, &frame) {
        Ok(answer) => Ok(answer),
        Err(error) => {
            stream.write_all(&ConnectionHeader::error(&error.to_string()).encode()).await?;
            Err(error.into())
        }
    }
}

fn answer(
    node: &NodeShared,
    frame: &[u8],
) -> Result<(Arc<PublishedTopic>, Arc<str>, ConnectionHeader), HandshakeError> {
    let request = ConnectionHeader::decode(frame)?;
    let topic = request.get("topic").ok_or(HeaderError::Missing { name: "topic" })?;
    let published = node.topics().publications.get(topic).cloned();
    let published = published.ok_or_else(|| HandshakeError::UnknownTopic {
        topic: topic.to_owned(),
        node: node.name.to_string(),
    })?;
    let (answer, subscriber) = published.publication.answer(&request)?;
    Ok((published, subscriber, answer))
}
