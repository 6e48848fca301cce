//! A virtual connection, without I/O: both halves, heartbeats and the goodbye.
//!
//! An end asks the other for a sign of life when nothing came for the heartbeat interval, and sooner while messages
//! that it sent are not settled there: the answer tells which never arrived. Without any word for the heartbeat
//! timeout the connection is gone. It is closed by a goodbye that is repeated until it is heard.

use std::collections::VecDeque;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span};

use super::counting::ArrivalCounter;
use super::false_claim::FalseClaim;
use super::fragment::split_frames;
use super::packet::{Packet, ResetReason, Role, SignOfLife, Terms};
use super::reassembly::ReassemblyLimits;
use super::receiving::{Arrived, Receiving};
use super::round_trip::RoundTripEstimator;
use super::sending::{Batch, QueueLimits, Sending};
use super::told_totals::ToldTotals;
use crate::statistics::TransportStatistics;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{Frames, MessageLoss, SendFailure};

/// How long after a message the other end is asked what has arrived.
const ASK_PAUSE: Span = Span::from_millis(50);

/// How often it is asked at least while messages follow each other: statistics come with the answers.
const ASK_PERIOD: Span = Span::from_seconds(1);

/// How often what arrives in parts is looked at.
const TICK: Span = Span::from_millis(20);

/// The pause between goodbyes.
const BYE_PAUSE: Span = Span::from_millis(50);

/// The goodbye from which on nothing is awaited any more, and the one that is always the last.
const BYES: (u32, u32) = (2, 8);

/// Why a connection ends whose long datagrams are lost.
const LONG_LOST: &str = "long datagrams do not arrive any more, short ones do: a link on the path takes smaller packets \
     (MTU) and does not say so; mend its MTU, or set datagram_bytes to what passes (1200 is tried by itself)";

/// Why a connection ends whose ends contradict each other.
const CONTRADICTED: &str = "the peer tells again and again of messages that were never sent: packets are altered or forged on the \
     path; a new connection begins afresh";

/// Signs of life in succession that contradict what was sent, at which the connection ends. It would not recover: the other
/// end takes messages that are still to be sent for settled.
const MAX_CONTRADICTIONS: u32 = 3;

/// Most packets without a message that wait to be sent.
const MAX_CONTROL: usize = 256;

/// Time limits and bounds of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ConnectionLimits {
    pub(crate) heartbeat_interval: Span,
    pub(crate) heartbeat_timeout: Span,
    pub(crate) queue: QueueLimits,
    /// The configured rate; `None` sends as fast as the other end takes it.
    pub(crate) bits_per_second: Option<u64>,
}

/// What a connection tells the layer above.
#[derive(Debug)]
pub(crate) enum Event {
    /// A message, and the memory that it takes until it is handed on.
    Message(Frames, Reservation),
    /// A message of the other end did not arrive as a whole.
    Incomplete(MessageLoss),
    /// A message that was sent did not arrive as a whole.
    Lost(MessageLoss),
    /// Something that makes no sense.
    Garbage(String),
    /// The connection is over.
    Gone(String),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Open,
    Closing { next_bye: MonoTime },
    Closed,
}

/// One end of a virtual connection.
#[derive(Debug)]
pub(crate) struct Connection {
    role: Role,
    id: u64,
    prefix: &'static [u8],
    limits: ConnectionLimits,
    sending: Sending,
    receiving: Receiving,
    control: VecDeque<Packet<'static>>,
    events: VecDeque<Event>,
    phase: Phase,
    /// When the other end was last heard of.
    heard: MonoTime,
    /// When it was last asked for a sign of life.
    pinged: MonoTime,
    /// Goodbyes that were heard.
    byes: u32,
    counter: ArrivalCounter,
    /// What the other end told of the datagrams of this one.
    told: ToldTotals,
    round_trip: RoundTripEstimator,
    /// The last sign of life, which counts once when the network doubles it.
    last_sign: SignOfLife,
    /// Signs of life in succession that contradict what was sent.
    contradictions: u32,
}

impl Connection {
    /// A connection that the handshake has opened. `terms` are the other end's; each datagram begins with `prefix`.
    pub(crate) fn new(
        (role, id, prefix): (Role, u64, &'static [u8]),
        terms: Terms,
        limits: ConnectionLimits,
        (reassembly, budget): (ReassemblyLimits, Arc<MemoryBudget>),
        now: MonoTime,
    ) -> Self {
        Self {
            role,
            id,
            prefix,
            limits,
            sending: Sending::new((role, id, prefix), terms, limits.queue, limits.bits_per_second, now),
            receiving: Receiving::new(id, reassembly, budget),
            control: VecDeque::new(),
            events: VecDeque::new(),
            phase: Phase::Open,
            heard: now,
            pinged: now,
            byes: 0,
            counter: ArrivalCounter::new(now),
            told: ToldTotals::default(),
            round_trip: RoundTripEstimator::default(),
            last_sign: SignOfLife::default(),
            contradictions: 0,
        }
    }

    /// Replaces what arriving messages may cost.
    pub(crate) fn set_reassembly(&mut self, limits: ReassemblyLimits, budget: Arc<MemoryBudget>) {
        self.receiving.set_limits(limits, budget);
    }

    /// Queues a message.
    ///
    /// # Errors
    /// When too much waits already, or the connection is over.
    pub(crate) fn send(
        &mut self,
        frames: Frames,
        tag: Option<u64>,
        deadline: Option<MonoTime>,
    ) -> Result<(), SendFailure> {
        if self.phase != Phase::Open {
            return Err(SendFailure::Gone("the connection is closed".into()));
        }
        self.sending.send(frames, tag, deadline)
    }

    /// A packet of this connection arrived.
    pub(crate) fn hear(&mut self, packet: Packet<'_>, now: MonoTime) {
        if self.phase == Phase::Closed {
            return;
        }
        self.heard = now;
        match packet {
            Packet::Data { number, fragment, .. } => {
                self.counter.arrive(number, now);
                match self.receiving.receive(number, &fragment, now) {
                    Arrived::Message(bytes, reserved) => match split_frames(bytes) {
                        Ok(frames) => self.events.push_back(Event::Message(frames, reserved)),
                        Err(error) => self.events.push_back(Event::Garbage(error.to_string())),
                    },
                    Arrived::Nothing => {}
                    Arrived::Garbage(problem) => self.events.push_back(Event::Garbage(problem)),
                }
                if let Some(progress) = self.receiving.progress() {
                    self.say(progress);
                }
                self.report(now);
            }
            Packet::Progress { sequence, end, .. } => {
                let progress = self.sending.progress(sequence, end, now);
                self.refuse(progress);
            }
            Packet::Lost { sequence, received, .. } => {
                let lost = self.sending.lost((sequence, received), self.told.lost(), now);
                if let Some((tag, total, lost)) = self.refuse(lost) {
                    self.events.extend(lost.map(Event::Lost));
                    self.say(Packet::LostKnown { connection: self.id, sequence, tag, total });
                }
            }
            Packet::LostKnown { sequence, tag, total, .. } => {
                let incomplete = self.receiving.known(sequence, tag, total);
                self.events.extend(incomplete.map(Event::Incomplete));
            }
            Packet::Ping { sign, .. } => {
                self.learn(&sign, now);
                let sign = self.sign_of_life(sign.time, now);
                self.say(Packet::Pong { connection: self.id, sign });
            }
            Packet::Pong { sign, .. } => {
                self.learn(&sign, now);
                let asked = Span::from_nanos(i64::try_from(sign.time).unwrap_or(0));
                self.round_trip.answer(MonoTime::default() + asked, now);
            }
            Packet::Bye { next, .. } => self.hear_bye(next, now),
            Packet::ByeHeard { .. } if self.phase != Phase::Open => self.phase = Phase::Closed,
            Packet::Path { token, .. } => {
                self.say(Packet::PathConfirmed { connection: self.id, token });
            }
            Packet::Reset { reason, .. } => self.end(match reason {
                ResetReason::Unknown => "the peer does not know the connection any more: it was restarted, or it gave the connection up",
                ResetReason::Full => "the peer has too many connections",
                ResetReason::LongLost => LONG_LOST,
            }),
            // The handshake's packets and confirmed paths are not a connection's own.
            _ => {}
        }
    }

    /// How far this end has come.
    fn sign_of_life(&mut self, time: u64, now: MonoTime) -> SignOfLife {
        SignOfLife {
            time,
            next: self.sending.next(),
            settled: self.receiving.settled(),
            number: self.sending.datagrams() as u32,
            arrivals: self.counter.totals(now),
        }
    }

    /// The other end says how far it has come.
    fn learn(&mut self, sign: &SignOfLife, now: MonoTime) {
        if std::mem::replace(&mut self.last_sign, *sign) == *sign {
            return;
        }
        let settled = self.sending.settled(sign.settled);
        if self.refuse(settled).is_none() {
            self.contradictions += 1;
            if self.contradictions >= MAX_CONTRADICTIONS {
                self.say(Packet::Bye { connection: self.id, next: self.sending.next() });
                self.end(CONTRADICTED);
            }
            return;
        }
        self.contradictions = 0;
        let told = self.told.tell(sign.arrivals, self.sending.datagrams());
        self.refuse(told);
        let expected = self.receiving.expect(sign.next, sign.time, now);
        self.refuse(expected);
        self.counter.expect(sign.number, now);
    }

    /// Passes on a claim that cannot be true; it changes nothing else.
    fn refuse<T>(&mut self, claim: Result<T, FalseClaim>) -> Option<T> {
        claim.map_err(|claim| self.events.push_back(Event::Garbage(claim.to_string()))).ok()
    }

    /// What is known of the datagrams of both directions, and the round trip.
    pub(crate) fn statistics(&mut self, now: MonoTime) -> TransportStatistics {
        TransportStatistics {
            sent: self.sending.statistics(self.told.totals()),
            received: self.counter.statistics(now),
            round_trip: self.round_trip.estimate(),
        }
    }

    fn hear_bye(&mut self, next: u64, now: MonoTime) {
        self.byes += 1;
        let expected = self.receiving.expect(next, self.byes.into(), now);
        self.refuse(expected);
        let (patient, last) = BYES;
        if self.byes >= patient {
            self.receiving.give_up_all();
        }
        self.report(now);
        if self.receiving.is_settled() || self.byes >= last {
            self.say(Packet::ByeHeard { connection: self.id });
            self.end("the peer closed the connection");
        }
    }

    /// Begins to say goodbye, after what is queued has left.
    pub(crate) fn close(&mut self, now: MonoTime) {
        if self.phase == Phase::Open {
            self.phase = Phase::Closing { next_bye: now };
        }
    }

    /// Says goodbye once, at once, and is over.
    pub(crate) fn abandon(&mut self) {
        self.control.clear();
        self.control.push_back(Packet::Bye { connection: self.id, next: self.sending.next() });
        self.phase = Phase::Closed;
    }

    /// Whether the connection is over: nothing that arrives changes anything.
    pub(crate) fn is_closed(&self) -> bool {
        self.phase == Phase::Closed
    }

    /// Ends the connection and tells why.
    pub(crate) fn end(&mut self, reason: impl Into<String>) {
        if self.phase != Phase::Closed {
            self.phase = Phase::Closed;
            self.events.push_back(Event::Gone(reason.into()));
        }
    }

    /// Does what is due.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        if self.phase == Phase::Closed {
            return;
        }
        self.sending.tick(now);
        self.receiving.tick(now);
        let expired = self.sending.expire(now);
        self.events.extend(expired.into_iter().map(Event::Lost));
        self.report(now);
        if self.sending.loses_long(self.told.lost(), now) {
            tracing::debug!(bytes = self.sending.longest(), "none of the longest datagrams arrive");
            // The handshake of the next connection finds out what passes.
            if self.role == Role::Cloud {
                self.say(Packet::Reset { id: self.id, reason: ResetReason::LongLost });
            }
            self.end(LONG_LOST);
            return;
        }
        if now - self.heard >= self.limits.heartbeat_timeout {
            let seconds = self.limits.heartbeat_timeout.seconds();
            self.end(format!("nothing was heard of the peer for {seconds} s"));
            return;
        }
        let is_due = |at: MonoTime| at <= now;
        if is_due(self.ping_at()) || self.asks_at().is_some_and(is_due) {
            self.pinged = now;
            self.round_trip.ask(now);
            let time = u64::try_from(now.nanos()).unwrap_or(0);
            let sign = self.sign_of_life(time, now);
            self.say(Packet::Ping { connection: self.id, sign });
        }
        if let Phase::Closing { next_bye } = self.phase
            && self.sending.is_empty()
            && next_bye <= now
        {
            self.phase = Phase::Closing { next_bye: now + BYE_PAUSE };
            self.say(Packet::Bye { connection: self.id, next: self.sending.next() });
        }
    }

    fn asks_at(&self) -> Option<MonoTime> {
        self.sending.asks_at(self.pinged, (ASK_PAUSE, ASK_PERIOD))
    }

    fn ping_at(&self) -> MonoTime {
        self.heard.max(self.pinged) + self.limits.heartbeat_interval
    }

    /// When [`tick`](Self::tick) is to be called at the latest.
    pub(crate) fn next_timer(&self, now: MonoTime) -> MonoTime {
        let mut next = self.ping_at().min(self.heard + self.limits.heartbeat_timeout);
        let asks = self.asks_at();
        let closes = match self.phase {
            Phase::Closing { next_bye } if self.sending.is_empty() => Some(next_bye),
            _ => None,
        };
        let others = [asks, closes, self.sending.opens_at(), self.receiving.next_timer(now, TICK)];
        for at in others.into_iter().flatten() {
            next = next.min(at);
        }
        next
    }

    /// What happened next.
    pub(crate) fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Appends datagrams that leave now. Returns `None` when there are none.
    pub(crate) fn fill(&mut self, out: &mut Vec<u8>, most: usize, now: MonoTime) -> Option<Batch> {
        if let Some(packet) = self.control.pop_front() {
            let start = out.len();
            out.extend_from_slice(self.prefix);
            packet.write(self.role, out);
            return Some(Batch { segment: out.len() - start, count: 1 });
        }
        if self.phase == Phase::Closed {
            return None;
        }
        self.sending.fill(out, most, now)
    }

    /// Passes on what was lost.
    fn report(&mut self, now: MonoTime) {
        let known = self.receiving.take_lost(now);
        let (packets, silent) = self.receiving.reports(now);
        self.events.extend(known.into_iter().chain(silent).map(Event::Incomplete));
        packets.into_iter().for_each(|packet| self.say(packet));
    }

    fn say(&mut self, packet: Packet<'static>) {
        // More than that is waiting when nothing leaves; all of it is repeated or comes again.
        if self.control.len() < MAX_CONTROL {
            self.control.push_back(packet);
        }
    }
}
