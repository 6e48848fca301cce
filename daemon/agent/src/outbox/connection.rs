//! A connection to the aggregator: a DEALER socket that exists as long as its connection.

use std::io;
use std::time::Duration;

use peernet_networks::Address;
use tokio::net::TcpStream;
use zeromq::options::WorkloadProfile;
use zeromq::{
    DisconnectReason, Message, MonitorEvent, MonitorStream, Options, ReconnectPolicy, Socket, SocketType,
    TrySendError,
};

/// Maximum number of messages that the socket buffers. The number is small, because a live update waits behind these
/// messages.
const MAX_QUEUED_MESSAGES: u32 = 8;
// Several heartbeats fit into `SILENCE_TIMEOUT`, so that a single late heartbeat does not end the connection.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);
/// Time without received data after which the peer counts as unreachable.
const SILENCE_TIMEOUT: Duration = Duration::from_secs(5);
/// Longest time for the attempt that determines why a connection failed.
const DIAGNOSIS_TIMEOUT: Duration = Duration::from_secs(1);
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);
/// Reconnect interval of the library. The interval is so long that the library never reconnects by itself, because its
/// queue may contain messages of the lost connection.
const RECONNECT_NEVER: Duration = Duration::from_secs(365 * 24 * 3600);

/// Reason why a connection failed or ended.
#[derive(Debug, thiserror::Error)]
pub(super) enum ConnectionError {
    /// The socket could not be created, connected or read.
    #[error(transparent)]
    Socket(#[from] zeromq::Error),
    /// The monitor of the socket has ended.
    #[error(transparent)]
    Monitor(#[from] zeromq::MonitorRecvError),
    /// The peer does not speak ZMTP.
    #[error("another program answers there ({0})")]
    Handshake(String),
    /// The operating system reports that the connection failed, for example because the peer refused it.
    #[error("no program answers there ({})", .0.to_string().to_lowercase())]
    Refused(#[source] io::Error),
    /// The connection was not established in time.
    #[error("no answer within {} s", DIAGNOSIS_TIMEOUT.as_secs())]
    Unanswered,
    /// The peer accepts connections and closes them at once.
    #[error("a program there accepts connections and closes them at once")]
    ClosedAtOnce,
    /// The connection was open and has ended.
    #[error("{}", disconnect_text(.0))]
    Disconnected(DisconnectReason),
}

/// An open connection.
#[derive(Debug)]
pub(super) struct Connection {
    socket: Socket,
    monitor: MonitorStream,
}

impl Connection {
    /// Opens a connection.
    ///
    /// # Errors
    /// When the connection cannot be established.
    pub(super) async fn open(address: &Address) -> Result<Self, ConnectionError> {
        let options = Options::default()
            .workload_profile(WorkloadProfile::Latency)
            .send_hwm(MAX_QUEUED_MESSAGES)
            .max_message_size(peernet_stream::codec::MAX_MESSAGE_BYTES)
            .heartbeat_interval(HEARTBEAT_INTERVAL)
            .heartbeat_timeout(SILENCE_TIMEOUT)
            // Without this timeout TCP would repeat unacknowledged data for many minutes on a dead link.
            .tcp_user_timeout(SILENCE_TIMEOUT)
            .handshake_timeout(HANDSHAKE_TIMEOUT)
            .reconnect(ReconnectPolicy::Fixed(RECONNECT_NEVER))
            // The socket need not wait for unsent batches when it is closed: they are sent again over the next
            // connection.
            .linger(Duration::ZERO);
        let socket = Socket::try_new(SocketType::Dealer, options)?;
        let mut monitor = socket.monitor();
        socket.connect(address.to_string()).await?;
        loop {
            match monitor.recv().await? {
                MonitorEvent::HandshakeSucceeded { .. } => return Ok(Self { socket, monitor }),
                MonitorEvent::HandshakeFailed { reason, .. } => {
                    return Err(ConnectionError::Handshake(reason));
                }
                // The attempt failed, and the library waits until its next attempt.
                MonitorEvent::ConnectDelayed { .. } => return Err(diagnose(address).await),
                MonitorEvent::Disconnected { reason, .. } | MonitorEvent::ConnectStopped { reason, .. } => {
                    return Err(ConnectionError::Disconnected(reason));
                }
                _ => {}
            }
        }
    }

    /// Passes a frame to the socket. If the socket's queue is full, returns the frame as an error.
    pub(super) fn send(&self, frame: Vec<u8>) -> Result<(), Vec<u8>> {
        match self.socket.try_send(Message::single(frame)) {
            Err(TrySendError::Full(message)) => Err(message.into_bytes().map(Into::into).unwrap_or_default()),
            // A closed connection is noticed at the next receive, and unacknowledged batches are sent again.
            Ok(()) | Err(TrySendError::Closed | TrySendError::Error(_)) => Ok(()),
        }
    }

    /// Passes frames to the socket in order, and waits while the socket's queue is full.
    pub(super) async fn deliver(&self, frames: Vec<Vec<u8>>) {
        for mut frame in frames {
            while let Err(unsent) = self.send(frame) {
                self.socket.wait_send_ready().await;
                frame = unsent;
            }
        }
    }

    /// Waits for the next message, or for the end of the connection. If `is_blocked` is `true`, also waits for space in
    /// the socket's queue, and returns `None` once there is space. Cancel-safe.
    pub(super) async fn receive(&mut self, is_blocked: bool) -> Result<Option<Message>, ConnectionError> {
        loop {
            tokio::select! {
                biased;
                message = self.socket.recv() => return Ok(message.map(Some)?),
                event = self.monitor.recv() => match event {
                    Ok(MonitorEvent::Disconnected { reason, .. }) => return Err(ConnectionError::Disconnected(reason)),
                    Ok(_) => {}
                    Err(error) => return Err(error.into()),
                },
                () = self.socket.wait_send_ready(), if is_blocked => return Ok(None),
            }
        }
    }

    /// Closes the connection when the queued frames are sent, and after `linger` at the latest.
    pub(super) async fn close(self, linger: Duration) {
        if let Err(error) = self.socket.close_with_linger(Some(linger)).await {
            tracing::debug!(%error, "closing the connection to the aggregator did not end cleanly");
        }
    }
}

/// Connects to an aggregator once, and closes the connection.
///
/// # Errors
/// When no aggregator can be reached within five seconds. The error is a text that gives the reason.
pub async fn reach_aggregator(address: &Address) -> Result<(), String> {
    match tokio::time::timeout(HANDSHAKE_TIMEOUT, Connection::open(address)).await {
        Ok(Ok(connection)) => {
            connection.close(Duration::ZERO).await;
            Ok(())
        }
        Ok(Err(error)) => Err(error.to_string()),
        Err(_) => Err(format!("no answer within {} s", HANDSHAKE_TIMEOUT.as_secs())),
    }
}

/// Connects again to determine why a connection failed, because the library does not report the reason.
async fn diagnose(address: &Address) -> ConnectionError {
    match tokio::time::timeout(DIAGNOSIS_TIMEOUT, TcpStream::connect(address.authority())).await {
        Ok(Err(error)) => ConnectionError::Refused(error),
        Ok(Ok(_)) => ConnectionError::ClosedAtOnce,
        Err(_) => ConnectionError::Unanswered,
    }
}

fn disconnect_text(reason: &DisconnectReason) -> String {
    match reason {
        DisconnectReason::PeerClosed => "the aggregator closed the connection".to_owned(),
        DisconnectReason::Error(text) => text.clone(),
        other => format!("{other:?}"),
    }
}
