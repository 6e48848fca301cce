//! A virtual connection, without I/O: both halves, heartbeats and the goodbye.
//!
//! An end asks the other for a heartbeat if nothing arrived for the heartbeat interval. It asks sooner while messages
//! that it sent are not settled, because the answer says which of them never arrived. If nothing arrives for the
//! heartbeat timeout, the connection is gone. A connection is closed by a goodbye that is repeated until it is
//! confirmed.

mod control_queue;
mod heartbeat_history;
mod heartbeat_timer;
mod shutdown;

use std::collections::VecDeque;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span};

use self::control_queue::ControlQueue;
use self::heartbeat_history::HeartbeatHistory;
use self::heartbeat_timer::HeartbeatTimer;
use self::shutdown::Shutdown;
use super::false_claim::FalseClaim;
use super::fragment::split_frames;
use super::measurement::PathMeasurement;
use super::packet::{Heartbeat, Packet, ResetReason, Role, Terms};
use super::packet_writer::PacketWriter;
use super::reassembly::ReassemblyLimits;
use super::receiving::{FragmentOutcome, ReceivingHalf};
use super::sending::QueueLimits;
use super::sending::{Batch, SendingHalf};
use crate::statistics::TransportStatistics;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{Frames, MessageLoss, SendFailure};

/// Interval at which unfinished messages are checked.
const TICK: Span = Span::from_millis(20);

/// Reason for the end of a connection on which long datagrams are lost.
const LONG_DATAGRAMS_LOST: &str = "long datagrams do not arrive any more, short ones do: a link on the path takes smaller packets \
     (MTU) and does not say so; mend its MTU, or set datagram_bytes to what passes (1200 is tried by itself)";

/// Reason for the end of a connection whose ends contradict each other.
const CONTRADICTED: &str = "the peer tells again and again of messages that were never sent: packets are altered or forged on the \
     path; a new connection begins afresh";

/// Timeouts and limits of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ConnectionLimits {
    pub(crate) heartbeat_interval: Span,
    pub(crate) heartbeat_timeout: Span,
    pub(crate) queue: QueueLimits,
    /// Configured rate in bits per second; `None` adapts the rate to what the other end receives.
    pub(crate) bits_per_second: Option<u64>,
}

/// Event for the layer above.
#[derive(Debug)]
pub(crate) enum Event {
    /// A message arrived. The reservation holds its memory until the message is handed on.
    Message(Frames, Reservation),
    /// A message from the other end did not arrive as a whole.
    Incomplete(MessageLoss),
    /// A message that was sent did not arrive as a whole.
    Lost(MessageLoss),
    /// A packet arrived that cannot be right, for this reason.
    InvalidData(String),
    /// The connection is over, for this reason.
    Gone(String),
}

/// One end of a virtual connection.
#[derive(Debug)]
pub(crate) struct Connection {
    writer: PacketWriter,
    sending: SendingHalf,
    receiving: ReceivingHalf,
    control: ControlQueue,
    events: VecDeque<Event>,
    shutdown: Shutdown,
    timer: HeartbeatTimer,
    heartbeats: HeartbeatHistory,
    measurement: PathMeasurement,
}

impl Connection {
    /// Creates a connection that the handshake has opened. `terms` are the other end's.
    pub(crate) fn new(
        writer: PacketWriter,
        terms: Terms,
        limits: ConnectionLimits,
        (reassembly, budget): (ReassemblyLimits, Arc<MemoryBudget>),
        now: MonoTime,
    ) -> Self {
        Self {
            writer,
            sending: SendingHalf::new(writer, terms, limits.queue, limits.bits_per_second, now),
            receiving: ReceivingHalf::new(writer.connection(), reassembly, budget),
            control: ControlQueue::new(writer),
            events: VecDeque::new(),
            shutdown: Shutdown::new(),
            timer: HeartbeatTimer::new(limits.heartbeat_interval, limits.heartbeat_timeout, now),
            heartbeats: HeartbeatHistory::default(),
            measurement: PathMeasurement::new(now),
        }
    }

    /// Replaces the limits for incomplete messages that arrive.
    pub(crate) fn set_reassembly(&mut self, limits: ReassemblyLimits, budget: Arc<MemoryBudget>) {
        self.receiving.set_limits(limits, budget);
    }

    /// Queues a message.
    ///
    /// # Errors
    /// If too many messages wait already, or the connection is over.
    pub(crate) fn send(
        &mut self,
        frames: Frames,
        tag: Option<u64>,
        deadline: Option<MonoTime>,
    ) -> Result<(), SendFailure> {
        if !self.shutdown.is_open() {
            return Err(SendFailure::Gone("the connection is closed".into()));
        }
        self.sending.send(frames, tag, deadline)
    }

    /// Handles a packet of this connection.
    pub(crate) fn receive(&mut self, packet: Packet<'_>, now: MonoTime) {
        if self.shutdown.is_closed() {
            return;
        }
        self.timer.receive(now);
        let connection = self.writer.connection();
        match packet {
            Packet::Data { number, fragment, .. } => {
                self.measurement.arrive(number, now);
                match self.receiving.receive(number, &fragment, now) {
                    FragmentOutcome::Message(bytes, reserved) => match split_frames(bytes) {
                        Ok(frames) => self.events.push_back(Event::Message(frames, reserved)),
                        Err(error) => self.events.push_back(Event::InvalidData(error.to_string())),
                    },
                    FragmentOutcome::Nothing => {}
                    FragmentOutcome::InvalidData(problem) => self.events.push_back(Event::InvalidData(problem)),
                }
                if let Some(progress) = self.receiving.progress() {
                    self.control.push(progress);
                }
                self.report(now);
            }
            Packet::Progress { sequence, end, .. } => {
                let progress = self.sending.progress(sequence, end, now);
                self.refuse(progress);
            }
            Packet::Lost { sequence, received, .. } => {
                let lost = self.sending.lost((sequence, received), self.measurement.reported_lost(), now);
                if let Some((tag, total, lost)) = self.refuse(lost) {
                    self.events.extend(lost.map(Event::Lost));
                    self.control.push(Packet::LostKnown { connection, sequence, tag, total });
                }
            }
            Packet::LostKnown { sequence, tag, total, .. } => {
                let incomplete = self.receiving.known(sequence, tag, total);
                self.events.extend(incomplete.map(Event::Incomplete));
            }
            Packet::Ping { heartbeat, .. } => {
                self.apply_heartbeat(&heartbeat, now);
                let heartbeat = self.heartbeat(heartbeat.time, now);
                self.control.push(Packet::Pong { connection, heartbeat });
            }
            Packet::Pong { heartbeat, .. } => {
                self.apply_heartbeat(&heartbeat, now);
                let asked = Span::from_nanos(i64::try_from(heartbeat.time).unwrap_or(0));
                self.measurement.answer(MonoTime::default() + asked, now);
            }
            Packet::Bye { next, .. } => self.receive_bye(next, now),
            Packet::ByeHeard { .. } => self.shutdown.confirm(),
            Packet::Path { token, .. } => self.control.push(Packet::PathConfirmed { connection, token }),
            Packet::Reset { reason, .. } => self.end(match reason {
                ResetReason::Unknown => "the peer does not know the connection any more: it was restarted, or it gave the connection up",
                ResetReason::Full => "the peer has too many connections",
                ResetReason::LongLost => LONG_DATAGRAMS_LOST,
            }),
            // Packets of the handshake and confirmed paths do not belong to a connection; the endpoint handles them.
            _ => {}
        }
    }

    /// Returns the heartbeat of this end.
    fn heartbeat(&mut self, time: u64, now: MonoTime) -> Heartbeat {
        Heartbeat {
            time,
            next: self.sending.next(),
            settled: self.receiving.settled(),
            number: self.sending.datagrams() as u32,
            arrivals: self.measurement.totals(now),
        }
    }

    /// Applies a heartbeat of the other end.
    fn apply_heartbeat(&mut self, heartbeat: &Heartbeat, now: MonoTime) {
        // A duplicated heartbeat says nothing new, and must not count as a second contradiction.
        if !self.heartbeats.receive(heartbeat) {
            return;
        }
        let settled = self.sending.settled(heartbeat.settled);
        if self.refuse(settled).is_none() {
            if self.heartbeats.contradict() {
                self.send_bye();
                self.end(CONTRADICTED);
            }
            return;
        }
        self.heartbeats.agree();
        // Each of these checks its own fields, so that one altered field does not hide what the others report.
        let reported =
            self.measurement.report(heartbeat.number, heartbeat.arrivals, self.sending.datagrams(), now);
        self.refuse(reported);
        let expected = self.receiving.expect(heartbeat.next, heartbeat.time, now);
        self.refuse(expected);
    }

    /// Reports a false claim as garbage. A false claim has no other effect.
    fn refuse<T>(&mut self, claim: Result<T, FalseClaim>) -> Option<T> {
        claim.map_err(|claim| self.events.push_back(Event::InvalidData(claim.to_string()))).ok()
    }

    /// Returns the totals of the datagrams of both directions, and the round trip.
    pub(crate) fn statistics(&mut self, now: MonoTime) -> TransportStatistics {
        self.measurement.statistics(self.sending.datagrams(), self.sending.retransmitted(), now)
    }

    fn receive_bye(&mut self, next: u64, now: MonoTime) {
        let count = self.shutdown.receive_bye();
        let expected = self.receiving.expect(next, count.into(), now);
        self.refuse(expected);
        // The other end does not wait any longer, so its unfinished messages will never be completed.
        if self.shutdown.gives_up_messages() {
            self.receiving.give_up_all();
        }
        self.report(now);
        if self.receiving.is_settled() || self.shutdown.is_last_bye() {
            self.control.push(Packet::ByeHeard { connection: self.writer.connection() });
            self.end("the peer closed the connection");
        }
    }

    /// Closes the connection after the queued messages have been sent.
    pub(crate) fn close(&mut self, now: MonoTime) {
        self.shutdown.begin(now);
    }

    /// Closes the connection at once, with a single goodbye.
    pub(crate) fn abandon(&mut self) {
        self.control.clear();
        self.send_bye();
        self.shutdown.close();
    }

    fn send_bye(&mut self) {
        self.control.push(Packet::Bye { connection: self.writer.connection(), next: self.sending.next() });
    }

    /// Returns whether the connection is over. Packets that arrive then have no effect.
    pub(crate) fn is_closed(&self) -> bool {
        self.shutdown.is_closed()
    }

    /// Ends the connection and reports the reason.
    pub(crate) fn end(&mut self, reason: impl Into<String>) {
        if self.shutdown.close() {
            self.events.push_back(Event::Gone(reason.into()));
        }
    }

    /// Does everything that is due at `now`.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        if self.shutdown.is_closed() {
            return;
        }
        self.sending.tick(now);
        self.receiving.tick(now);
        let expired = self.sending.expire(now);
        self.events.extend(expired.into_iter().map(Event::Lost));
        self.report(now);
        if self.sending.loses_long(self.measurement.reported_lost(), now) {
            tracing::debug!(bytes = self.sending.longest(), "none of the longest datagrams arrive");
            // The handshake of the next connection finds out which length passes.
            if self.writer.role() == Role::Cloud {
                self.control
                    .push(Packet::Reset { id: self.writer.connection(), reason: ResetReason::LongLost });
            }
            self.end(LONG_DATAGRAMS_LOST);
            return;
        }
        if self.timer.ends_at() <= now {
            let seconds = self.timer.timeout().seconds();
            self.end(format!("nothing was heard of the peer for {seconds} s"));
            return;
        }
        if self.ping_at() <= now {
            self.timer.ping(now);
            self.measurement.ask(now);
            let time = u64::try_from(now.nanos()).unwrap_or(0);
            let heartbeat = self.heartbeat(time, now);
            self.control.push(Packet::Ping { connection: self.writer.connection(), heartbeat });
        }
        if self.bye_at().is_some_and(|at| at <= now) {
            self.shutdown.send_bye(now);
            self.send_bye();
        }
    }

    fn ping_at(&self) -> MonoTime {
        self.timer.ping_at(self.sending.unsettled_since())
    }

    /// Returns the time of the next goodbye. All messages are sent before the first one.
    fn bye_at(&self) -> Option<MonoTime> {
        self.shutdown.bye_at().filter(|_| self.sending.is_empty())
    }

    /// Returns the latest time for the next call of [`tick`](Self::tick).
    pub(crate) fn next_timer(&self, now: MonoTime) -> MonoTime {
        let next = self.ping_at().min(self.timer.ends_at());
        let others = [self.bye_at(), self.sending.opens_at(), self.receiving.next_timer(now, TICK)];
        others.into_iter().flatten().fold(next, MonoTime::min)
    }

    /// Removes and returns the next event.
    pub(crate) fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Appends datagrams that may be sent now. `None` if there are none.
    pub(crate) fn fill(&mut self, out: &mut Vec<u8>, most: usize, now: MonoTime) -> Option<Batch> {
        if let Some(batch) = self.control.fill(out) {
            return Some(batch);
        }
        if self.shutdown.is_closed() {
            return None;
        }
        self.sending.fill(out, most, now)
    }

    /// Reports losses to the other end and to the layer above.
    fn report(&mut self, now: MonoTime) {
        let known = self.receiving.take_lost(now);
        let (packets, silent) = self.receiving.reports(now);
        self.events.extend(known.into_iter().chain(silent).map(Event::Incomplete));
        packets.into_iter().for_each(|packet| self.control.push(packet));
    }
}
