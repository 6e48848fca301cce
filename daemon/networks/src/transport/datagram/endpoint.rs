//! The cloud's end of all virtual connections of a port, without I/O.
//!
//! An edge whose address changes keeps its connection. A packet from a new address is answered with a path challenge,
//! and the new address is used when the response arrives from there (as in RFC 9000, section 9).

mod answers;
mod connection_table;
mod delivery_queue;
mod entry;
mod reassembly_budgets;
mod timers;

use std::collections::VecDeque;
use std::net::{IpAddr, SocketAddr};

use peernet_clock::{MonoTime, Span};

use self::answers::AnswerQueue;
use self::connection_table::{Capacity, ConnectionTable};
pub(crate) use self::delivery_queue::Delivery;
use self::delivery_queue::DeliveryQueue;
use self::entry::{Admission, Entry, reply_address};
use self::reassembly_budgets::ReassemblyBudgets;
use self::timers::Timers;
use super::MIN_DATAGRAM_BYTES;
use super::connection::{Connection, ConnectionLimits, Event};
use super::handshake::{COOKIE_LIFETIME, CookieKey, first_u64};
use super::packet::{Packet, ResetReason, Role, Terms, VERSION};
use super::packet_writer::PacketWriter;
use super::reassembly::ReassemblyLimits;
use super::sending::Batch;
use crate::statistics::TransportStatistics;
use crate::transport::{AddressGroup, ConnectionId, Frames, ListenerEvent, Peer, SendFailure};

/// Shortest interval between two path challenges to new addresses of a connection.
const PATH_CHALLENGE_INTERVAL: Span = Span::from_millis(100);

/// Length of a path challenge. Only packets of at least this length are answered with a path challenge.
// A shorter packet with a forged source address would make this port send more bytes to that address than this port
// received.
const PATH_CHALLENGE_BYTES: usize = 17;

/// Shortest interval between two timer calls of a connection.
const MIN_TIMER_INTERVAL: Span = Span::from_millis(1);

/// Timeouts and limits of a port.
#[derive(Clone, Debug)]
pub(crate) struct EndpointLimits {
    pub(crate) connection: ConnectionLimits,
    /// Limits of connections with a session.
    pub(crate) reassembly: ReassemblyLimits,
    /// Memory for the unfinished messages of all connections with a session. Bytes.
    pub(crate) max_unfinished_bytes: u64,
    pub(crate) max_connections: usize,
    /// A connection that has no session and has not asked for one is closed after this time.
    pub(crate) hello_timeout: Span,
    /// Terms of this end.
    pub(crate) terms: Terms,
}

/// Destination of datagrams, and the address of this machine that they are sent from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Route {
    pub(crate) to: SocketAddr,
    pub(crate) from: Option<IpAddr>,
}

/// All connections of a port.
#[derive(Debug)]
pub(crate) struct Endpoint {
    key: CookieKey,
    prefix: &'static [u8],
    limits: EndpointLimits,
    budgets: ReassemblyBudgets,
    table: ConnectionTable,
    answers: AnswerQueue,
    /// Connections that may have something to send.
    ready: VecDeque<u64>,
    timers: Timers,
    deliveries: DeliveryQueue,
}

impl Endpoint {
    /// Creates a port without connections. Each datagram begins with `prefix`.
    pub(crate) fn new(secret: [u8; 32], prefix: &'static [u8], limits: EndpointLimits) -> Self {
        Self {
            key: CookieKey::new(secret),
            prefix,
            budgets: ReassemblyBudgets::new(limits.reassembly, limits.max_unfinished_bytes),
            limits,
            table: ConnectionTable::default(),
            answers: AnswerQueue::new(prefix),
            ready: VecDeque::new(),
            timers: Timers::default(),
            deliveries: DeliveryQueue::default(),
        }
    }

    /// Handles a datagram without its prefix. `local` is the address of this machine at which it arrived.
    pub(crate) fn receive(&mut self, source: SocketAddr, local: Option<IpAddr>, body: &[u8], now: MonoTime) {
        let packet = match Packet::read(Role::Cloud, body) {
            Ok(packet) => packet,
            Err(error) => return self.report_invalid(source, error.to_string()),
        };
        // An answer to a packet without a reply port goes to the packet's source.
        let source_route = Route { to: source, from: local };
        match packet {
            Packet::Hello { version, nonce, reply_port } => {
                if version != VERSION {
                    return self.report_invalid(
                        source,
                        format!("a hello of protocol version {version}; this end speaks version {VERSION}"),
                    );
                }
                let to = reply_address(source, reply_port);
                // No state is kept before the cookie comes back, so forged hellos fill no memory.
                let cookie = self.key.cookie(to, nonce, now);
                self.answers.push(Route { to, from: local }, &Packet::Cookie { nonce, cookie });
            }
            Packet::Open { nonce, cookie, reply_port, terms } => {
                let to = reply_address(source, reply_port);
                if self.key.is_valid_cookie(&cookie, to, nonce, now) {
                    self.open((source, reply_port), local, nonce, terms, now);
                } else {
                    self.report_invalid(source, "a cookie of another address, or an expired cookie".into());
                }
            }
            packet => {
                let Some(connection) = packet.connection() else { return };
                if self.table.contains(connection) {
                    return self.receive_from_connection(connection, source_route, body.len(), packet, now);
                }
                match packet {
                    // The connection has ended here. The other end repeats its goodbye until the goodbye is confirmed.
                    Packet::Bye { .. } => self.answers.push(source_route, &Packet::ByeAck { connection }),
                    // A reset is sent only to an end that still uses the connection.
                    Packet::Data { .. } | Packet::Ping { .. } => {
                        self.answers.push(
                            source_route,
                            &Packet::Reset { id: connection, reason: ResetReason::Unknown },
                        );
                    }
                    _ => {}
                }
            }
        }
    }

    fn open(
        &mut self,
        (source, reply_port): (SocketAddr, u16),
        local: Option<IpAddr>,
        nonce: u64,
        terms: Terms,
        now: MonoTime,
    ) {
        let to = reply_address(source, reply_port);
        let route = Route { to, from: local };
        let local_terms = self.limits.terms;
        // The prefix and a fragment's header must leave room for a fragment.
        let max_datagram_bytes =
            terms.max_datagram_bytes.min(local_terms.max_datagram_bytes).max(MIN_DATAGRAM_BYTES);
        // The edge repeats the request until the answer arrives, so the connection may exist already.
        let existing = self.table.find(to, nonce);
        if existing.is_none() && !self.make_room(AddressGroup::from_address(source)) {
            tracing::debug!(%source, "refused a connection: the maximum number of connections is open");
            let refusal = Packet::Reset { id: nonce, reason: ResetReason::Full };
            return self.answers.push(route, &refusal);
        }
        let id = existing.unwrap_or_else(|| self.key.connection_number(self.table.opened_count() + 1));
        let connect = || {
            let writer = PacketWriter::new(Role::Cloud, id, self.prefix);
            let terms = Terms { max_datagram_bytes, ..terms };
            Connection::new(writer, terms, self.limits.connection, self.budgets.unadmitted_limits(), now)
        };
        let max_datagram_bytes = match self.table.get_mut(id) {
            // An edge that gets no answer to a large datagram repeats the request with a smaller datagram.
            Some(entry) if entry.max_datagram_bytes != max_datagram_bytes && !entry.has_delivered => {
                (entry.connection, entry.max_datagram_bytes) = (connect(), max_datagram_bytes);
                max_datagram_bytes
            }
            Some(entry) => entry.max_datagram_bytes,
            None => {
                // Every connection begins without a session and with the small limits of such connections.
                let admission = Admission::Unadmitted { since: now };
                let entry =
                    Entry::new(connect(), (source, reply_port), local, nonce, max_datagram_bytes, admission);
                self.table.insert(id, entry);
                max_datagram_bytes
            }
        };
        let opened =
            Packet::Opened { nonce, connection: id, terms: Terms { max_datagram_bytes, ..local_terms } };
        // The answer is as long as the longest datagram that will be sent, so that a path with a smaller MTU is noticed
        // at once.
        self.answers.push_padded(route, &opened, max_datagram_bytes.into());
        self.schedule(id, now);
    }

    /// Returns whether one more connection may be opened. If a limit is reached, closes a connection without a session.
    fn make_room(&mut self, group: AddressGroup) -> bool {
        match self.table.capacity(group, self.limits.max_connections) {
            Capacity::Free => true,
            Capacity::Full => false,
            Capacity::FreeAfterClosing(id) => {
                self.close_now(id, "a newer connection replaced this connection");
                self.collect_events(id);
                true
            }
        }
    }

    fn receive_from_connection(
        &mut self,
        id: u64,
        source_route: Route,
        bytes: usize,
        packet: Packet<'_>,
        now: MonoTime,
    ) {
        let Some(entry) = self.table.get_mut(id) else { return };
        // The address of this machine may change too, for example after a route has changed.
        if source_route.to == entry.source {
            entry.local = source_route.from;
        } else if let Packet::PathResponse { token, .. } = packet {
            let to = reply_address(source_route.to, entry.reply_port);
            let is_token_of = |made_at: MonoTime| token == first_u64(&self.key.cookie(to, id, made_at));
            // The token may have been made in the previous period.
            if is_token_of(now) || is_token_of(now - COOKIE_LIFETIME) {
                self.table.relocate(id, source_route.to, source_route.from);
                self.deliveries.push(ListenerEvent::Moved(ConnectionId(id), source_route.to), None);
            }
        } else if bytes >= PATH_CHALLENGE_BYTES
            && entry
                .path_challenged_at
                .is_none_or(|challenged_at| now - challenged_at >= PATH_CHALLENGE_INTERVAL)
        {
            entry.path_challenged_at = Some(now);
            let to = reply_address(source_route.to, entry.reply_port);
            // The token is a cookie of the new address, so that this end stores nothing about an unverified address.
            let token = first_u64(&self.key.cookie(to, id, now));
            self.answers.push(
                Route { to, from: source_route.from },
                &Packet::PathChallenge { connection: id, token },
            );
        }
        if let Some(entry) = self.table.get_mut(id) {
            entry.connection.receive(packet, now);
        }
        self.collect_events(id);
    }

    fn report_invalid(&mut self, source: SocketAddr, problem: String) {
        self.deliveries.push(ListenerEvent::InvalidData(Some(source), problem), None);
    }

    /// Collects the events of a connection, and notes that it may have something to send.
    fn collect_events(&mut self, id: u64) {
        let Some(entry) = self.table.get_mut(id) else { return };
        let connection = ConnectionId(id);
        while let Some(event) = entry.connection.next_event() {
            let (listener_event, reserved) = match event {
                Event::Message(frames, reserved) => {
                    entry.has_delivered = true;
                    let peer = Peer { connection, address: Some(entry.source) };
                    (ListenerEvent::Message(peer, frames), Some(reserved))
                }
                Event::IncomingLost(loss) => (ListenerEvent::IncomingLost(connection, loss), None),
                Event::OutgoingLost(loss) => (ListenerEvent::OutgoingLost(connection, loss), None),
                Event::InvalidData(problem) => {
                    (ListenerEvent::InvalidData(Some(entry.source), problem), None)
                }
                // The layer above does not know a connection that has not delivered a message.
                Event::Gone(_) if !entry.has_delivered => continue,
                Event::Gone(reason) => (ListenerEvent::Gone(connection, reason), None),
            };
            self.deliveries.push(listener_event, reserved);
        }
        // Each connection is in the queue at most once, so that every connection gets its turn.
        if !entry.is_ready {
            entry.is_ready = true;
            self.ready.push_back(id);
        }
    }

    /// Removes and returns the next delivery.
    pub(crate) fn next_delivery(&mut self) -> Option<Delivery> {
        self.deliveries.pop()
    }

    /// Queues a message for a connection.
    ///
    /// # Errors
    /// If too many messages wait already, or the connection is gone.
    pub(crate) fn send(
        &mut self,
        id: ConnectionId,
        frames: Frames,
        tag: Option<u64>,
    ) -> Result<(), SendFailure> {
        let entry = self.table.get_mut(id.0);
        let entry = entry.ok_or_else(|| SendFailure::Gone("the peer is gone".into()))?;
        entry.connection.send(frames, tag, None)?;
        self.collect_events(id.0);
        Ok(())
    }

    /// Notes that the connection has asked for a session and waits for the decision.
    pub(crate) fn note_hello(&mut self, id: ConnectionId) {
        if let Some(entry) = self.table.get_mut(id.0)
            && matches!(entry.admission, Admission::Unadmitted { .. })
        {
            entry.admission = Admission::Greeted;
        }
    }

    /// Returns the statistics of a connection; empty statistics if the connection is over.
    pub(crate) fn statistics(&mut self, id: ConnectionId, now: MonoTime) -> TransportStatistics {
        let entry = self.table.get_mut(id.0);
        entry.map(|entry| entry.connection.statistics(now)).unwrap_or_default()
    }

    /// Notes that the connection has a session.
    pub(crate) fn admit(&mut self, id: ConnectionId) {
        let (limits, budget) = self.budgets.admitted_limits();
        if let Some(entry) = self.table.get_mut(id.0) {
            entry.admission = Admission::Admitted;
            entry.connection.set_reassembly(limits, budget);
        }
    }

    /// Notes that the connection has no session any more.
    pub(crate) fn demote(&mut self, id: ConnectionId, now: MonoTime) {
        let (limits, budget) = self.budgets.unadmitted_limits();
        if let Some(entry) = self.table.get_mut(id.0) {
            entry.admission = Admission::Unadmitted { since: now };
            entry.connection.set_reassembly(limits, budget);
        }
    }

    /// Runs the timers that have expired at `now`.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        while let Some(id) = self.timers.take_due(now) {
            let Some(entry) = self.table.get_mut(id) else { continue };
            if entry.has_missed_hello_timeout(self.limits.hello_timeout, now) && !entry.connection.is_closed()
            {
                self.close_now(id, "no session was requested in time");
            } else {
                entry.connection.tick(now);
            }
            self.collect_events(id);
            self.schedule(id, now);
        }
    }

    /// Schedules the next timer call of a connection. After a packet or a message, [`fill`](Self::fill) makes this call
    /// as soon as the connection has nothing more to send.
    fn schedule(&mut self, id: u64, now: MonoTime) {
        if let Some(entry) = self.table.get(id) {
            let timer_time = entry.next_timer(self.limits.hello_timeout, now);
            self.timers.schedule(id, timer_time.max(now + MIN_TIMER_INTERVAL));
        }
    }

    fn close_now(&mut self, id: u64, reason: &str) {
        if let Some(entry) = self.table.get_mut(id) {
            // `end` is called first, because `abandon` reports no event.
            entry.connection.end(reason);
            entry.connection.abandon();
        }
    }

    /// Returns the latest time for the next call of [`tick`](Self::tick).
    pub(crate) fn next_timer(&self) -> Option<MonoTime> {
        self.timers.next_time()
    }

    /// Appends datagrams that may be sent now. Returns their route; `None` if there are none.
    pub(crate) fn fill(
        &mut self,
        out: &mut Vec<u8>,
        max_datagrams: usize,
        now: MonoTime,
    ) -> Option<(Route, Batch)> {
        if let Some((route, answer)) = self.answers.pop() {
            out.extend_from_slice(&answer);
            return Some((route, Batch { segment: answer.len(), count: 1 }));
        }
        // Every change of a connection makes it ready, so connections that are not ready have nothing to send.
        while let Some(id) = self.ready.pop_front() {
            let Some(entry) = self.table.get_mut(id) else { continue };
            if let Some(batch) = entry.connection.fill(out, max_datagrams, now) {
                let route = Route { to: entry.reply_address(), from: entry.local };
                self.ready.push_back(id);
                return Some((route, batch));
            }
            entry.is_ready = false;
            if entry.connection.is_closed() {
                self.table.remove(id);
                self.timers.remove(id);
            } else {
                self.schedule(id, now);
            }
        }
        None
    }

    /// Starts to say goodbye to all connections.
    pub(crate) fn close(&mut self, now: MonoTime) {
        for (id, entry) in self.table.iter_mut() {
            entry.connection.close(now);
            self.timers.schedule(id, now);
        }
        self.tick(now);
    }

    /// Says goodbye to all connections once, without waiting for confirmation.
    pub(crate) fn abandon(&mut self) {
        let ids: Vec<u64> = self.table.iter_mut().map(|(id, _)| id).collect();
        for id in ids {
            if let Some(entry) = self.table.get_mut(id) {
                entry.connection.abandon();
            }
            self.collect_events(id);
        }
    }

    /// Returns whether no connection and no answer is left.
    pub(crate) fn is_empty(&self) -> bool {
        self.table.len() == 0 && self.answers.is_empty()
    }

    /// Returns the number of open connections.
    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.table.len()
    }

    /// Returns the memory of unfinished messages, and of messages that wait for the layer above. Bytes.
    pub(crate) fn reserved_bytes(&self) -> u64 {
        self.budgets.reserved_bytes()
    }
}
