//! The connection of a subscriber to one publisher, which is reopened when it breaks.

use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use thiserror::Error;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::sync::Notify;
use tokio::time::{sleep, timeout};

use super::environment::{EnvironmentError, RpcUri};
use super::incoming::ReceivedMessage;
use super::limits::HANDSHAKE_TIMEOUT;
use super::master::split_answer;
use super::rpc::{self, RpcError};
use super::socket::{configure, read_header, read_message};
use super::subscriber::{PublisherInfo, PublisherState, PublisherStatus, ReceiveCounts, SubscribedTopic};
use super::tcpros::{ConnectionHeader, FrameBuffer, HandshakeError, MAX_HEADER_BYTES};
use super::xmlrpc::Value;

/// Delay before the second attempt. It doubles with each further attempt.
const MIN_RETRY_DELAY: Duration = Duration::from_millis(100);

/// Longest delay between attempts.
const MAX_RETRY_DELAY: Duration = Duration::from_secs(5);

/// Code of a successful answer.
const SUCCESS: i64 = 1;

/// Reason why there is no connection to a publisher.
#[derive(Debug, Error)]
enum LinkError {
    #[error("the master names {uri:?} as a publisher's address, which is not a URI")]
    Uri { uri: String, source: EnvironmentError },
    #[error("the node at {uri} does not answer: {source}")]
    Unreachable { uri: Arc<str>, source: RpcError },
    #[error("the node at {uri} offers no TCPROS connection: {reason}")]
    NoEndpoint { uri: Arc<str>, reason: String },
    #[error("cannot connect to the publisher at {host}:{port}: {source}")]
    Connect { host: String, port: u16, source: io::Error },
    #[error("the publisher at {uri} did not finish the handshake in time")]
    TimedOut { uri: Arc<str> },
    #[error("the connection to the publisher broke: {0}")]
    Broken(#[from] io::Error),
    #[error("the publisher closed the connection")]
    Closed,
    #[error(transparent)]
    Handshake(#[from] HandshakeError),
    #[error(
        "node {node} publishes this topic as well, but only messages of node {expected} are accepted; stop node {node}, \
         or let it publish another topic"
    )]
    UnexpectedPublisher { node: Arc<str>, expected: Arc<str> },
}

/// A publisher and the connection to it.
#[derive(Debug)]
pub(super) struct PublisherLink {
    uri: Arc<str>,
    state: Mutex<LinkState>,
    /// Notified when the master has sent a new list of publishers.
    listing_changed: Notify,
}

#[derive(Debug)]
struct LinkState {
    /// `true` while the master lists the publisher.
    is_listed: bool,
    publisher_state: PublisherState,
    counts: ReceiveCounts,
    /// Name of the publisher's node, if its messages are rejected because another node is expected.
    rejected_node: Option<Arc<str>>,
}

impl PublisherLink {
    pub(super) fn new(uri: Arc<str>) -> Self {
        let state = LinkState {
            is_listed: true,
            publisher_state: PublisherState::Connecting,
            counts: ReceiveCounts::default(),
            rejected_node: None,
        };
        Self { uri, state: Mutex::new(state), listing_changed: Notify::new() }
    }

    fn state(&self) -> MutexGuard<'_, LinkState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn uri(&self) -> &str {
        &self.uri
    }

    pub(super) fn status(&self) -> PublisherStatus {
        let state = self.state();
        PublisherStatus {
            uri: Arc::clone(&self.uri),
            state: state.publisher_state.clone(),
            counts: state.counts,
            rejected_node: state.rejected_node.clone(),
        }
    }

    pub(super) fn is_listed(&self) -> bool {
        self.state().is_listed
    }

    pub(super) fn set_listed(&self, is_listed: bool) {
        self.state().is_listed = is_listed;
        // During an attempt, the notification is kept and ends the delay after the attempt at once.
        self.listing_changed.notify_one();
    }

    fn set_state(&self, topic: &SubscribedTopic, state: PublisherState) {
        self.state().publisher_state = state;
        topic.changed.notify_waiters();
    }

    /// Connects repeatedly, until the publisher is no longer listed or the subscriber ends.
    pub(super) async fn run(&self, topic: &SubscribedTopic) {
        let mut delay = MIN_RETRY_DELAY;
        let (mut last_reason, mut was_closed) = (String::new(), false);
        loop {
            let connections = self.state().counts.connections;
            let error = tokio::select! {
                error = self.connect_and_read(topic) => error,
                () = topic.stop.cancelled() => LinkError::Closed,
            };
            if topic.remove_if_ended(self) {
                return;
            }
            // A connection was open since the last failure, so the shortest delay follows.
            if self.state().counts.connections > connections {
                delay = MIN_RETRY_DELAY;
            }
            let reason = error.to_string();
            // Attempts repeat, so the same reason is logged only once.
            if reason != last_reason {
                let (topic, publisher) = (&*topic.subscription.topic, &*self.uri);
                // When a publisher ends, it closes the connection before the master reports the end, and then refuses
                // the topic when it is asked again. Neither deserves a warning.
                let is_closed = matches!(error, LinkError::Closed);
                if is_closed || was_closed && matches!(error, LinkError::NoEndpoint { .. }) {
                    tracing::debug!(topic, publisher, "a publisher of a ROS topic closed the connection");
                } else {
                    tracing::warn!(
                        topic,
                        publisher,
                        reason,
                        "cannot receive from a publisher of a ROS topic; retrying"
                    );
                }
                (last_reason, was_closed) = (reason.clone(), is_closed);
            }
            self.state().rejected_node = match error {
                LinkError::UnexpectedPublisher { node, .. } => Some(node),
                _ => None,
            };
            self.set_state(topic, PublisherState::Failed(reason));
            tokio::select! {
                () = sleep(delay) => delay = (delay * 2).min(MAX_RETRY_DELAY),
                // The master has sent a new list: the publisher may have restarted or ended, so the retry is not
                // delayed.
                () = self.listing_changed.notified() => {}
                () = topic.stop.cancelled() => {}
            }
            if topic.remove_if_ended(self) {
                return;
            }
            self.set_state(topic, PublisherState::Connecting);
        }
    }

    async fn connect_and_read(&self, topic: &SubscribedTopic) -> LinkError {
        match self.connect(topic).await {
            Ok((stream, buffer, info)) => self.read_messages(topic, stream, buffer, info).await,
            Err(error) => error,
        }
    }

    /// Asks the publisher's node for a port, connects, and exchanges headers.
    async fn connect(
        &self,
        topic: &SubscribedTopic,
    ) -> Result<(TcpStream, FrameBuffer, Arc<PublisherInfo>), LinkError> {
        // The port is requested for each connection, because a restarted publisher has another port.
        let (host, port) = self.request_topic(topic).await?;
        let result = timeout(HANDSHAKE_TIMEOUT, TcpStream::connect((host.as_str(), port))).await;
        let result = result.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()));
        let stream = result.map_err(|source| LinkError::Connect { host, port, source })?;
        let handshake = timeout(HANDSHAKE_TIMEOUT, self.exchange_headers(topic, stream)).await;
        handshake.map_err(|_| LinkError::TimedOut { uri: Arc::clone(&self.uri) })?
    }

    /// Asks the publisher's node for the host and port of its TCPROS connections.
    async fn request_topic(&self, topic: &SubscribedTopic) -> Result<(String, u16), LinkError> {
        let uri = RpcUri::parse(&self.uri)
            .map_err(|source| LinkError::Uri { uri: self.uri.to_string(), source })?;
        let subscription = &topic.subscription;
        let protocols = Value::from([Value::from([Value::from("TCPROS")])]);
        let params = vec![(&*subscription.node).into(), (&*subscription.topic).into(), protocols];
        let answer = rpc::call(&uri, "requestTopic", params)
            .await
            .map_err(|source| LinkError::Unreachable { uri: Arc::clone(&self.uri), source })?;
        let no_endpoint =
            |reason: &str| LinkError::NoEndpoint { uri: Arc::clone(&self.uri), reason: reason.to_owned() };
        match split_answer(answer) {
            Some((SUCCESS, _, params)) => {
                read_endpoint(&params).ok_or_else(|| no_endpoint("its answer has no host and port"))
            }
            Some((_, reason, _)) => Err(no_endpoint(&reason)),
            None => Err(no_endpoint("its answer does not have the form of a ROS node's answer")),
        }
    }

    async fn exchange_headers(
        &self,
        topic: &SubscribedTopic,
        mut stream: TcpStream,
    ) -> Result<(TcpStream, FrameBuffer, Arc<PublisherInfo>), LinkError> {
        configure(&stream)?;
        stream.write_all(&topic.subscription.request().encode()).await?;
        let mut buffer = FrameBuffer::new(MAX_HEADER_BYTES);
        let frame = read_header(&mut stream, &mut buffer).await?.ok_or(LinkError::Closed)?;
        let header = ConnectionHeader::decode(&frame).map_err(HandshakeError::from)?;
        let (node, kind) = topic.subscription.accept(&header)?;
        if let Some(expected) = topic.publisher.as_ref().filter(|expected| **expected != node) {
            return Err(LinkError::UnexpectedPublisher { node, expected: Arc::clone(expected) });
        }
        let uri = Arc::clone(&self.uri);
        let (local, remote) = (stream.local_addr()?, stream.peer_addr()?);
        Ok((stream, buffer, Arc::new(PublisherInfo { node, uri, kind, local, remote })))
    }

    /// Reads messages until the connection ends.
    async fn read_messages(
        &self,
        topic: &SubscribedTopic,
        mut stream: TcpStream,
        mut buffer: FrameBuffer,
        publisher: Arc<PublisherInfo>,
    ) -> LinkError {
        self.state().counts.connections += 1;
        self.set_state(topic, PublisherState::Connected(Arc::clone(&publisher)));
        loop {
            let (bytes, memory) = match read_message(&mut stream, &mut buffer, topic).await {
                Ok(Some(message)) => message,
                Ok(None) => return LinkError::Closed,
                Err(error) => return LinkError::Broken(error),
            };
            // The arrival is stamped first, because the message may have to wait for space in the queue.
            let received = topic.clock.stamp();
            {
                // The block releases the lock before the queue is awaited.
                let counts = &mut self.state().counts;
                counts.messages += 1;
                counts.bytes += bytes.len() as u64;
            }
            let message = ReceivedMessage { bytes, publisher: Arc::clone(&publisher), received, memory };
            let dropped = topic.queue.push(message).await;
            if dropped > 0 {
                self.state().counts.dropped += dropped;
            }
        }
    }
}

/// Reads the host and the port from the parameters of a protocol, whose first parameter is the name of the protocol.
fn read_endpoint(params: &Value) -> Option<(String, u16)> {
    match params.as_array()? {
        [protocol, host, port, ..] if protocol.as_text() == Some("TCPROS") => {
            Some((host.as_text()?.to_owned(), port.as_int()?.try_into().ok()?))
        }
        _ => None,
    }
}
