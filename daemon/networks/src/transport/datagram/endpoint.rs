//! The cloud's end of all virtual connections of a port, without I/O.

use std::collections::{HashMap, VecDeque};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use peernet_clock::{MonoTime, Span};

use super::connection::{Connection, ConnectionLimits, Event};
use super::entry::{Entry, Standing, reply_address};
use super::handshake::{CookieKey, first_u64};
use super::packet::{Packet, ResetReason, Role, Terms, VERSION};
use super::packet_writer::PacketWriter;
use super::partial_message::PEAK_COST;
use super::reassembly::ReassemblyLimits;
use super::sending::Batch;
use super::timers::Timers;
use crate::statistics::TransportStatistics;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{AddressGroup, Arrival, ConnectionId, Frames, Peer, SendFailure};

/// Largest message of a connection without a session.
const MAX_UNADMITTED_BYTES: u32 = 64 * 1024;

/// Unfinished messages of a connection without a session.
const MAX_UNADMITTED_MESSAGES: usize = 2;

/// Memory for the unfinished messages of all connections without a session.
const MAX_ALL_UNADMITTED_BYTES: u64 = 16 * 1024 * 1024;

/// How often a connection's new address is asked whether it is one.
const PATH_PAUSE: Span = Span::from_millis(100);

/// Bytes of the packet that asks, and the least that it is an answer to.
const PATH_BYTES: usize = 17;

/// The shortest time between two looks at a connection.
const SOON: Span = Span::from_millis(1);

/// Most answers to strangers that wait to be sent.
const MAX_ANSWERS: usize = 256;

/// Most arrivals that wait to be handed out; more come when the layer above does not take them.
const MAX_ARRIVALS: usize = 1_024;

/// Time limits and bounds of a port.
#[derive(Clone, Debug)]
pub(crate) struct EndpointLimits {
    pub(crate) connection: ConnectionLimits,
    /// Of connections that have a session.
    pub(crate) reassembly: ReassemblyLimits,
    /// Memory for the unfinished messages of all of these.
    pub(crate) max_unfinished_bytes: u64,
    pub(crate) max_connections: usize,
    /// How long a connection may exist without a session or a request for one.
    pub(crate) hello_timeout: Span,
    /// What this end takes.
    pub(crate) terms: Terms,
}

/// Where datagrams go to, and from which address of this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Route {
    pub(crate) to: SocketAddr,
    pub(crate) from: Option<IpAddr>,
}

/// Something that arrived, and the memory that it takes.
#[derive(Debug)]
pub(crate) struct Delivery {
    pub(crate) arrival: Arrival,
    pub(crate) _reserved: Option<Reservation>,
}

/// All connections of a port.
#[derive(Debug)]
pub(crate) struct Endpoint {
    key: CookieKey,
    prefix: &'static [u8],
    limits: EndpointLimits,
    unadmitted: Arc<MemoryBudget>,
    admitted: Arc<MemoryBudget>,
    entries: HashMap<u64, Entry>,
    nonces: HashMap<(SocketAddr, u64), u64>,
    opened: u64,
    /// Answers to those who have no connection.
    answers: VecDeque<(Route, Vec<u8>)>,
    /// Connections that may have something to send.
    ready: VecDeque<u64>,
    timers: Timers,
    arrivals: VecDeque<Delivery>,
}

impl Endpoint {
    pub(crate) fn new(secret: [u8; 32], prefix: &'static [u8], limits: EndpointLimits) -> Self {
        let largest = u64::from(limits.reassembly.max_message_bytes) * PEAK_COST;
        Self {
            key: CookieKey::new(secret),
            prefix,
            unadmitted: MemoryBudget::new(MAX_ALL_UNADMITTED_BYTES),
            // One largest message alone always fits, in whatever order its fragments come.
            admitted: MemoryBudget::new(limits.max_unfinished_bytes.max(largest)),
            limits,
            entries: HashMap::new(),
            nonces: HashMap::new(),
            opened: 0,
            answers: VecDeque::new(),
            ready: VecDeque::new(),
            timers: Timers::default(),
            arrivals: VecDeque::new(),
        }
    }

    /// A body arrived from an address, at one of this machine's.
    pub(crate) fn hear(&mut self, source: SocketAddr, local: Option<IpAddr>, body: &[u8], now: MonoTime) {
        let packet = match Packet::read(Role::Cloud, body) {
            Ok(packet) => packet,
            Err(error) => return self.garbage(source, error.to_string()),
        };
        let back = Route { to: source, from: local };
        match packet {
            Packet::Hello { version, nonce, reply_port } => {
                if version != VERSION {
                    return self.garbage(source, format!("a hello of version {version}"));
                }
                let to = reply_address(source, reply_port);
                let cookie = self.key.cookie(to, nonce, now);
                self.answer(Route { to, from: local }, Packet::Cookie { nonce, cookie });
            }
            Packet::Open { nonce, cookie, reply_port, terms } => {
                let to = reply_address(source, reply_port);
                if self.key.is_cookie(&cookie, to, nonce, now) {
                    self.open((source, reply_port), local, nonce, terms, now);
                } else {
                    self.garbage(source, "a cookie that is not for this address, or too old".into());
                }
            }
            packet => {
                let Some(connection) = packet.connection() else { return };
                if self.entries.contains_key(&connection) {
                    return self.hear_known(connection, back, body.len(), packet, now);
                }
                match packet {
                    Packet::Bye { .. } => self.answer(back, Packet::ByeHeard { connection }),
                    Packet::Data { .. } | Packet::Ping { .. } => {
                        self.answer(back, Packet::Reset { id: connection, reason: ResetReason::Unknown });
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
        let known = self.nonces.get(&(to, nonce)).copied();
        let id = match known {
            Some(id) => id,
            None if !self.make_room(AddressGroup::of(source)) => {
                tracing::debug!(%source, "refused a connection: as many are open as are allowed");
                let refused = Packet::Reset { id: nonce, reason: ResetReason::Full };
                return self.answer(Route { to, from: local }, refused);
            }
            None => {
                self.opened += 1;
                let id = self.key.connection(self.opened);
                self.nonces.insert((to, nonce), id);
                id
            }
        };
        let own = self.limits.terms;
        // The prefix and a fragment's header must leave room for a fragment.
        let datagram = terms.datagram.min(own.datagram).max(super::MIN_DATAGRAM_BYTES);
        let limits = self.limits.connection;
        let prefix = self.prefix;
        let reassembly = || (unadmitted_limits(&self.limits.reassembly), Arc::clone(&self.unadmitted));
        let entry = self.entries.entry(id).or_insert_with(|| Entry {
            connection: Connection::new(
                PacketWriter::new(Role::Cloud, id, prefix),
                Terms { datagram, ..terms },
                limits,
                reassembly(),
                now,
            ),
            source,
            reply_port,
            local,
            nonce,
            datagram,
            standing: Standing::Unadmitted { since: now },
            path_asked: None,
            has_delivered: false,
            is_ready: false,
        });
        // An edge that found no answer to a large datagram asks for smaller ones.
        if entry.datagram != datagram && !entry.has_delivered {
            entry.datagram = datagram;
            entry.connection = Connection::new(
                PacketWriter::new(Role::Cloud, id, prefix),
                Terms { datagram, ..terms },
                limits,
                reassembly(),
                now,
            );
        }
        let datagram = entry.datagram;
        let mut answer = self.prefix.to_vec();
        let terms = Terms { datagram, ..own };
        Packet::Opened { nonce, connection: id, terms }.write(Role::Cloud, &mut answer);
        // As long as the longest that will be sent: what does not fit on the path is noticed at once.
        answer.resize(answer.len().max(datagram.into()), 0);
        self.push_answer(Route { to, from: local }, answer);
        self.schedule(id, now);
    }

    /// Whether one more connection may be opened. One without a session makes room: the oldest of the same address, or
    /// else of the address that has most of them.
    fn make_room(&mut self, group: AddressGroup) -> bool {
        let max = self.limits.max_connections.max(1);
        let mut groups: HashMap<AddressGroup, (usize, usize)> = HashMap::new();
        for entry in self.entries.values() {
            let (all, unadmitted) = groups.entry(AddressGroup::of(entry.source)).or_default();
            *all += 1;
            *unadmitted += usize::from(matches!(entry.standing, Standing::Unadmitted { .. }));
        }
        let of_group = groups.get(&group).copied().unwrap_or_default();
        let unadmitted: usize = groups.values().map(|(_, unadmitted)| unadmitted).sum();
        let half = (max / 2).max(1);
        let crowded = if (!group.is_loopback() && of_group.0 >= half) || of_group.1 >= (max / 4).max(1) {
            group
        } else if self.entries.len() >= max || unadmitted >= half {
            let most = groups.iter().max_by_key(|(_, (_, unadmitted))| *unadmitted);
            most.map_or(group, |(group, _)| *group)
        } else {
            return true;
        };
        let oldest = self
            .entries
            .iter()
            .filter(|(_, entry)| AddressGroup::of(entry.source) == crowded)
            .filter_map(|(id, entry)| match entry.standing {
                Standing::Unadmitted { since } => Some((since, *id)),
                _ => None,
            })
            .min();
        let Some((_, id)) = oldest else { return false };
        self.close_now(id, "it made room for another connection");
        self.collect(id);
        true
    }

    fn hear_known(&mut self, id: u64, back: Route, bytes: usize, packet: Packet<'_>, now: MonoTime) {
        let Some(entry) = self.entries.get_mut(&id) else { return };
        if back.to == entry.source {
            entry.local = back.from;
        } else if let Packet::PathConfirmed { token, .. } = packet {
            let to = reply_address(back.to, entry.reply_port);
            let is_token = |period: MonoTime| token == first_u64(&self.key.cookie(to, id, period));
            if is_token(now) || is_token(now - Span::from_seconds(10)) {
                self.nonces.remove(&(reply_address(entry.source, entry.reply_port), entry.nonce));
                (entry.source, entry.local) = (back.to, back.from);
                self.nonces.insert((to, entry.nonce), id);
                let moved = Arrival::Moved(ConnectionId(id), back.to);
                self.arrivals.push_back(Delivery { arrival: moved, _reserved: None });
            }
        } else if bytes >= PATH_BYTES && entry.path_asked.is_none_or(|asked| now - asked >= PATH_PAUSE) {
            entry.path_asked = Some(now);
            let to = reply_address(back.to, entry.reply_port);
            let token = first_u64(&self.key.cookie(to, id, now));
            self.answer(Route { to, from: back.from }, Packet::Path { connection: id, token });
        }
        if let Some(entry) = self.entries.get_mut(&id) {
            entry.connection.hear(packet, now);
        }
        self.collect(id);
    }

    fn garbage(&mut self, source: SocketAddr, problem: String) {
        let arrival = Arrival::Garbage(Some(source), problem);
        if self.arrivals.len() < MAX_ARRIVALS {
            self.arrivals.push_back(Delivery { arrival, _reserved: None });
        }
    }

    fn answer(&mut self, route: Route, packet: Packet<'_>) {
        let mut answer = self.prefix.to_vec();
        packet.write(Role::Cloud, &mut answer);
        self.push_answer(route, answer);
    }

    fn push_answer(&mut self, route: Route, answer: Vec<u8>) {
        // Whoever is not answered asks again.
        if self.answers.len() < MAX_ANSWERS {
            self.answers.push_back((route, answer));
        }
    }

    /// Takes what a connection has to tell, and notes that it may have something to send.
    fn collect(&mut self, id: u64) {
        let Some(entry) = self.entries.get_mut(&id) else { return };
        let connection = ConnectionId(id);
        while let Some(event) = entry.connection.next_event() {
            let (arrival, _reserved) = match event {
                Event::Message(frames, reserved) => {
                    entry.has_delivered = true;
                    let peer = Peer { connection, address: Some(entry.source) };
                    (Arrival::Message(peer, frames), Some(reserved))
                }
                Event::Incomplete(loss) => (Arrival::Incomplete(connection, loss), None),
                Event::Lost(loss) => (Arrival::Lost(connection, loss), None),
                Event::Garbage(problem) => (Arrival::Garbage(Some(entry.source), problem), None),
                Event::Gone(_) if !entry.has_delivered => continue,
                Event::Gone(reason) => (Arrival::Gone(connection, reason), None),
            };
            let is_droppable =
                matches!(arrival, Arrival::Garbage(..) | Arrival::Incomplete(..) | Arrival::Lost(..));
            if !is_droppable || self.arrivals.len() < MAX_ARRIVALS {
                self.arrivals.push_back(Delivery { arrival, _reserved });
            }
        }
        if !entry.is_ready {
            entry.is_ready = true;
            self.ready.push_back(id);
        }
    }

    /// What arrived next.
    pub(crate) fn next_arrival(&mut self) -> Option<Delivery> {
        self.arrivals.pop_front()
    }

    /// Queues a message to a connection.
    ///
    /// # Errors
    /// When too much waits already, or the connection is gone.
    pub(crate) fn send(
        &mut self,
        id: ConnectionId,
        frames: Frames,
        tag: Option<u64>,
    ) -> Result<(), SendFailure> {
        let entry = self.entries.get_mut(&id.0);
        let entry = entry.ok_or_else(|| SendFailure::Gone("the peer is gone".into()))?;
        entry.connection.send(frames, tag, None)?;
        self.collect(id.0);
        Ok(())
    }

    /// The connection's hello is being decided on.
    pub(crate) fn greet(&mut self, id: ConnectionId) {
        if let Some(entry) = self.entries.get_mut(&id.0)
            && matches!(entry.standing, Standing::Unadmitted { .. })
        {
            entry.standing = Standing::Greeted;
        }
    }

    /// Returns what is known of a connection; nothing when it is over.
    pub(crate) fn statistics(&mut self, id: ConnectionId, now: MonoTime) -> TransportStatistics {
        let entry = self.entries.get_mut(&id.0);
        entry.map(|entry| entry.connection.statistics(now)).unwrap_or_default()
    }

    /// The connection has a session.
    pub(crate) fn admit(&mut self, id: ConnectionId) {
        let (limits, budget) = (self.limits.reassembly, Arc::clone(&self.admitted));
        if let Some(entry) = self.entries.get_mut(&id.0) {
            entry.standing = Standing::Admitted;
            entry.connection.set_reassembly(limits, budget);
        }
    }

    /// The connection has no session any more.
    pub(crate) fn demote(&mut self, id: ConnectionId, now: MonoTime) {
        let limits = unadmitted_limits(&self.limits.reassembly);
        let budget = Arc::clone(&self.unadmitted);
        if let Some(entry) = self.entries.get_mut(&id.0) {
            entry.standing = Standing::Unadmitted { since: now };
            entry.connection.set_reassembly(limits, budget);
        }
    }

    /// Does what is due.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        while let Some(id) = self.timers.take_due(now) {
            let Some(entry) = self.entries.get_mut(&id) else { continue };
            if entry.is_late(self.limits.hello_timeout, now) && !entry.connection.is_closed() {
                self.close_now(id, "no hello came in time");
            } else {
                entry.connection.tick(now);
            }
            self.collect(id);
            self.schedule(id, now);
        }
    }

    /// Sees to it that a connection is looked at in time. Called after each change.
    fn schedule(&mut self, id: u64, now: MonoTime) {
        if let Some(entry) = self.entries.get(&id) {
            let at = entry.next_timer(self.limits.hello_timeout, now);
            self.timers.bring_forward(id, at.max(now + SOON));
        }
    }

    fn close_now(&mut self, id: u64, reason: &str) {
        if let Some(entry) = self.entries.get_mut(&id) {
            entry.connection.end(reason);
            entry.connection.abandon();
        }
    }

    /// When [`tick`](Self::tick) is to be called at the latest.
    pub(crate) fn next_timer(&self) -> Option<MonoTime> {
        self.timers.next()
    }

    /// Appends datagrams that leave now. Returns where they go; `None` when there are none.
    pub(crate) fn fill(&mut self, out: &mut Vec<u8>, most: usize, now: MonoTime) -> Option<(Route, Batch)> {
        if let Some((route, answer)) = self.answers.pop_front() {
            out.extend_from_slice(&answer);
            return Some((route, Batch { segment: answer.len(), count: 1 }));
        }
        // Whatever changes a connection makes it ready.
        while let Some(id) = self.ready.pop_front() {
            let Some(entry) = self.entries.get_mut(&id) else { continue };
            let to = reply_address(entry.source, entry.reply_port);
            if let Some(batch) = entry.connection.fill(out, most, now) {
                let route = Route { to, from: entry.local };
                self.ready.push_back(id);
                return Some((route, batch));
            }
            entry.is_ready = false;
            if entry.connection.is_closed() {
                self.nonces.remove(&(to, entry.nonce));
                self.entries.remove(&id);
                self.timers.remove(id);
            } else {
                self.schedule(id, now);
            }
        }
        None
    }

    /// Begins to say goodbye to all.
    pub(crate) fn close(&mut self, now: MonoTime) {
        for (id, entry) in &mut self.entries {
            entry.connection.close(now);
            self.timers.bring_forward(*id, now);
        }
        self.tick(now);
    }

    /// Says goodbye to all, once.
    pub(crate) fn abandon(&mut self) {
        let ids: Vec<u64> = self.entries.keys().copied().collect();
        for id in ids {
            if let Some(entry) = self.entries.get_mut(&id) {
                entry.connection.abandon();
            }
            self.collect(id);
        }
    }

    /// Whether no connection is left.
    pub(crate) fn is_empty(&self) -> bool {
        self.entries.is_empty() && self.answers.is_empty()
    }

    /// Connections that are open.
    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.entries.len()
    }

    /// Memory that unfinished messages, and messages that were not handed on, take.
    pub(crate) fn held_bytes(&self) -> u64 {
        self.admitted.held() + self.unadmitted.held()
    }
}

/// What may arrive on a connection without a session.
fn unadmitted_limits(admitted: &ReassemblyLimits) -> ReassemblyLimits {
    ReassemblyLimits {
        max_message_bytes: MAX_UNADMITTED_BYTES.min(admitted.max_message_bytes),
        max_unfinished_messages: MAX_UNADMITTED_MESSAGES,
        ..*admitted
    }
}
