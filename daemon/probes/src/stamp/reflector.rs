//! State machine of a reflector (session-reflector of RFC 8762, sections 4 and 4.3).
//!
//! An answer is written into the bytes of its request. It therefore always has the length of the request, and a
//! reflector cannot amplify traffic.
//!
//! A STAMP session consists of the probes of one sender. A peer is an edge that has a data session with this host
//! (docs/session-protocol.md).

use std::net::{IpAddr, SocketAddr};

use peernet_clock::{Clock, MonoTime, RawTime, Span, Stamp, WallTime};

use super::auth::{CODE_BYTES, Key};
use super::counters::Refusal;
use super::limiter::Limiter;
use super::packet::{self, Mode, Reply, Request};
use super::recent_map::RecentMap;
use super::timestamp::ErrorEstimate;
use super::tlv::{self, FollowUp, Origin, RawStamps};
use super::uncertainty;

/// Minimum number of STAMP sessions that each map of [`Sessions`] remembers.
const MIN_SESSIONS: usize = 4096;

/// Longest time between the reception of a request and its reply.
// A reflector takes far less. The limit distinguishes replies from requests (`is_reply`).
const MAX_ANSWER_DURATION: Span = Span::from_seconds(4);

/// State of a reflector.
#[derive(Debug)]
pub struct ReflectorState {
    key: Option<Key>,
    /// Key that peers get with their data session.
    session_key: Option<Key>,
    instance: u64,
    limiter: Limiter,
    /// `None` if STAMP sessions are not distinguished.
    sessions: Option<Sessions>,
}

/// STAMP sessions of peers and of other sources. The two maps are separate, so that forged source addresses only make
/// the reflector forget sessions of sources that are no peers.
#[derive(Debug)]
struct Sessions {
    peers: RecentMap<SessionId, Session>,
    others: RecentMap<SessionId, Session>,
}

impl Sessions {
    fn new() -> Self {
        Self { peers: RecentMap::new(MIN_SESSIONS), others: RecentMap::new(MIN_SESSIONS) }
    }

    fn table(&mut self, session: &SessionId) -> &mut RecentMap<SessionId, Session> {
        if session.is_peer { &mut self.peers } else { &mut self.others }
    }
}

/// Source and time of a packet that arrived.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// Address of the sender.
    pub source: SocketAddr,
    /// Time of arrival by the wall clock.
    pub received: WallTime,
    /// Time of arrival by the free-running clock; not earlier than the true time.
    pub received_raw: RawTime,
    /// Time of arrival by the monotonic clock.
    pub now: MonoTime,
}

/// Identifies the packets of one STAMP session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SessionId {
    source: SocketAddr,
    ssid: u16,
    /// `true` if the source is a peer.
    is_peer: bool,
}

/// State of one STAMP session.
#[derive(Debug, Default)]
struct Session {
    /// Number of the next reply.
    next_sequence: u32,
    last_reply: Option<LastReply>,
}

/// The latest reply of a session, and its departure by the wall clock and by the free-running clock.
#[derive(Clone, Copy, Debug)]
struct LastReply {
    sequence: u32,
    wall: WallTime,
    raw: RawTime,
}

/// A reply that still lacks its departure stamp.
#[derive(Clone, Copy, Debug)]
pub struct PreparedReply {
    reply: Reply,
    session: SessionId,
    mode: Mode,
    has_intact_tlvs: bool,
    received_raw: RawTime,
    /// Number of the session's previous reply, and its departure by the free-running clock.
    previous: Option<(u32, RawTime)>,
}

impl PreparedReply {
    /// Returns the number of the reply, for [`ReflectorState::record_departure`].
    pub const fn sequence(&self) -> u32 {
        self.reply.sequence
    }

    /// Returns the session of the answer.
    pub const fn session(&self) -> SessionId {
        self.session
    }
}

impl ReflectorState {
    /// Creates a reflector without peers and STAMP sessions. With a `key` it answers only requests that the key
    /// authenticates. If it is `stateful`, it distinguishes STAMP sessions. Its answers contain `instance`.
    pub fn new(key: Option<Key>, instance: u64, max_per_source_hz: u32, stateful: bool) -> Self {
        let sessions = stateful.then(Sessions::new);
        let limiter = Limiter::new(max_per_source_hz);
        Self { key, session_key: None, instance, limiter, sessions }
    }

    /// Sets the key that peers get with their data session. Requests that this key authenticates get
    /// authenticated answers; all other requests are answered as without this key. No effect if the reflector has a
    /// `key`, because all requests then need that key.
    #[must_use]
    pub fn with_session_key(mut self, key: Option<Key>) -> Self {
        self.session_key = key;
        self
    }

    /// Replaces the addresses of the peers. Each peer has its own rate, which other sources cannot use up.
    pub fn set_peers(&mut self, addresses: &[IpAddr]) {
        self.limiter.set_peers(addresses);
    }

    /// Turns a request into its answer, in place. [`complete`](Self::complete) then stamps the answer.
    ///
    /// # Errors
    /// The reason why the request gets no answer. Only requests that would be answered use up the rate of their source,
    /// so that a sender without the key cannot use up the rate of another sender.
    pub fn prepare(&mut self, packet: &mut [u8], arrival: &Arrival) -> Result<PreparedReply, Refusal> {
        if arrival.source.port() == 0 {
            return Err(Refusal::NoPort);
        }
        let mode = self.mode(packet)?;
        let request = Request::parse(mode, packet).ok_or(Refusal::Short)?;
        // A reply of another process may be authenticated by another key. `mode` then takes it for unauthenticated,
        // although it has the layout of the authenticated mode.
        let is_authenticated_reply =
            self.session_key.is_some() && is_reply(Mode::Authenticated, packet, arrival.received);
        if is_authenticated_reply || is_reply(mode, packet, arrival.received) {
            return Err(Refusal::Reply);
        }
        let address = arrival.source.ip();
        // The rate is limited after the checks, so that only requests that would be answered use the rate.
        self.limiter.admit(address, arrival.now)?;

        let is_peer = self.limiter.is_peer(address);
        let id = SessionId { source: arrival.source, ssid: request.ssid, is_peer };
        let session =
            self.sessions.as_mut().map(|sessions| &*sessions.table(&id).entry(id, Session::default));
        let (next_sequence, previous) =
            (session.map(|session| session.next_sequence), session.and_then(|session| session.last_reply));
        // The answer is in the format that the sender uses.
        let format = request.estimate.format();
        let tlvs = &mut packet[mode.base_bytes()..];
        let are_tlvs_intact = tlv::are_intact(self.key_for(mode), request.sequence, tlvs);
        let follow_up =
            previous.map(|reply| FollowUp { sequence: reply.sequence, timestamp: format.encode(reply.wall) });
        answer_tlvs(tlvs, are_tlvs_intact, follow_up);

        let reply = Reply {
            sequence: next_sequence.unwrap_or(request.sequence),
            // Set by `complete`, right before the reply is sent.
            timestamp: 0,
            estimate: ErrorEstimate::new(format, uncertainty::PEERNET_ENDS),
            received: format.encode(arrival.received),
            request,
            // Zero means unknown: the hop limit of the request is not read.
            ttl: 0,
        };
        let (previous, received_raw) =
            (previous.map(|reply| (reply.sequence, reply.raw)), arrival.received_raw);
        Ok(PreparedReply {
            reply,
            session: id,
            mode,
            has_intact_tlvs: are_tlvs_intact,
            received_raw,
            previous,
        })
    }

    /// Returns the mode of a request. If no key is mandatory, the form of the request decides: a request with a valid
    /// code of the session key is authenticated, a request with an invalid code is refused, and a request without a
    /// code is unauthenticated.
    fn mode(&self, packet: &[u8]) -> Result<Mode, Refusal> {
        let Some(key) = self.key_for(Mode::Authenticated) else { return Ok(Mode::Unauthenticated) };
        if packet::is_authentic(key, packet) {
            return Ok(Mode::Authenticated);
        }
        if self.key.is_none() && !has_authentication_code(packet) {
            return Ok(Mode::Unauthenticated);
        }
        let is_short = packet.len() < Mode::Authenticated.base_bytes();
        Err(if is_short { Refusal::Short } else { Refusal::Unauthenticated })
    }

    /// Returns the key that authenticates packets of this mode.
    fn key_for(&self, mode: Mode) -> Option<&Key> {
        match mode {
            Mode::Unauthenticated => None,
            Mode::Authenticated => self.key.as_ref().or(self.session_key.as_ref()),
        }
    }

    /// Stamps and authenticates the answer. Returns the stamp. The answer must be sent at once.
    pub fn complete(&self, answer: &PreparedReply, packet: &mut [u8], clock: &dyn Clock) -> Stamp {
        let mode = answer.mode;
        let now = clock.stamp();
        // The epochs are read after the stamp, so the stamp belongs to these epochs or to earlier epochs.
        let (epoch, wall_epoch) = (clock.epoch(), clock.wall_epoch());
        let reply = Reply { timestamp: answer.reply.estimate.format().encode(now.wall), ..answer.reply };
        reply.write(mode, packet);
        let tlvs = &mut packet[mode.base_bytes()..];
        if answer.has_intact_tlvs {
            let origin_header = tlv::headers(tlvs).find(|header| has_origin(header, tlvs));
            let stamps_header = tlv::headers(tlvs).find(|header| has_raw_stamps(header, tlvs));
            if let Some(header) = origin_header {
                let origin = Origin { epoch: wall_epoch, instance: self.instance };
                tlvs[header.value].copy_from_slice(&origin.to_value());
            }
            if let Some(header) = stamps_header {
                let PreparedReply { received_raw: received, previous, .. } = *answer;
                let stamps = RawStamps { epoch, received, replied: now.raw, previous };
                tlvs[header.value].copy_from_slice(&stamps.to_value());
            }
        }
        if let Some(key) = self.key_for(mode) {
            if answer.has_intact_tlvs {
                tlv::authenticate(key, reply.sequence, tlvs);
            }
            packet::authenticate(key, packet);
        }
        now
    }

    /// Records that the answer was sent at `stamp` or later. Only this call uses up the number of the answer.
    pub fn record_sent(&mut self, answer: &PreparedReply, stamp: Stamp) {
        // A number without a reply would look like a reply that was lost on its way.
        if let Some(sessions) = &mut self.sessions {
            let session = sessions.table(&answer.session).entry(answer.session, Session::default);
            session.next_sequence = answer.sequence().wrapping_add(1);
            session.last_reply =
                Some(LastReply { sequence: answer.sequence(), wall: stamp.wall, raw: stamp.raw });
        }
    }

    /// Handles the kernel's stamp of a reply's departure. `departure_raw` is the time of the free-running clock that
    /// was derived from the stamp; it is not later than the true time. Each of the two times is ignored if it is before
    /// the program's stamp or more than four seconds after it.
    pub fn record_departure(
        &mut self,
        session: &SessionId,
        sequence: u32,
        departure: WallTime,
        departure_raw: RawTime,
    ) {
        let last_reply = self
            .sessions
            .as_mut()
            .and_then(|sessions| sessions.table(session).get_mut(session)?.last_reply.as_mut());
        if let Some(last_reply) = last_reply.filter(|last_reply| last_reply.sequence == sequence) {
            let is_possible = |delay: Span| (Span::ZERO..=MAX_ANSWER_DURATION).contains(&delay);
            if is_possible(departure - last_reply.wall) {
                last_reply.wall = departure;
            }
            if is_possible(departure_raw - last_reply.raw) {
                last_reply.raw = departure_raw;
            }
        }
    }
}

/// Returns whether a packet is a reply.
///
/// A reply contains the time at which its request arrived. This time is close to the reply's own departure, which the
/// same clock stamped. A request has zeros at this offset, or the padding of TWAMP-light. Random padding looks like a
/// reply once in 2²⁹ packets.
///
/// A forged source address can direct the answers of one reflector to another reflector, or to an echo service. The
/// packets that return are replies by this test, so a loop ends after one round.
fn is_reply(mode: Mode, packet: &[u8], near: WallTime) -> bool {
    Reply::parse(mode, packet).is_some_and(|reply| {
        let format = reply.estimate.format();
        let stamps = (format.decode(reply.received, near), format.decode(reply.timestamp, near));
        let (Some(received), Some(replied)) = stamps else { return false };
        reply.received != 0 && (replied - received).abs() <= MAX_ANSWER_DURATION
    })
}

/// Returns whether a packet has at least the length of an authenticated base packet, and an authentication code among
/// the TLVs after it.
fn has_authentication_code(packet: &[u8]) -> bool {
    let tlvs = packet.get(Mode::Authenticated.base_bytes()..).unwrap_or_default();
    tlv::headers(tlvs).any(|header| header.kind == tlv::HMAC && header.value.len() == CODE_BYTES)
}

/// Sets the flags of the TLVs and fills in the departure of the previous reply if it is requested. TLVs that are not
/// intact are returned unchanged except for their flags.
fn answer_tlvs(tlvs: &mut [u8], are_intact: bool, previous: Option<FollowUp>) {
    let mut offset = 0;
    while let Some(header) = tlv::header_at(tlvs, offset) {
        let length = header.value.len();
        let (is_known, is_well_formed) = match header.kind {
            tlv::EXTRA_PADDING => (true, true),
            tlv::FOLLOW_UP => (true, length == FollowUp::BYTES),
            tlv::HMAC => (true, length == CODE_BYTES),
            _ => (has_origin(&header, tlvs) || has_raw_stamps(&header, tlvs), true),
        };
        let mut flags = 0;
        if !is_known {
            flags |= tlv::UNRECOGNISED;
        }
        if !is_well_formed || header.overruns {
            flags |= tlv::MALFORMED;
        }
        if !are_intact {
            flags |= tlv::NOT_INTACT;
        }
        tlvs[header.offset] = flags;
        if header.kind == tlv::FOLLOW_UP && are_intact {
            let value = &mut tlvs[header.value.clone()];
            value.fill(0);
            if let (true, Some(previous)) = (is_well_formed, previous) {
                value.copy_from_slice(&previous.to_value());
            }
        }
        offset = header.end();
    }
}

/// Returns whether the TLV's value is a [`RawStamps`]. Another program may use the same type.
fn has_raw_stamps(header: &tlv::TlvHeader, tlvs: &[u8]) -> bool {
    header.kind == tlv::RAW_STAMPS && RawStamps::from_value(&tlvs[header.value.clone()]).is_some()
}

/// Returns whether the TLV's value is an [`Origin`]. Another program may use the same type.
fn has_origin(header: &tlv::TlvHeader, tlvs: &[u8]) -> bool {
    header.kind == tlv::ORIGIN && Origin::from_value(&tlvs[header.value.clone()]).is_some()
}
