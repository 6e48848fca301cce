//! State machine of all sessions of a listener at the cloud, without I/O.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::net::SocketAddr;
use std::sync::Arc;

use super::request_control::RequestControl;
use crate::SessionSettings;
use crate::message::{
    Accepted, Cancel, ClockUpdate, Goodbye, Header, Open, Outcome, PARTIAL_REPLIES_SINCE, PartialAnswersRead,
    PeerClock, RefusalKind, Refused, Reply, Request, SESSION_VERSIONS, STATISTICS_SINCE, SessionAccepted,
    SessionHello, SessionId, UnknownSession,
};
use crate::statistics::Counters;
use crate::transport::{AddressGroup, ConnectionId, Peer};
use peernet_logger::HostId;
use peernet_stream::VersionMismatch;

/// Maximum number of sessions of one connection.
const SESSIONS_PER_CONNECTION: usize = 16;

/// All sessions of a listener.
#[derive(Debug)]
pub(crate) struct Server {
    max_sessions: usize,
    max_in_flight: usize,
    max_message_bytes: u64,
    sessions: HashMap<SessionId, SessionEntry>,
    connections: HashMap<ConnectionId, Vec<SessionId>>,
    /// Last announced state of this host's clocks.
    clock: Option<PeerClock>,
}

/// An open session, or a session that an edge has asked for.
#[derive(Debug)]
struct SessionEntry {
    peer: Peer,
    /// Host id that the edge claims.
    host: HostId,
    /// Version of the protocol that was chosen.
    version: u16,
    is_accepted: bool,
    in_flight: UnansweredRequests,
    /// Largest message that the edge accepts. Bytes.
    max_message_bytes: u64,
    counters: Arc<Counters>,
}

/// Requests of a session that wait for their answers. They are cancelled when the session ends.
#[derive(Debug, Default)]
struct UnansweredRequests(HashMap<u64, Arc<RequestControl>>);

impl Drop for UnansweredRequests {
    fn drop(&mut self) {
        self.0.values().for_each(|control| control.cancel());
    }
}

/// Effect of a message from an edge.
#[derive(Debug, PartialEq)]
pub(crate) enum EdgeMessageEffect {
    /// The edge asks for a session, which has this id from now on.
    Open(SessionId, Box<SessionHello>),
    /// A request of an open session. It is in flight until [`Server::finish_request`].
    Request(Request),
    /// The caller sends this header to the edge; nothing else is to do.
    AnswerWith(Header),
    /// The message needs no answer: it changed the state of a request, or that request has ended already.
    Handled,
    /// The edge ended its session. If its run ended as well, the number is the planned number of iterations of the run.
    Closed(SessionId, Option<u64>),
    /// The message is not valid, for this reason.
    Malformed(&'static str),
}

/// Rights of a connection, derived from its sessions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// The connection has no session and waits for none.
    Unadmitted,
    /// The connection waits for a session.
    Greeted,
    /// The connection has a session.
    Admitted,
}

/// Destination of an answer.
#[derive(Clone, Debug)]
pub(crate) struct Route {
    pub(crate) peer: Peer,
    /// Largest message that the edge accepts. Bytes.
    pub(crate) max_message_bytes: u64,
    /// Version of the protocol that was chosen.
    pub(crate) version: u16,
    /// Counters for the answer.
    pub(crate) counters: Arc<Counters>,
}

/// Result of ending a request: whether its answer must be sent.
#[derive(Debug)]
pub(crate) enum FinishedRequest {
    /// The answer must be sent to the edge.
    Send(Route, Arc<RequestControl>),
    /// The edge does not wait for the answer any more.
    Cancelled,
    /// The session is gone, or the request had its answer already.
    Unknown,
}

impl SessionEntry {
    fn route(&self) -> Route {
        Route {
            peer: self.peer.clone(),
            max_message_bytes: self.max_message_bytes,
            version: self.version,
            counters: Arc::clone(&self.counters),
        }
    }
}

impl Server {
    pub(crate) fn new(settings: &SessionSettings) -> Self {
        Self {
            max_sessions: settings.max_sessions as usize,
            max_in_flight: settings.max_in_flight as usize,
            max_message_bytes: settings.max_message_bytes,
            sessions: HashMap::new(),
            connections: HashMap::new(),
            clock: None,
        }
    }

    /// Handles a message from `peer`. A session that belongs to another connection is treated as unknown.
    pub(crate) fn receive(&mut self, peer: &Peer, header: Header) -> EdgeMessageEffect {
        match header {
            Header::Open(open) => self.handle_open(peer, *open),
            Header::Request(request) => self.handle_request(peer, request),
            Header::PartialAnswersRead(PartialAnswersRead { session, request, read_count }) => {
                self.apply_to_request(peer, session, request, |control| control.acknowledge(read_count))
            }
            Header::Cancel(Cancel { session, request }) => {
                self.apply_to_request(peer, session, request, RequestControl::cancel)
            }
            Header::Goodbye(goodbye) => {
                if self.find_own_session(peer, goodbye.session).is_none() {
                    // Another connection must not end the session. The goodbye is not answered, because its sender
                    // expects no answer.
                    return EdgeMessageEffect::Malformed("a goodbye of an unknown session");
                }
                self.remove_session(goodbye.session);
                EdgeMessageEffect::Closed(goodbye.session, goodbye.planned_iterations)
            }
            Header::Accepted(_)
            | Header::Refused(_)
            | Header::Reply(_)
            | Header::PartialReply(_)
            | Header::Clock(_)
            | Header::Statistics(_)
            | Header::UnknownSession(_) => EdgeMessageEffect::Malformed("a message that only a cloud sends"),
        }
    }

    /// Returns the message that refuses an edge which speaks none of our versions of the protocol.
    pub(crate) fn version_refusal(mismatch: &VersionMismatch) -> Header {
        let reason = mismatch.describe("the session protocol", "the cloud", "the edge");
        Header::Refused(Refused { versions: SESSION_VERSIONS, kind: RefusalKind::Incompatible, reason })
    }

    /// Returns the message that refuses a session for this reason.
    fn refusal(reason: String) -> Header {
        Header::Refused(Refused { versions: SESSION_VERSIONS, kind: RefusalKind::Refused, reason })
    }

    fn handle_open(&mut self, peer: &Peer, open: Open) -> EdgeMessageEffect {
        let version = match SESSION_VERSIONS.highest_common(&open.hello.versions) {
            Ok(version) => version,
            Err(mismatch) => return EdgeMessageEffect::AnswerWith(Self::version_refusal(&mismatch)),
        };
        let connection_sessions = self.connections.get(&peer.connection).map_or(0, Vec::len);
        // Without this limit, one edge could open any number of sessions over one connection, and the limits of
        // connections per address would not protect the other edges.
        if connection_sessions >= SESSIONS_PER_CONNECTION {
            let reason = format!(
                "this connection has {SESSIONS_PER_CONNECTION} sessions already; close some of them, or open another connection"
            );
            return EdgeMessageEffect::AnswerWith(Self::refusal(reason));
        }
        if let Some(reason) = self.check_session_limits(peer, open.hello.host) {
            return EdgeMessageEffect::AnswerWith(Self::refusal(reason));
        }
        // The id is random, so that nobody can guess the session of another edge.
        let session = SessionId::random();
        let entry = SessionEntry {
            peer: peer.clone(),
            host: open.hello.host,
            version,
            is_accepted: false,
            in_flight: UnansweredRequests::default(),
            max_message_bytes: open.max_message_bytes,
            counters: Arc::default(),
        };
        self.sessions.insert(session, entry);
        self.connections.entry(peer.connection).or_default().push(session);
        EdgeMessageEffect::Open(session, Box::new(open.hello))
    }

    /// Returns the limit that one more session of this peer would exceed, as a text for the refusal. `None` if the
    /// session may be opened.
    ///
    /// One host may have half of the sessions that other hosts do not use, so that one host cannot take all sessions.
    /// Several hosts may share an address. An address may therefore have three quarters of the sessions that other
    /// addresses do not use.
    fn check_session_limits(&self, peer: &Peer, host: HostId) -> Option<String> {
        let (open_sessions, max) = (self.sessions.len(), self.max_sessions);
        if open_sessions >= max {
            return Some(format!(
                "the cloud has {open_sessions} sessions already; close some of them, or raise max_sessions on the cloud"
            ));
        }
        // Sessions that are not accepted yet count, too; otherwise a host could ask for any number of sessions at the
        // same time.
        let host_sessions = self.sessions.values().filter(|entry| entry.host == host).count();
        let unused_by_other_hosts = max - (open_sessions - host_sessions);
        // Rounded up, so that the last free session can be opened.
        let allowed = unused_by_other_hosts.div_ceil(2);
        if host_sessions >= allowed {
            return Some(format!(
                "this host has {host_sessions} sessions, and {allowed} are allowed: half of the sessions that other \
                 hosts do not use; the cloud's max_sessions is {max}; close some of the sessions, or raise max_sessions on the \
                 cloud"
            ));
        }
        // In a network without addresses, only the limit per host applies.
        let group = AddressGroup::from_address(peer.address?);
        // All programs of this machine share the loopback address.
        if group.is_loopback() {
            return None;
        }
        let is_in_group = |entry: &&SessionEntry| {
            entry.peer.address.is_some_and(|at| AddressGroup::from_address(at) == group)
        };
        let group_sessions = self.sessions.values().filter(is_in_group).count();
        let allowed = ((max - (open_sessions - group_sessions)) * 3).div_ceil(4);
        (group_sessions >= allowed).then(|| {
            format!(
                "this address has {group_sessions} sessions, and {allowed} are allowed: three quarters of the sessions \
                 that other addresses do not use; the cloud's max_sessions is {max}; close some of the sessions, or raise \
                     max_sessions on the cloud"
            )
        })
    }

    /// Returns the admission of a connection, which follows from its present sessions.
    pub(crate) fn admission(&self, connection: ConnectionId) -> Admission {
        let sessions = self.connections.get(&connection).map_or(&[][..], Vec::as_slice);
        let is_accepted = |session| self.sessions.get(session).is_some_and(|entry| entry.is_accepted);
        match sessions {
            [] => Admission::Unadmitted,
            sessions if sessions.iter().any(is_accepted) => Admission::Admitted,
            _ => Admission::Greeted,
        }
    }

    fn handle_request(&mut self, peer: &Peer, request: Request) -> EdgeMessageEffect {
        let max_in_flight = self.max_in_flight;
        let (session, number) = (request.session, request.request);
        let Some(entry) = self.find_own_session(peer, session) else {
            // An edge whose session is gone learns this from the answer to its next request.
            return EdgeMessageEffect::AnswerWith(Header::UnknownSession(UnknownSession {
                session,
                request: number,
            }));
        };
        if !entry.is_accepted {
            return EdgeMessageEffect::Malformed("a request before the session was accepted");
        }
        if entry.in_flight.0.len() >= max_in_flight {
            let outcome =
                Outcome::Overloaded(format!("{max_in_flight} requests of this session are in flight"));
            return EdgeMessageEffect::AnswerWith(Header::Reply(Reply {
                session,
                request: number,
                departure: None,
                // The edge does not read this epoch, because a reply without a departure has no stamps.
                arrival_epoch: 0,
                outcome,
                arrived_raw: None,
            }));
        }
        match entry.in_flight.0.entry(number) {
            // The edge could not tell the answers to two requests with the same number apart.
            Entry::Occupied(_) => EdgeMessageEffect::Malformed("a request whose number is in flight already"),
            Entry::Vacant(free) => {
                free.insert(Arc::default());
                EdgeMessageEffect::Request(request)
            }
        }
    }

    /// Applies a message about a request to the state of that request. Has no effect if the request has ended already.
    fn apply_to_request(
        &mut self,
        peer: &Peer,
        session: SessionId,
        request: u64,
        apply: impl FnOnce(&RequestControl),
    ) -> EdgeMessageEffect {
        let Some(entry) = self.find_own_session(peer, session) else {
            return EdgeMessageEffect::AnswerWith(Header::UnknownSession(UnknownSession {
                session,
                request,
            }));
        };
        if let Some(control) = entry.in_flight.0.get(&request) {
            apply(control);
        }
        EdgeMessageEffect::Handled
    }

    /// Returns the state of a request in flight.
    pub(crate) fn request_control(&self, session: SessionId, request: u64) -> Option<Arc<RequestControl>> {
        self.sessions.get(&session)?.in_flight.0.get(&request).cloned()
    }

    /// Returns the destination of partial answers. `None` if the session is gone or its version has no partial answers.
    pub(crate) fn route_of_partial_answers(&self, session: SessionId) -> Option<Route> {
        let entry = self.sessions.get(&session)?;
        (entry.version >= PARTIAL_REPLIES_SINCE).then(|| entry.route())
    }

    /// Returns the session if it belongs to the connection of `peer`.
    fn find_own_session(&mut self, peer: &Peer, session: SessionId) -> Option<&mut SessionEntry> {
        self.sessions.get_mut(&session).filter(|entry| entry.peer.connection == peer.connection)
    }

    /// Accepts a session that was asked for. Returns the message and its destination; `None` if the edge is gone.
    ///
    /// The announced state of the clocks replaces the state in `accepted`, because the caller may have read that state
    /// before the announcement.
    pub(crate) fn accept(
        &mut self,
        session: SessionId,
        mut accepted: SessionAccepted,
    ) -> Option<(Peer, Header)> {
        let entry = self.sessions.get_mut(&session)?;
        // The session is open before the message is sent, because the edge may send a request as soon as the message
        // arrives.
        entry.is_accepted = true;
        if let Some(clock) = &self.clock {
            accepted.host_clock.clone_from(clock);
        }
        accepted.host_clock = accepted.host_clock.in_version(entry.version);
        let header = Header::Accepted(Box::new(Accepted {
            protocol: entry.version,
            session,
            accepted,
            max_message_bytes: self.max_message_bytes,
            max_in_flight: u32::try_from(self.max_in_flight).unwrap_or(u32::MAX),
        }));
        Some((entry.peer.clone(), header))
    }

    /// Refuses a session that was asked for. Returns the message and its destination; `None` if the edge is gone.
    pub(crate) fn refuse(&mut self, session: SessionId, reason: String) -> Option<(Peer, Header)> {
        self.remove_session(session).map(|entry| (entry.peer, Self::refusal(reason)))
    }

    /// Sets the state of the clocks, which later sessions get when they are accepted. Returns the messages to the open
    /// sessions, with their destinations.
    pub(crate) fn update_clock(&mut self, clock: PeerClock) -> Vec<(Peer, Header)> {
        let open = self.sessions.iter().filter(|(_, entry)| entry.is_accepted);
        let headers = open
            .map(|(session, entry)| {
                let clock = clock.clone().in_version(entry.version);
                let update = ClockUpdate { session: *session, clock };
                (entry.peer.clone(), Header::Clock(Box::new(update)))
            })
            .collect();
        self.clock = Some(clock);
        headers
    }

    /// Returns the open sessions whose version has reports of statistics, with their counters.
    pub(crate) fn sessions_with_statistics(&self) -> Vec<(SessionId, Peer, Arc<Counters>)> {
        let gets_statistics = |entry: &SessionEntry| entry.is_accepted && entry.version >= STATISTICS_SINCE;
        let open = self.sessions.iter().filter(|(_, entry)| gets_statistics(entry));
        open.map(|(session, entry)| (*session, entry.peer.clone(), Arc::clone(&entry.counters))).collect()
    }

    /// Ends a request whose answer is complete.
    pub(crate) fn finish_request(&mut self, session: SessionId, request: u64) -> FinishedRequest {
        let Some(entry) = self.sessions.get_mut(&session) else { return FinishedRequest::Unknown };
        match entry.in_flight.0.remove(&request) {
            None => FinishedRequest::Unknown,
            Some(control) if control.is_cancelled() => FinishedRequest::Cancelled,
            Some(control) => FinishedRequest::Send(entry.route(), control),
        }
    }

    /// Puts a request back in flight because the network has not accepted its answer yet. A cancellation can then reach
    /// the request.
    pub(crate) fn restore_request(&mut self, session: SessionId, request: u64, control: Arc<RequestControl>) {
        if let Some(entry) = self.sessions.get_mut(&session) {
            entry.in_flight.0.insert(request, control);
        }
    }

    /// Notes that a message without a tag, which may be a partial answer, was lost on a connection. The request of
    /// the partial answer is unknown, so the loss counts for each request in flight on the connection. The
    /// window of a request that lost no partial answer is one place larger until the next acknowledgement.
    pub(crate) fn note_lost_partial_answer(&self, connection: ConnectionId) {
        let sessions = self.connections.get(&connection).into_iter().flatten();
        for entry in sessions.filter_map(|session| self.sessions.get(session)) {
            entry.in_flight.0.values().for_each(|control| control.note_lost_partial_answer());
        }
    }

    /// Returns the message counters of a session.
    pub(crate) fn session_counters(&self, session: SessionId) -> Option<Arc<Counters>> {
        self.sessions.get(&session).map(|entry| Arc::clone(&entry.counters))
    }

    /// Returns the message counters of a connection. Connections normally have one session; if there are several,
    /// returns the counters of the first.
    pub(crate) fn connection_counters(&self, connection: ConnectionId) -> Option<Arc<Counters>> {
        self.session_counters(self.first_session(connection)?)
    }

    /// Returns the first session of a connection.
    pub(crate) fn first_session(&self, connection: ConnectionId) -> Option<SessionId> {
        self.connections.get(&connection)?.first().copied()
    }

    /// Updates the address of a connection's peer.
    pub(crate) fn update_address(&mut self, connection: ConnectionId, address: SocketAddr) {
        for session in self.connections.get(&connection).into_iter().flatten() {
            if let Some(entry) = self.sessions.get_mut(session) {
                entry.peer.address = Some(address);
            }
        }
    }

    /// Removes and returns the sessions of a connection that ended.
    pub(crate) fn remove_connection(&mut self, connection: ConnectionId) -> Vec<SessionId> {
        let sessions = self.connections.remove(&connection).unwrap_or_default();
        for session in &sessions {
            self.sessions.remove(session);
        }
        sessions
    }

    /// Ends all sessions. Returns the messages to their edges, with their destinations.
    pub(crate) fn end_all_sessions(&mut self, reason: &str) -> Vec<(Peer, Header)> {
        self.connections.clear();
        let goodbye_of = |session, entry: SessionEntry| {
            let header = if entry.is_accepted {
                Header::Goodbye(Goodbye { session, reason: reason.to_owned(), planned_iterations: None })
            } else {
                // The edge still waits for the acceptance and has no session that a goodbye could end.
                Self::refusal(reason.to_owned())
            };
            (entry.peer, header)
        };
        self.sessions.drain().map(|(session, entry)| goodbye_of(session, entry)).collect()
    }

    /// Returns the number of requests that wait for their answer.
    pub(crate) fn in_flight_count(&self) -> usize {
        self.sessions.values().map(|entry| entry.in_flight.0.len()).sum()
    }

    fn remove_session(&mut self, session: SessionId) -> Option<SessionEntry> {
        let entry = self.sessions.remove(&session)?;
        let connection = entry.peer.connection;
        if let Some(sessions) = self.connections.get_mut(&connection) {
            sessions.retain(|listed_session| *listed_session != session);
            if sessions.is_empty() {
                self.connections.remove(&connection);
            }
        }
        Some(entry)
    }
}

#[cfg(test)]
mod tests;
