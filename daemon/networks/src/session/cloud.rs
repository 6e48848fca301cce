//! Drives the session protocol on the cloud, for all sessions of a port.
//!
//! ```text
//! cloud                 the port: binds it, returns its events, closes it
//! cloud/listener_state  state that the listener shares with all answers in progress
//! cloud/requests        effects of an edge's message
//! cloud/answers         the wire form of an answer, and the number of answers that are being sent
//! cloud/output          the sending half of the port, with its counters
//! ```

mod answers;
mod listener_state;
mod output;
mod requests;

use std::collections::VecDeque;
use std::num::NonZeroUsize;
use std::sync::Arc;

pub(crate) use listener_state::ListenerState;
use peernet_clock::SharedClock;
use peernet_logger::HostId;

use super::announcer::Announcer;
use super::bind_error::BindError;
use super::incoming::{ArrivalStamp, Incoming};
use crate::message::SessionId;
use crate::statistics::{ConnectionStatistics, TransportStatistics};
use crate::transport::{BindFailure, CloudReceiver, ListenerEvent};
use crate::{Address, SessionSettings};

/// A port on which edges open sessions.
#[derive(Debug)]
pub struct Listener {
    shared: Arc<ListenerState>,
    receiver: Box<dyn CloudReceiver>,
    address: Address,
    caveat: Option<String>,
    settings: SessionSettings,
    /// Sessions that ended with their connection and for which [`next`](Self::next) has not returned an event yet.
    closed_sessions: VecDeque<SessionId>,
}

impl Listener {
    /// Listens on `address`, over the network that its scheme selects. With port 0 the system chooses a port.
    ///
    /// # Errors
    /// If the port is in use or the address belongs to another machine. The text says what to do.
    pub async fn bind(
        address: &Address,
        settings: SessionSettings,
        host: HostId,
        clock: SharedClock,
    ) -> Result<Self, BindError> {
        Self::bind_one_of(NonZeroUsize::MIN, address, settings, host, clock).await
    }

    /// Listens on several addresses. The settings apply to each of them. The addresses share the file descriptors that
    /// the process has for connections of edges.
    ///
    /// # Errors
    /// As for [`bind`](Self::bind), for the first address that cannot be bound. The ports bound before it are free again.
    pub async fn bind_all(
        addresses: &[Address],
        settings: &SessionSettings,
        host: HostId,
        clock: &SharedClock,
    ) -> Result<Vec<Self>, BindError> {
        let port_count = NonZeroUsize::new(addresses.len()).unwrap_or(NonZeroUsize::MIN);
        let mut listeners = Vec::with_capacity(addresses.len());
        for address in addresses {
            let (settings, clock) = (settings.clone(), SharedClock::clone(clock));
            match Self::bind_one_of(port_count, address, settings, host, clock).await {
                Ok(listener) => listeners.push(listener),
                Err(error) => {
                    // A port is free again only when its tasks have ended.
                    for listener in listeners {
                        listener.close().await;
                    }
                    return Err(error);
                }
            }
        }
        Ok(listeners)
    }

    /// Listens on one address. `port_count` is the number of ports that share the file descriptors.
    async fn bind_one_of(
        port_count: NonZeroUsize,
        address: &Address,
        settings: SessionSettings,
        host: HostId,
        clock: SharedClock,
    ) -> Result<Self, BindError> {
        let settings = settings.clamped();
        let bound = address.network().bind(address, &settings, port_count, &clock).await;
        let bound = bound.map_err(|failure| match failure {
            BindFailure::InUse => BindError::InUse(address.clone()),
            BindFailure::Denied => BindError::Denied(address.clone()),
            BindFailure::NotLocal => BindError::NotLocal(address.clone()),
            BindFailure::Other(reason) => BindError::Other(address.clone(), reason),
        })?;
        let shared = Arc::new(ListenerState::new(&settings, bound.sender, clock, host));
        let closed_sessions = VecDeque::new();
        let (receiver, address, caveat) = (bound.receiver, bound.address, bound.caveat);
        Ok(Self { shared, receiver, address, caveat, settings, closed_sessions })
    }

    /// Returns the address of the port, with the actual port number.
    pub const fn address(&self) -> &Address {
        &self.address
    }

    /// Returns a warning about a limit of the system that slows all connections of the port down, and what to do about
    /// it. `None` if there is no such limit.
    pub fn caveat(&self) -> Option<&str> {
        self.caveat.as_deref()
    }

    /// Returns the statistics of all connections together, counted since the port was bound.
    pub fn statistics(&self) -> ConnectionStatistics {
        self.shared.output.counters.statistics(&TransportStatistics::default())
    }

    /// Returns an announcer that sends clock states and statistics to the sessions of this port.
    pub fn announcer(&self) -> Announcer {
        Announcer::new(Arc::downgrade(&self.shared))
    }

    /// Waits for the next event. `None` means that the socket is closed. Cancel safe: dropping the future loses
    /// no event.
    pub async fn next(&mut self) -> Option<Incoming> {
        loop {
            if let Some(session) = self.closed_sessions.pop_front() {
                return Some(Incoming::Closed { session, said_goodbye: false, planned_iterations: None });
            }
            match self.receiver.receive().await? {
                ListenerEvent::Message(peer, frames) => {
                    // The epochs are read before the arrival is stamped. The epoch in the answer is read after the
                    // departure of the answer is stamped. If the epoch has not changed, no step of the clock lies
                    // between the two stamps.
                    let (epoch, wall_epoch) = (self.shared.clock.epoch(), self.shared.clock.wall_epoch());
                    let received = self.shared.clock.stamp();
                    let arrival = ArrivalStamp { raw: received.raw, epoch, wall_epoch };
                    if let Some(incoming) =
                        requests::handle_message(&self.shared, &peer, frames, (received, arrival))
                    {
                        return Some(incoming);
                    }
                }
                ListenerEvent::IncomingLost(connection, loss) => {
                    tracing::debug!(?connection, %loss, "a message of an edge was lost on the way");
                }
                ListenerEvent::OutgoingLost(connection, loss) => {
                    tracing::debug!(?connection, %loss, "a message to an edge was lost on the way");
                    if loss.tag.is_none() {
                        // Partial answers have no tag, so the lost message may be a partial answer.
                        self.shared.lock_server().note_lost_partial_answer(connection);
                    }
                    self.shared.output.counters.count_lost(1);
                    if let Some(counters) = self.shared.lock_server().connection_counters(connection) {
                        counters.count_lost(1);
                    }
                }
                ListenerEvent::Moved(connection, address) => {
                    tracing::debug!(?connection, %address, "the address of an edge has changed");
                    self.shared.lock_server().update_address(connection, address);
                }
                ListenerEvent::Gone(connection, reason) => {
                    let sessions = self.shared.lock_server().remove_connection(connection);
                    tracing::debug!(reason, sessions = sessions.len(), "an edge's connection ended");
                    self.closed_sessions.extend(sessions);
                }
                ListenerEvent::Remark(connection, text) => {
                    let session = self.shared.lock_server().first_session(connection);
                    return Some(Incoming::Remark { session, text });
                }
                ListenerEvent::Refused(host, text) => return Some(Incoming::Refused { host, text }),
                ListenerEvent::InvalidData(address, problem) => {
                    // `zmq-tcp` has logged the reason as a warning already, at most once a minute.
                    tracing::debug!(?address, problem, "dropped invalid data from a peer");
                    self.shared.output.counters.count_malformed();
                }
            }
        }
    }

    /// Waits for the answers to the requests in flight, but not longer than the close timeout. Then says goodbye to all
    /// edges and closes the port.
    pub async fn close(self) {
        let timeout = self.settings.close_timeout();
        if tokio::time::timeout(timeout, self.shared.wait_until_idle()).await.is_err() {
            let in_flight = self.shared.lock_server().in_flight_count();
            tracing::warn!(
                in_flight,
                "the close timeout has passed; closing the port while requests are still being computed"
            );
        }
        let goodbyes = self.shared.lock_server().end_all_sessions("the cloud shuts down");
        for (peer, header) in goodbyes {
            self.shared.send_message(&peer, &header);
        }
        self.receiver.close(timeout).await;
    }
}
