//! One connection to the aggregator: a DEALER socket that lives as long as its connection.

use std::io;
use std::time::Duration;

use peernet_networks::Address;
use tokio::net::TcpStream;
use zeromq::options::WorkloadProfile;
use zeromq::{
    DisconnectReason, Message, MonitorEvent, MonitorStream, Options, ReconnectPolicy, Socket, SocketType,
    TrySendError,
};

/// Number of messages that the socket buffers. It is small, because live figures grow old behind them.
const QUEUE: u32 = 8;
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);
/// Time without a sign of the peer after which it counts as gone.
const SILENCE_TIMEOUT: Duration = Duration::from_secs(5);
/// Longest time for finding out why a connection failed.
const DIAGNOSIS_TIMEOUT: Duration = Duration::from_secs(1);
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval of the library's own reconnecting, which is switched off: it would happen unnoticed, with old messages
/// still in the queue.
const NEVER: Duration = Duration::from_secs(365 * 24 * 3600);

/// Reason why there is no connection, or no longer.
#[derive(Debug, thiserror::Error)]
pub(super) enum ConnectionError {
    /// The socket could not be created, connected or read.
    #[error(transparent)]
    Socket(#[from] zeromq::Error),
    /// The monitor of the socket has ended.
    #[error(transparent)]
    Monitor(#[from] zeromq::MonitorRecvError),
    /// The peer does not speak ZMTP.
    #[error("something else answers there ({0})")]
    Handshake(String),
    /// The system refused the connection, or it failed.
    #[error("nobody answers ({})", .0.to_string().to_lowercase())]
    Refused(#[source] io::Error),
    /// The connection was not established in time.
    #[error("nobody answers")]
    Unanswered,
    /// The peer accepts connections and closes them at once.
    #[error("something there takes connections and closes them at once")]
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
            .send_hwm(QUEUE)
            .max_message_size(peernet_stream::codec::MAX_MESSAGE_BYTES)
            .heartbeat_interval(HEARTBEAT_INTERVAL)
            .heartbeat_timeout(SILENCE_TIMEOUT)
            // Without it TCP would repeat unacknowledged data for many minutes on a dead link.
            .tcp_user_timeout(SILENCE_TIMEOUT)
            .handshake_timeout(HANDSHAKE_TIMEOUT)
            .reconnect(ReconnectPolicy::Fixed(NEVER))
            // Batches that are lost with the connection are sent again.
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
                MonitorEvent::ConnectDelayed { .. } => return Err(diagnose(address).await),
                MonitorEvent::Disconnected { reason, .. } | MonitorEvent::ConnectStopped { reason, .. } => {
                    return Err(ConnectionError::Disconnected(reason));
                }
                _ => {}
            }
        }
    }

    /// Passes a frame to the socket; returns it if there is no room now.
    pub(super) fn send(&self, frame: Vec<u8>) -> Result<(), Vec<u8>> {
        match self.socket.try_send(Message::single(frame)) {
            Err(TrySendError::Full(message)) => Err(message.into_bytes().map(Into::into).unwrap_or_default()),
            // A closed connection is noticed at the next receive, and unacknowledged batches are sent again.
            Ok(()) | Err(TrySendError::Closed | TrySendError::Error(_)) => Ok(()),
        }
    }

    /// Passes frames to the socket in order, waiting for room for each.
    pub(super) async fn deliver(&self, frames: Vec<Vec<u8>>) {
        for mut frame in frames {
            while let Err(back) = self.send(frame) {
                self.socket.wait_send_ready().await;
                frame = back;
            }
        }
    }

    /// Waits for the next message, or for the end of the connection. Returns `None` if it was `blocked` and has room
    /// again. Dropping the future loses nothing.
    pub(super) async fn receive(&mut self, blocked: bool) -> Result<Option<Message>, ConnectionError> {
        loop {
            tokio::select! {
                biased;
                message = self.socket.recv() => return Ok(message.map(Some)?),
                event = self.monitor.recv() => match event {
                    Ok(MonitorEvent::Disconnected { reason, .. }) => return Err(ConnectionError::Disconnected(reason)),
                    Ok(_) => {}
                    Err(error) => return Err(error.into()),
                },
                () = self.socket.wait_send_ready(), if blocked => return Ok(None),
            }
        }
    }

    /// Closes the connection after the queued frames were sent, at the latest after `linger`.
    pub(super) async fn close(self, linger: Duration) {
        if let Err(error) = self.socket.close_with_linger(Some(linger)).await {
            tracing::debug!(%error, "closing the connection to the aggregator did not end cleanly");
        }
    }
}

/// Finds out why a connection failed, by connecting once more, because the library does not say why.
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
