//! One end of a virtual connection, without I/O: its sending half, its receiving half, heartbeats and the goodbye.
//!
//! An end sends a ping if nothing arrived for the heartbeat interval. It pings sooner while messages that it sent are
//! not settled (delivered or counted as lost), because the answer says which messages never arrived. If nothing arrives
//! for the heartbeat timeout, the connection ends. A connection is closed by a goodbye that is repeated until it is
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
const LONG_DATAGRAMS_LOST_REASON: &str = "long datagrams do not arrive any more, short ones do: a link on the path has a smaller MTU and \
     does not report it; correct its MTU, or set datagram_bytes to a length that passes (1200 is tried automatically)";

/// Reason for the end of a connection whose ends contradict each other.
const CONTRADICTION_REASON: &str = "the peer repeatedly reports messages that were never sent: packets are altered or forged on the path; \
     open a new connection";

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
    IncomingLost(MessageLoss),
    /// A message that was sent did not arrive as a whole.
    OutgoingLost(MessageLoss),
    /// An invalid packet arrived. The text says what is invalid.
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
    /// Creates a connection that the handshake has opened. `terms` are the terms of the other end.
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

    /// Replaces the limits for incomplete messages from the other end.
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
        self.timer.record_arrival(now);
        let connection = self.writer.connection();
        match packet {
            Packet::Data { number, fragment, .. } => {
                self.measurement.record_arrival(number, now);
                match self.receiving.receive(number, &fragment, now) {
                    FragmentOutcome::Message(bytes, reserved) => match split_frames(bytes) {
                        Ok(frames) => self.events.push_back(Event::Message(frames, reserved)),
                        Err(error) => self.events.push_back(Event::InvalidData(error.to_string())),
                    },
                    FragmentOutcome::Nothing => {}
                    FragmentOutcome::InvalidData(problem) => self.events.push_back(Event::InvalidData(problem)),
                }
                if let Some(progress) = self.receiving.take_progress() {
                    self.control.push(progress);
                }
                self.report_losses(now);
            }
            Packet::Progress { sequence, end, .. } => {
                let progress = self.sending.receive_progress(sequence, end, now);
                self.report_false_claim(progress);
            }
            Packet::Lost { sequence, received, .. } => {
                // The confirmation has the tag, so the receiving end can report which message is incomplete.
                let lost = self.sending.receive_loss((sequence, received), self.measurement.reported_lost(), now);
                if let Some((tag, total, lost)) = self.report_false_claim(lost) {
                    self.events.extend(lost.map(Event::OutgoingLost));
                    self.control.push(Packet::LostAck { connection, sequence, tag, total });
                }
            }
            Packet::LostAck { sequence, tag, total, .. } => {
                let incomplete = self.receiving.confirm_loss(sequence, tag, total);
                self.events.extend(incomplete.map(Event::IncomingLost));
            }
            Packet::Ping { heartbeat, .. } => {
                self.receive_heartbeat(&heartbeat, now);
                // The time goes back unchanged: the end that sent the ping measures the round trip with its own
                // clock.
                let heartbeat = self.make_heartbeat(heartbeat.time, now);
                self.control.push(Packet::Pong { connection, heartbeat });
            }
            Packet::Pong { heartbeat, .. } => {
                self.receive_heartbeat(&heartbeat, now);
                let ping_sent_at = Span::from_nanos(i64::try_from(heartbeat.time).unwrap_or(0));
                self.measurement.record_pong(MonoTime::default() + ping_sent_at, now);
            }
            Packet::Bye { next, .. } => self.receive_bye(next, now),
            Packet::ByeAck { .. } => self.shutdown.confirm(),
            Packet::PathChallenge { token, .. } => self.control.push(Packet::PathResponse { connection, token }),
            Packet::Reset { reason, .. } => self.end(match reason {
                ResetReason::Unknown => "the peer does not know the connection any more: it was restarted, or it ended the connection",
                ResetReason::Full => "the peer has too many connections",
                ResetReason::LongLost => LONG_DATAGRAMS_LOST_REASON,
            }),
            // The endpoint handles the packets of the handshake and the responses to path challenges.
            _ => {}
        }
    }

    /// Returns the heartbeat of this end.
    fn make_heartbeat(&mut self, time: u64, now: MonoTime) -> Heartbeat {
        Heartbeat {
            time,
            next: self.sending.next_sequence(),
            settled: self.receiving.settled_below(),
            number: self.sending.datagrams() as u32,
            arrivals: self.measurement.totals(now),
        }
    }

    /// Applies a heartbeat of the other end.
    fn receive_heartbeat(&mut self, heartbeat: &Heartbeat, now: MonoTime) {
        // A duplicated heartbeat must not count as a second contradiction.
        if !self.heartbeats.record_if_new(heartbeat) {
            return;
        }
        let settled_claim = self.sending.receive_settled(heartbeat.settled);
        if self.report_false_claim(settled_claim).is_none() {
            if self.heartbeats.record_contradiction() {
                self.send_bye();
                self.end(CONTRADICTION_REASON);
            }
            return;
        }
        self.heartbeats.record_agreement();
        // The two calls below check different fields. Both calls are always made, so that a false claim in one field
        // does not prevent the use of the other fields.
        let totals_claim = self.measurement.receive_report(
            heartbeat.number,
            heartbeat.arrivals,
            self.sending.datagrams(),
            now,
        );
        self.report_false_claim(totals_claim);
        let sent_claim = self.receiving.note_sent(heartbeat.next, heartbeat.time, now);
        self.report_false_claim(sent_claim);
    }

    /// Reports a false claim as invalid data and returns `None`. Otherwise returns the result of the claim.
    fn report_false_claim<T>(&mut self, claim: Result<T, FalseClaim>) -> Option<T> {
        claim.map_err(|claim| self.events.push_back(Event::InvalidData(claim.to_string()))).ok()
    }

    /// Returns the totals of the datagrams of both directions, and the round trip.
    pub(crate) fn statistics(&mut self, now: MonoTime) -> TransportStatistics {
        self.measurement.statistics(self.sending.datagrams(), self.sending.retransmitted(), now)
    }

    fn receive_bye(&mut self, next: u64, now: MonoTime) {
        let count = self.shutdown.receive_bye();
        // A goodbye has no number of its own, so the number of goodbyes so far identifies it. A goodbye that the
        // network duplicates therefore confirms its own claim.
        let sent_claim = self.receiving.note_sent(next, count.into(), now);
        self.report_false_claim(sent_claim);
        // The other end closes the connection soon, so its unfinished messages will never be completed.
        if self.shutdown.must_give_up_messages() {
            self.receiving.give_up_all();
        }
        self.report_losses(now);
        // The confirmation waits for messages that are still arriving; the other end repeats its goodbye meanwhile.
        if self.receiving.is_settled() || self.shutdown.must_confirm_bye() {
            self.control.push(Packet::ByeAck { connection: self.writer.connection() });
            self.end("the peer closed the connection");
        }
    }

    /// Closes the connection after the queued messages have been sent.
    pub(crate) fn close(&mut self, now: MonoTime) {
        self.shutdown.start(now);
    }

    /// Closes the connection at once, with a single goodbye.
    pub(crate) fn abandon(&mut self) {
        // This end is about to leave, so it does not need the answers to its queued packets any more.
        self.control.clear();
        self.send_bye();
        self.shutdown.close();
    }

    fn send_bye(&mut self) {
        self.control
            .push(Packet::Bye { connection: self.writer.connection(), next: self.sending.next_sequence() });
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

    /// Runs the timers that have expired at `now`.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        if self.shutdown.is_closed() {
            return;
        }
        self.sending.tick(now);
        self.receiving.tick(now);
        let expired = self.sending.expire(now);
        self.events.extend(expired.into_iter().map(Event::OutgoingLost));
        self.report_losses(now);
        if self.sending.loses_all_long_datagrams(self.measurement.reported_lost(), now) {
            tracing::debug!(bytes = self.sending.longest_datagram(), "none of the longest datagrams arrive");
            // The handshake of the next connection finds out which length passes. The edge opens that connection, so a
            // cloud has to tell the edge.
            if self.writer.role() == Role::Cloud {
                self.control
                    .push(Packet::Reset { id: self.writer.connection(), reason: ResetReason::LongLost });
            }
            self.end(LONG_DATAGRAMS_LOST_REASON);
            return;
        }
        if self.timer.expires_at() <= now {
            let timeout_seconds = self.timer.timeout().seconds();
            self.end(format!("nothing was received from the peer for {timeout_seconds} s"));
            return;
        }
        if self.ping_at() <= now {
            self.timer.record_ping(now);
            self.measurement.record_ping(now);
            let time = u64::try_from(now.nanos()).unwrap_or(0);
            let heartbeat = self.make_heartbeat(time, now);
            self.control.push(Packet::Ping { connection: self.writer.connection(), heartbeat });
        }
        if self.bye_at().is_some_and(|bye_time| bye_time <= now) {
            self.shutdown.record_bye(now);
            self.send_bye();
        }
    }

    fn ping_at(&self) -> MonoTime {
        self.timer.ping_at(self.sending.last_send_if_unsettled())
    }

    /// Returns the time of the next goodbye. All messages are sent before the first goodbye.
    fn bye_at(&self) -> Option<MonoTime> {
        self.shutdown.bye_at().filter(|_| self.sending.is_empty())
    }

    /// Returns the latest time for the next call of [`tick`](Self::tick).
    pub(crate) fn next_timer(&self, now: MonoTime) -> MonoTime {
        let earliest_time = self.ping_at().min(self.timer.expires_at());
        let other_timers = [self.bye_at(), self.sending.opens_at(), self.receiving.next_timer(now, TICK)];
        other_timers.into_iter().flatten().fold(earliest_time, MonoTime::min)
    }

    /// Removes and returns the next event.
    pub(crate) fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Appends datagrams that may be sent now. `None` if there are none.
    pub(crate) fn fill(&mut self, out: &mut Vec<u8>, max_datagrams: usize, now: MonoTime) -> Option<Batch> {
        // Control packets are sent first, also after the end of the connection: they are short, and the other end waits
        // for them.
        if let Some(batch) = self.control.fill(out) {
            return Some(batch);
        }
        if self.shutdown.is_closed() {
            return None;
        }
        self.sending.fill(out, max_datagrams, now)
    }

    /// Reports losses to the other end and to the layer above.
    fn report_losses(&mut self, now: MonoTime) {
        let reportable = self.receiving.take_lost(now);
        let (packets, given_up) = self.receiving.due_reports(now);
        self.events.extend(reportable.into_iter().chain(given_up).map(Event::IncomingLost));
        packets.into_iter().for_each(|packet| self.control.push(packet));
    }
}
