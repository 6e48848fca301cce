//! A listening port: accepts connections within limits, and returns the messages that arrive on them.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use socket2::{Domain, SockRef, Socket, Type};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::connection::{Phase, ZmtpConnection};
use super::driver::{Budgets, ConnectionEnd, Driver};
use super::limits::{ListenerLimits, MAX_ALL_UNADMITTED_BYTES};
use super::rejections::{LOG_INTERVAL, Rejection, RejectionCounts};
use super::table::{ConnectionTable, InsertedConnection};
use crate::statistics::ConnectionAddresses;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{
    AddressGroup, BindFailure, CLOSED_HERE, ConnectionId, Frames, ListenerEvent, SendFailure,
};

/// Maximum number of messages of all connections that wait to be received. Their memory is reserved until then.
const MAX_QUEUED_DELIVERIES: usize = 1_024;

/// Number of sockets that may still be closing while the maximum number of connections is open.
const MAX_CLOSING_SOCKETS: usize = 16;

/// Number of connections that the kernel may complete before they are accepted.
const BACKLOG: i32 = 1_024;

/// Time until the next attempt after an accept failed because descriptors or memory were exhausted.
const ACCEPT_RETRY_INTERVAL: Duration = Duration::from_millis(100);

/// The receiving end of a listening port. Dropping it closes the port and all connections.
#[derive(Debug)]
pub struct ZmtpListener {
    address: SocketAddr,
    deliveries: mpsc::Receiver<Delivery>,
    state: Arc<ListenerState>,
}

/// The sending end of a listening port. Cheap to clone.
#[derive(Clone, Debug)]
pub struct ZmtpSender {
    state: Arc<ListenerState>,
}

#[derive(Debug)]
struct ListenerState {
    table: ConnectionTable,
    limits: ListenerLimits,
    /// Identity of the handshake, which tells peers what listens here; empty if there is no identity.
    identity: &'static str,
    budgets: Budgets,
    rejections: Arc<RejectionCounts>,
    stop: CancellationToken,
    tasks: TaskTracker,
    /// Time until which connections may still send their queues when the port is closed. This time is set before `stop`
    /// is cancelled.
    close_deadline: Mutex<Option<Instant>>,
}

/// An event, and the reservation of its memory until the event is received.
#[derive(Debug)]
pub(super) struct Delivery {
    pub(super) event: ListenerEvent,
    pub(super) _reserved: Option<Reservation>,
}

impl ZmtpListener {
    /// Listens on an address. With port 0 the system chooses a port.
    ///
    /// # Errors
    /// If the port is in use or the address does not belong to this machine.
    pub async fn bind(authority: &str, limits: ListenerLimits) -> Result<Self, BindFailure> {
        let no_identity = "";
        Self::bind_as(no_identity, authority, limits).await
    }

    /// Does the same as [`bind`](Self::bind), with an identity (RFC 37 of ZeroMQ, "Identity") that tells peers what
    /// listens here.
    pub(crate) async fn bind_as(
        identity: &'static str,
        authority: &str,
        limits: ListenerLimits,
    ) -> Result<Self, BindFailure> {
        let listener = listen(authority).await?;
        let address = listener.local_addr()?;
        let budgets = Budgets {
            unadmitted: MemoryBudget::new(MAX_ALL_UNADMITTED_BYTES),
            admitted: MemoryBudget::new(limits.unfinished_budget()),
            // At least four messages of the largest length can wait to be sent, on different connections.
            output: MemoryBudget::new(limits.unfinished_budget().saturating_mul(4)),
        };
        let state = Arc::new(ListenerState {
            table: ConnectionTable::new(limits.clone()),
            limits,
            identity,
            budgets,
            rejections: Arc::new(RejectionCounts::new(address.to_string())),
            stop: CancellationToken::new(),
            tasks: TaskTracker::new(),
            close_deadline: Mutex::new(None),
        });
        let (sender, deliveries) = mpsc::channel(MAX_QUEUED_DELIVERIES);
        state.tasks.spawn(accept_connections(listener, Arc::clone(&state), sender));
        Ok(Self { address, deliveries, state })
    }

    /// Returns the address of the port, with the actual port number.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns the sending end.
    pub fn sender(&self) -> ZmtpSender {
        ZmtpSender { state: Arc::clone(&self.state) }
    }

    /// Returns the counts of rejected connections by reason.
    pub fn rejections(&self) -> Arc<RejectionCounts> {
        Arc::clone(&self.state.rejections)
    }

    /// Waits for the next event. `None` means that the port is closed. Cancel safe: dropping the future loses
    /// nothing.
    pub async fn receive(&mut self) -> Option<ListenerEvent> {
        self.deliveries.recv().await.map(|delivery| delivery.event)
    }

    /// Closes the port and all connections after all messages have been sent, or after `linger`.
    pub async fn close(mut self, linger: Duration) {
        let deadline = Instant::now() + linger;
        *self.state.close_deadline.lock().unwrap_or_else(PoisonError::into_inner) = Some(deadline);
        // Unblocks the tasks that wait because the queue is full, so that they can close.
        self.deliveries.close();
        while self.deliveries.try_recv().is_ok() {}
        self.state.close();
        self.state.tasks.wait().await;
    }
}

impl Drop for ZmtpListener {
    fn drop(&mut self) {
        self.state.close();
    }
}

impl ZmtpSender {
    /// Hands over a whole message. Never waits.
    ///
    /// # Errors
    /// If the peer reads too slowly, or its connection is gone.
    pub fn try_send(&self, connection: ConnectionId, frames: Frames) -> Result<(), SendFailure> {
        let connection = self.state.table.get(connection);
        connection.ok_or_else(|| SendFailure::Gone("the peer is gone".into()))?.try_send(frames)
    }

    /// Returns the addresses of both ends of a connection; `None` if the connection is over.
    pub(crate) fn addresses(&self, connection: ConnectionId) -> Option<ConnectionAddresses> {
        self.state.table.get(connection)?.addresses()
    }

    /// Notes that the connection has sent a hello that is being decided. The hello timeout does not apply meanwhile.
    pub fn note_hello(&self, connection: ConnectionId) {
        self.state.table.note_hello(connection);
    }

    /// Notes that the connection's hello was accepted. The connection may then send large messages.
    pub fn admit(&self, connection: ConnectionId) {
        self.state.table.admit(connection);
    }

    /// Notes that the connection is not admitted any more. A new hello must arrive in time.
    pub fn demote(&self, connection: ConnectionId) {
        self.state.table.demote(connection);
    }
}

impl ListenerState {
    fn close(&self) {
        self.stop.cancel();
        for connection in self.table.connections() {
            connection.advance(Phase::Closing);
        }
        self.tasks.close();
    }

    fn close_deadline(&self) -> Instant {
        self.close_deadline.lock().unwrap_or_else(PoisonError::into_inner).unwrap_or_else(Instant::now)
    }
}

async fn listen(authority: &str) -> io::Result<TcpListener> {
    let mut addresses = tokio::net::lookup_host(authority).await?;
    let address = addresses
        .next()
        .ok_or_else(|| io::Error::new(io::ErrorKind::AddrNotAvailable, "the name has no address"))?;
    let socket = Socket::new(Domain::for_address(address), Type::STREAM, None)?;
    // Connections of an earlier process may be in TIME-WAIT; without this option they block the port.
    socket.set_reuse_address(true)?;
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    socket.listen(BACKLOG)?;
    TcpListener::from_std(socket.into())
}

/// Accepts connections until the listener stops.
async fn accept_connections(
    listener: TcpListener,
    state: Arc<ListenerState>,
    deliveries: mpsc::Sender<Delivery>,
) {
    // Sockets of connections that are being closed count, too; otherwise fast reconnections could exhaust the open
    // files.
    let permits = Arc::new(Semaphore::new(state.limits.max_connections + MAX_CLOSING_SOCKETS));
    let mut accept_error_logged_at: Option<Instant> = None;
    while let Some(accepted) = state.stop.run_until_cancelled(accept_one(&listener, &permits)).await {
        let (stream, address, permit) = match accepted {
            Ok(accepted) => accepted,
            Err(error) if is_aborted_by_peer(&error) => continue,
            Err(error) => {
                if accept_error_logged_at.is_none_or(|logged_at| logged_at.elapsed() >= LOG_INTERVAL) {
                    accept_error_logged_at = Some(Instant::now());
                    tracing::error!(%error, "cannot accept connections; trying again every 100 ms");
                }
                // While descriptors are exhausted, accepting fails at once; without a pause the loop would be busy.
                tokio::time::sleep(ACCEPT_RETRY_INTERVAL).await;
                continue;
            }
        };
        if let Err(error) = set_socket_options(&stream, &state.limits) {
            tracing::debug!(%error, %address, "cannot set the options of an accepted socket; the connection is dropped");
            continue;
        }
        let (reader, writer) = stream.into_split();
        let new_connection = |id| {
            let output = &state.budgets.output;
            let (limits, identity) = (&state.limits, state.identity);
            Arc::new(ZmtpConnection::new(id, address, writer, permit, limits, identity, output))
        };
        match state.table.insert(AddressGroup::from_address(address), new_connection) {
            Ok(InsertedConnection { connection, replaced }) => {
                for replaced_connection in replaced {
                    replaced_connection.advance(Phase::Replaced);
                }
                // `close` may have visited all connections just before this connection was added.
                if state.stop.is_cancelled() {
                    connection.advance(Phase::Closing);
                }
                let driver =
                    Driver::new(connection, reader, &state.limits, &state.budgets, deliveries.clone());
                state.tasks.spawn(serve_connection(driver, Arc::clone(&state), deliveries.clone()));
            }
            Err(reason) => {
                let text = "the maximum number of connections (in all, or of this address) is open, and no connection can be \
                            replaced, because all are admitted";
                state.rejections.record(reason, Some(address), text);
            }
        }
    }
}

/// Waits for the next connection. Returns the connection with its permit to be open.
async fn accept_one(
    listener: &TcpListener,
    permits: &Arc<Semaphore>,
) -> io::Result<(TcpStream, SocketAddr, OwnedSemaphorePermit)> {
    // The permit is acquired before the socket exists, so that connections wait in the kernel's queue.
    let permit = Arc::clone(permits).acquire_owned().await.map_err(io::Error::other)?;
    let (stream, address) = listener.accept().await?;
    Ok((stream, address, permit))
}

/// Returns whether the peer closed the connection before it was accepted.
fn is_aborted_by_peer(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

fn set_socket_options(stream: &TcpStream, limits: &ListenerLimits) -> io::Result<()> {
    // A small message must not wait for the acknowledgement of the message before it.
    stream.set_nodelay(true)?;
    SockRef::from(stream).set_tcp_user_timeout(Some(limits.heartbeat_timeout))
}

/// Runs a connection until it ends, and reports the end.
async fn serve_connection(mut driver: Driver, state: Arc<ListenerState>, deliveries: mpsc::Sender<Delivery>) {
    let end = driver.run().await;
    let connection = &driver.connection;
    let (id, address) = (connection.id, connection.address);
    let (has_delivered, is_ready) = (driver.has_delivered, driver.is_ready);
    let reason = match end {
        ConnectionEnd::Peer(reason) => {
            if !is_ready {
                state.rejections.record(Rejection::Handshake, Some(address), &reason);
            }
            reason
        }
        ConnectionEnd::Rejected(rejection, text) => {
            state.rejections.record(rejection, Some(address), &text);
            text
        }
        ConnectionEnd::Closed => {
            driver.finish(state.close_deadline()).await;
            CLOSED_HERE.into()
        }
    };
    // The connection is removed before its end is reported: the socket closes with the last reference, and nothing can
    // be sent afterwards.
    state.table.remove(id);
    drop(driver);
    let event = match (has_delivered, is_ready) {
        (true, _) => ListenerEvent::Gone(id, reason),
        (false, false) => ListenerEvent::InvalidData(Some(address), reason),
        // A connection that delivered no message is unknown to the layer above, which needs no event about its end.
        (false, true) => return,
    };
    // Sending fails only while the listener is closing.
    let _ended = deliveries.send(Delivery { event, _reserved: None }).await;
}
