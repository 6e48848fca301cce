//! One connection to the aggregator: a DEALER that lives and dies with it.

use std::io;
use std::time::Duration;

use peernet_networks::Address;
use tokio::net::TcpStream;
use zeromq::options::WorkloadProfile;
use zeromq::{
    DisconnectReason, Message, MonitorEvent, MonitorStream, Options, ReconnectPolicy, Socket, SocketType,
    TrySendError,
};

/// Messages that the socket takes before the connection has: few, because live figures grow old behind them.
const QUEUE: u32 = 8;
const HEARTBEAT: Duration = Duration::from_secs(1);
/// A peer this silent is gone.
const SILENCE: Duration = Duration::from_secs(5);
/// How long finding out why a connection failed may take.
const DIAGNOSIS: Duration = Duration::from_secs(1);
const HANDSHAKE: Duration = Duration::from_secs(5);
/// The library would dial again by itself, behind our back and with the old messages still in its queue.
const NEVER: Duration = Duration::from_secs(365 * 24 * 3600);

/// The reason why there is no connection, or none any more.
#[derive(Debug, thiserror::Error)]
pub(super) enum ConnectionError {
    /// The socket could not be made, connected or read.
    #[error(transparent)]
    Socket(#[from] zeromq::Error),
    /// The socket tells no more of its connection.
    #[error(transparent)]
    Monitor(#[from] zeromq::MonitorRecvError),
    /// Something that does not speak the protocol listens there.
    #[error("something else answers there ({0})")]
    Handshake(String),
    /// The system refused the connection.
    #[error("nobody answers ({})", .0.to_string().to_lowercase())]
    Refused(#[source] io::Error),
    /// The system did not say anything in time.
    #[error("nobody answers")]
    Unanswered,
    /// The connection is accepted but does not last.
    #[error("something there takes connections and closes them at once")]
    ClosedAtOnce,
    /// The connection was open, and ended.
    #[error("{}", in_words(.0))]
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
    /// What stood in the way.
    pub(super) async fn open(address: &Address) -> Result<Self, ConnectionError> {
        let options = Options::default()
            .workload_profile(WorkloadProfile::Latency)
            .send_hwm(QUEUE)
            .max_message_size(peernet_stream::codec::MAX_MESSAGE_BYTES)
            .heartbeat_interval(HEARTBEAT)
            .heartbeat_timeout(SILENCE)
            .tcp_user_timeout(SILENCE)
            .handshake_timeout(HANDSHAKE)
            .reconnect(ReconnectPolicy::Fixed(NEVER))
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

    /// Hands a frame to the connection; gives it back when there is no room now.
    pub(super) fn send(&self, frame: Vec<u8>) -> Result<(), Vec<u8>> {
        match self.socket.try_send(Message::single(frame)) {
            Err(TrySendError::Full(message)) => Err(message.into_bytes().map(Into::into).unwrap_or_default()),
            // A connection that is closed shows itself at the next receive; what was sent last is repeated.
            Ok(()) | Err(TrySendError::Closed | TrySendError::Error(_)) => Ok(()),
        }
    }

    /// Hands frames over in their order, each when there is room for it.
    pub(super) async fn deliver(&self, frames: Vec<Vec<u8>>) {
        for mut frame in frames {
            while let Err(back) = self.send(frame) {
                self.socket.wait_send_ready().await;
                frame = back;
            }
        }
    }

    /// The next message's frames, or why there will be none; nothing when it is `blocked`, and has room again. Dropping
    /// the future loses nothing.
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

    /// Closes after what was handed over has gone, no later than after `linger`.
    pub(super) async fn close(self, linger: Duration) {
        if let Err(error) = self.socket.close_with_linger(Some(linger)).await {
            tracing::debug!(%error, "closing the connection to the aggregator did not end cleanly");
        }
    }
}

/// The library keeps to itself why a connection failed: the system is asked once more.
async fn diagnose(address: &Address) -> ConnectionError {
    match tokio::time::timeout(DIAGNOSIS, TcpStream::connect(address.authority())).await {
        Ok(Err(error)) => ConnectionError::Refused(error),
        Ok(Ok(_)) => ConnectionError::ClosedAtOnce,
        Err(_) => ConnectionError::Unanswered,
    }
}

fn in_words(reason: &DisconnectReason) -> String {
    match reason {
        DisconnectReason::PeerClosed => "the aggregator closed the connection".to_owned(),
        DisconnectReason::Error(text) => text.clone(),
        other => format!("{other:?}"),
    }
}
