//! The cloud's driver: all sessions of a port.

use std::collections::VecDeque;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use peernet_clock::{LogThrottle, MonoTime, SharedClock, Stamp};
use peernet_logger::{HostId, Recorder, TreeError};
use peernet_sample::Sample;
use tokio::sync::Notify;

use super::announcer::Announcer;
use super::bind_error::BindError;
use super::budget::Budget;
use super::exchange::Sizes;
use super::incoming::{ArrivalStamp, Failure, Incoming, IncomingRequest, OpenRequest, Responder, Ticket};
use super::server::{Heard, Route, Server, Standing};
use crate::message::{
    CountedAtCloud, Departure, Header, HeaderError, MAX_FRAMES, Outcome, PeerClock, RAW_STAMPS_SINCE, Reply,
    Request, SampleHeader, SessionAccepted, SessionId, TreeFrameError, decode_tree, encode_growth,
    put_upload,
};
use crate::statistics::{ConnectionStatistics, Counters, TransportStatistics};
use crate::transport::{
    Arrival, BindFailure, CloudReceiver, CloudSender, ConnectionId, Frames, Peer, SendOptions,
};
use crate::{Address, SessionSettings};

/// A port at which edges open sessions.
#[derive(Debug)]
pub struct Listener {
    shared: Arc<PortState>,
    receiver: Box<dyn CloudReceiver>,
    address: Address,
    caveat: Option<String>,
    settings: SessionSettings,
    /// Sessions that ended together, to be handed out one by one.
    closed: VecDeque<SessionId>,
}

/// What the listener and all answers under way have in common. Answers hold it weakly: when the listener goes,
/// the connections go.
#[derive(Debug)]
pub(crate) struct PortState {
    machine: Mutex<Server>,
    budget: Arc<Budget>,
    sender: Box<dyn CloudSender>,
    clock: SharedClock,
    host: HostId,
    counters: Counters,
    log_throttle: Mutex<LogThrottle>,
    /// Answers that are being sent: their requests are no longer in flight.
    sending: AtomicUsize,
    answered: Notify,
}

impl Listener {
    /// Listens at `address`, on the network that its scheme selects; port 0 lets the system choose one.
    ///
    /// # Errors
    /// When the port is taken or the address is not this machine's; says what to do.
    pub async fn bind(
        address: &Address,
        settings: SessionSettings,
        host: HostId,
        clock: SharedClock,
    ) -> Result<Self, BindError> {
        Self::bind_one_of(NonZeroUsize::MIN, address, settings, host, clock).await
    }

    /// Listens at several addresses. The settings hold for each of them; the connections that the process may have are
    /// shared.
    ///
    /// # Errors
    /// Those of [`bind`](Self::bind), for the first address that cannot be had; the others are closed again.
    pub async fn bind_all(
        addresses: &[Address],
        settings: &SessionSettings,
        host: HostId,
        clock: &SharedClock,
    ) -> Result<Vec<Self>, BindError> {
        let ports = NonZeroUsize::new(addresses.len()).unwrap_or(NonZeroUsize::MIN);
        let mut listeners = Vec::with_capacity(addresses.len());
        for address in addresses {
            let (settings, clock) = (settings.clone(), SharedClock::clone(clock));
            listeners.push(Self::bind_one_of(ports, address, settings, host, clock).await?);
        }
        Ok(listeners)
    }

    /// Listens at one of so many addresses.
    async fn bind_one_of(
        ports: NonZeroUsize,
        address: &Address,
        settings: SessionSettings,
        host: HostId,
        clock: SharedClock,
    ) -> Result<Self, BindError> {
        let settings = settings.clamped();
        let bound = address.network().bind(address, &settings, ports, &clock).await;
        let bound = bound.map_err(|failure| match failure {
            BindFailure::InUse => BindError::InUse(address.clone()),
            BindFailure::Denied => BindError::Denied(address.clone()),
            BindFailure::NotLocal => BindError::NotLocal(address.clone()),
            BindFailure::Other(reason) => BindError::Other(address.clone(), reason),
        })?;
        let shared = Arc::new(PortState {
            machine: Mutex::new(Server::new(&settings)),
            budget: Budget::new(settings.max_in_flight_bytes),
            sender: bound.sender,
            clock,
            host,
            counters: Counters::default(),
            log_throttle: Mutex::default(),
            sending: AtomicUsize::new(0),
            answered: Notify::new(),
        });
        let closed = VecDeque::new();
        let (receiver, address, caveat) = (bound.receiver, bound.address, bound.caveat);
        Ok(Self { shared, receiver, address, caveat, settings, closed })
    }

    /// Where it listens, with the real port.
    pub const fn address(&self) -> &Address {
        &self.address
    }

    /// What makes all of its connections worse than they could be, and what to do about it, in words.
    pub fn caveat(&self) -> Option<&str> {
        self.caveat.as_deref()
    }

    /// Returns what was sent and received on all connections together, since the listener was bound.
    pub fn statistics(&self) -> ConnectionStatistics {
        self.shared.counters.statistics(&TransportStatistics::default())
    }

    /// Tells the sessions of this port what becomes known of this host's clock.
    pub fn announcer(&self) -> Announcer {
        Announcer::new(Arc::downgrade(&self.shared))
    }

    /// What arrives next; `None` when the socket is closed. Dropping the future loses nothing.
    pub async fn next(&mut self) -> Option<Incoming> {
        loop {
            if let Some(session) = self.closed.pop_front() {
                return Some(Incoming::Closed { session, said_goodbye: false, ordered: None });
            }
            match self.receiver.receive().await? {
                Arrival::Message(peer, frames) => {
                    // Before the stamp, as the one at the answer is after it: if they are equal, so is all in between.
                    let (epoch, wall_epoch) = (self.shared.clock.epoch(), self.shared.clock.wall_epoch());
                    let received = self.shared.clock.stamp();
                    let arrival = ArrivalStamp { raw: received.raw, epoch, wall_epoch };
                    if let Some(incoming) = heard(&self.shared, &peer, frames, (received, arrival)) {
                        return Some(incoming);
                    }
                }
                Arrival::Incomplete(connection, loss) => {
                    tracing::debug!(?connection, %loss, "a message of an edge was lost on the way");
                }
                Arrival::Lost(connection, loss) => {
                    tracing::debug!(?connection, %loss, "an answer was lost on the way");
                    self.shared.counters.lost(1);
                    if let Some(counters) = self.shared.machine().counters_of(connection) {
                        counters.lost(1);
                    }
                }
                Arrival::Moved(connection, address) => {
                    tracing::debug!(?connection, %address, "an edge has another address");
                    self.shared.machine().moved(connection, address);
                }
                Arrival::Gone(connection, reason) => {
                    let sessions = self.shared.machine().gone(connection);
                    tracing::debug!(reason, sessions = sessions.len(), "an edge's connection ended");
                    self.closed.extend(sessions);
                }
                Arrival::Remark(connection, text) => {
                    let session = self.shared.machine().session_of(connection);
                    return Some(Incoming::Remark { session, text });
                }
                Arrival::Refused(host, text) => return Some(Incoming::Refused { host, text }),
                Arrival::Garbage(address, problem) => {
                    // The transport has logged it.
                    tracing::debug!(
                        ?address,
                        problem,
                        "dropped a connection that does not speak the protocol"
                    );
                    self.shared.counters.malformed();
                }
            }
        }
    }

    /// Waits for the answers under way, no longer than the configured time, tells all edges goodbye, and closes
    /// the port.
    pub async fn close(self) {
        let wait = self.settings.close_timeout();
        if tokio::time::timeout(wait, self.shared.drained()).await.is_err() {
            let in_flight = self.shared.machine().in_flight();
            tracing::warn!(in_flight, "closing the port although requests are still being computed");
        }
        let farewells = self.shared.machine().goodbye("the cloud shuts down");
        for (peer, header) in farewells {
            self.shared.tell(&peer, &header);
        }
        self.receiver.close(wait).await;
    }
}

/// A message arrived: what to hand out, if anything.
fn heard(
    shared: &Arc<PortState>,
    peer: &Peer,
    frames: Frames,
    received: (Stamp, ArrivalStamp),
) -> Option<Incoming> {
    let bytes = Sizes::of(&frames).total();
    shared.counters.received(bytes);
    if frames.len() > MAX_FRAMES {
        shared.malformed(peer, "too many frames");
        return None;
    }
    let header = match Header::decode(frames.first().map_or(&[], |frame| frame)) {
        Ok(header) => header,
        Err(HeaderError::NoCommonVersion(mismatch)) => {
            shared.tell(peer, &Server::incompatible(&mismatch));
            return None;
        }
        Err(error) => {
            shared.malformed(peer, &error.to_string());
            return None;
        }
    };
    // Bound, so that the lock is free again before the answers below take it.
    let heard = shared.machine().hear(peer, header);
    if let Heard::Open(session, _) | Heard::Request(Request { session, .. }) = &heard
        && let Some(counters) = shared.machine().counters(*session)
    {
        counters.received(bytes);
    }
    match heard {
        Heard::Open(session, hello) => {
            shared.settle(peer.connection);
            let wish = OpenRequest::new(*hello, session, peer.address, Arc::downgrade(shared));
            Some(Incoming::Open(wish))
        }
        Heard::Request(request) => incoming_request(shared, peer, request, frames, received),
        Heard::Answer(header) => {
            shared.tell(peer, &header);
            None
        }
        Heard::Closed(session, ordered) => {
            shared.settle(peer.connection);
            Some(Incoming::Closed { session, said_goodbye: true, ordered })
        }
        Heard::Malformed(problem) => {
            shared.malformed(peer, problem);
            None
        }
    }
}

fn incoming_request(
    shared: &Arc<PortState>,
    peer: &Peer,
    request: Request,
    frames: Frames,
    (received, arrival): (Stamp, ArrivalStamp),
) -> Option<Incoming> {
    let ticket = Ticket { session: request.session, request: request.request, arrival };
    let frames = match shared.budget.hold(frames) {
        Ok(frames) => frames,
        Err(exceeded) => {
            shared.answer(ticket, None, Err(Failure::Overloaded(exceeded.to_string())));
            return None;
        }
    };
    let log = shared.resume(frames.get(1), request.departure, received);
    let sample = request.sample.into_sample(frames.into_iter().skip(2)).map_err(InvalidRequest::from);
    match (log, sample) {
        (Ok(log), Ok(sample)) => {
            let reply = Responder::new(ticket, Arc::downgrade(shared));
            let session = ticket.session;
            Some(Incoming::Request(IncomingRequest { session, sample, log, received, reply }))
        }
        (Err(problem), _) | (_, Err(problem)) => {
            shared.malformed(peer, &problem.to_string());
            let failure = Failure::Failed(format!("the request makes no sense: {problem}"));
            shared.answer(ticket, None, Err(failure));
            None
        }
    }
}

/// A request that makes no sense.
#[derive(Debug, thiserror::Error)]
enum InvalidRequest {
    #[error("no tree")]
    NoTree,
    #[error(transparent)]
    Frame(#[from] TreeFrameError),
    #[error(transparent)]
    Tree(#[from] TreeError),
    #[error(transparent)]
    Sample(#[from] HeaderError),
}

impl PortState {
    fn machine(&self) -> MutexGuard<'_, Server> {
        self.machine.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Continues an edge's tree here: puts `upload` into it and closes it at `received`.
    fn resume(
        &self,
        tree: Option<&Bytes>,
        departure: Departure,
        received: Stamp,
    ) -> Result<Recorder, InvalidRequest> {
        let mut tree = decode_tree(tree.ok_or(InvalidRequest::NoTree)?)?;
        let upload = put_upload(&mut tree, departure);
        Ok(Recorder::resume(self.clock.clone(), self.host, tree, upload, received)?)
    }

    /// Tells the transport what the connection may send from now on.
    fn settle(&self, connection: ConnectionId) {
        let standing = self.machine().standing(connection);
        match standing {
            Standing::Admitted => self.sender.admit(connection),
            Standing::Greeted => self.sender.greet(connection),
            Standing::Unadmitted => self.sender.demote(connection),
        }
    }

    pub(crate) fn accept(&self, session: SessionId, accepted: SessionAccepted) -> bool {
        let Some((peer, header)) = self.machine().accept(session, accepted) else { return false };
        // Before the edge knows: its first request may be large.
        self.settle(peer.connection);
        self.tell(&peer, &header)
    }

    pub(crate) fn refuse(&self, session: SessionId, reason: String) {
        let refusal = self.machine().refuse(session, reason);
        if let Some((peer, header)) = refusal {
            self.settle(peer.connection);
            self.tell(&peer, &header);
        }
    }

    pub(crate) fn announce(&self, clock: PeerClock) {
        let news = self.machine().announce(clock);
        for (peer, header) in news {
            self.tell(&peer, &header);
        }
    }

    pub(crate) fn report_statistics(&self) {
        let sessions = self.machine().counted_sessions();
        for (session, peer, counters) in sessions {
            let statistics = counters.statistics(&self.sender.statistics(peer.connection));
            let header = Header::Statistics(Box::new(CountedAtCloud { session, statistics }));
            self.tell(&peer, &header);
        }
    }

    /// Sends an answer with what `log` grew here; both are absent when no model was asked.
    pub(crate) fn answer(&self, ticket: Ticket, log: Option<Recorder>, result: Result<Sample, Failure>) {
        // Before the request is out of flight: closing must find one of the two, or it says goodbye before the answer.
        self.sending.fetch_add(1, Ordering::SeqCst);
        let route = self.machine().finish(ticket.session, ticket.request);
        let sent = route.as_ref().is_some_and(|route| self.send_answer(route, ticket, log, result));
        self.sending.fetch_sub(1, Ordering::SeqCst);
        if !sent {
            self.counters.lost(1);
            if let Some(route) = &route {
                route.counters.lost(1);
            }
        }
        self.answered.notify_one();
    }

    fn send_answer(
        &self,
        route: &Route,
        ticket: Ticket,
        log: Option<Recorder>,
        result: Result<Sample, Failure>,
    ) -> bool {
        let (outcome, payload) = outcome(result, route.max_message_bytes);
        let (grown, zero) = grown(log);
        let raw = route.version >= RAW_STAMPS_SINCE;
        let stamp = self.clock.stamp();
        let epoch = if raw { self.clock.epoch() } else { self.clock.wall_epoch() };
        let departure = grown.as_ref().map(|_| {
            let start = zero + (stamp.mono - MonoTime::default());
            Departure { sent: stamp.wall, start, epoch, sent_raw: raw.then_some(stamp.raw) }
        });
        let Ticket { session, request, arrival } = ticket;
        let arrival_epoch = if raw { arrival.epoch } else { arrival.wall_epoch };
        let arrived_raw = departure.filter(|_| raw).map(|_| arrival.raw);
        let reply = Reply { session, request, departure, arrival_epoch, outcome, arrived_raw };
        let header = Header::Reply(reply);
        let header = match header.encode() {
            Ok(header) => header,
            Err(error) => {
                tracing::warn!(%error, "an answer was dropped");
                return false;
            }
        };
        let mut frames = Vec::with_capacity(2 + payload.len());
        frames.extend([header, grown.unwrap_or_default()]);
        frames.extend(payload);
        self.send(&route.peer, frames, Some(request), Some(&route.counters))
    }

    fn tell(&self, peer: &Peer, header: &Header) -> bool {
        let counters = self.machine().counters_of(peer.connection);
        match header.encode() {
            Ok(header) => self.send(peer, vec![header], None, counters.as_deref()),
            Err(error) => {
                tracing::warn!(%error, "a message to an edge was dropped");
                false
            }
        }
    }

    fn send(&self, peer: &Peer, frames: Frames, tag: Option<u64>, of_session: Option<&Counters>) -> bool {
        let bytes = Sizes::of(&frames).total();
        match self.sender.send(peer, frames, SendOptions { deadline: None, tag }) {
            Ok(()) => {
                for counters in [Some(&self.counters), of_session].into_iter().flatten() {
                    counters.sent(bytes);
                }
                true
            }
            Err(reason) => {
                tracing::debug!(%reason, "a message to an edge was dropped");
                false
            }
        }
    }

    fn malformed(&self, from: &Peer, problem: &str) {
        self.counters.malformed();
        if let Some(counters) = self.machine().counters_of(from.connection) {
            counters.malformed();
        }
        let from = from.address;
        let now = self.clock.mono();
        let mut throttle = self.log_throttle.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(times) = throttle.count("malformed", from.map(|address| address.ip()), now) {
            let from = from.map_or_else(|| "an unknown peer".into(), |address| address.to_string());
            tracing::warn!(from, problem, times, "dropped what a peer sent");
        }
    }

    async fn drained(&self) {
        while self.machine().in_flight() > 0 || self.sending.load(Ordering::SeqCst) > 0 {
            self.answered.notified().await;
        }
    }
}

/// The outcome that a result is sent as, and its payload. What the edge would not take becomes a failure.
fn outcome(result: Result<Sample, Failure>, max_message_bytes: u64) -> (Outcome, Vec<Bytes>) {
    let failed = |reason: String| (Outcome::Failed(reason), Vec::new());
    match result {
        Ok(sample) if sample.payload_bytes() > max_message_bytes => failed(format!(
            "the answer's {} bytes are more than the edge's max_message_bytes, {max_message_bytes}",
            sample.payload_bytes()
        )),
        Ok(sample) => match SampleHeader::of(&sample) {
            Ok(header) => {
                (Outcome::Answer(header), sample.parts.into_iter().map(|part| part.bytes).collect())
            }
            Err(error) => failed(format!("the answer cannot be sent: {error}")),
        },
        Err(Failure::Failed(reason)) => failed(reason),
        Err(Failure::Overloaded(reason)) => (Outcome::Overloaded(reason), Vec::new()),
    }
}

/// The growth's wire form, and the offset of the monotonic clock's zero from this host's anchor.
fn grown(log: Option<Recorder>) -> (Option<Bytes>, peernet_clock::Span) {
    let Some(log) = log else { return (None, peernet_clock::Span::ZERO) };
    let zero = log.offset(MonoTime::default());
    let grown = log.into_growth().and_then(|growth| match encode_growth(&growth) {
        Ok(wire) => Some(wire),
        Err(error) => {
            tracing::warn!(%error, "an answer goes out without what was measured here");
            None
        }
    });
    (grown, zero)
}
