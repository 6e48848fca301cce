//! State machine of one end of a virtual connection over topics, without I/O.
//!
//! A connection has a random identifier, which all its companions carry. It ends with a goodbye, by silence, or when
//! the peer leaves a topic, which the connection's task reports.

mod assembly;
mod confirmation;
mod events;
mod heartbeats;
mod sequence;

use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};
use peernet_ros::messages::MessageInfo;

use self::assembly::MessageAssembly;
use self::confirmation::PayloadConfirmation;
pub(super) use self::events::Event;
use self::events::EventQueue;
use self::heartbeats::Heartbeats;
use self::sequence::{IncomingSequence, OutgoingSequence};
use super::pairing::request_number;
use crate::transport::MessageLoss;
use crate::transport::memory::MemoryBudget;

/// Limits of a connection.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConnectionLimits {
    /// Largest sum of the lengths of all frames of a message. Bytes.
    pub(super) max_message_bytes: u64,
    /// `true` if this end must confirm that it receives the payload topic, because the other end cannot find that out
    /// by itself.
    pub(super) confirms_payloads: bool,
    /// Maximum number of messages of which only the companion or only the payload has arrived.
    pub(super) max_incomplete: usize,
    /// Time limit for the payload after its companion, or for the companion after its payload.
    pub(super) pairing_timeout: Span,
    pub(super) heartbeat_interval: Span,
    pub(super) heartbeat_timeout: Span,
}

/// One end of a connection.
#[derive(Debug)]
pub(super) struct Connection {
    outgoing: OutgoingSequence,
    incoming: IncomingSequence,
    heartbeats: Heartbeats,
    assembly: MessageAssembly,
    events: EventQueue,
    confirmation: PayloadConfirmation,
    /// State of the other end, according to its reports.
    peer: PeerState,
    phase: Phase,
}

/// Phase of a connection.
#[derive(Debug)]
enum Phase {
    Open,
    /// The peer has said goodbye with this reason. The connection ends when the payloads have arrived whose companions
    /// arrived before the goodbye.
    Leaving(String),
    Closed,
}

/// State of the other end of a connection, according to its reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PeerState {
    /// Largest payload message that the other end can receive, if limited. Bytes.
    pub(super) receive_buffer_bytes: Option<u32>,
    /// `true` if payloads of this connection arrive at the other end. They are then not sent in their companions.
    pub(super) is_subscribed: bool,
    /// `true` if the other end has said goodbye.
    pub(super) has_left: bool,
}

impl Connection {
    pub(super) fn new(
        id: String,
        limits: ConnectionLimits,
        budget: Arc<MemoryBudget>,
        now: MonoTime,
    ) -> Self {
        Self {
            outgoing: OutgoingSequence::new(id),
            incoming: IncomingSequence::default(),
            heartbeats: Heartbeats::new(limits.heartbeat_interval, limits.heartbeat_timeout, now),
            assembly: MessageAssembly::new(&limits, budget),
            events: EventQueue::default(),
            confirmation: PayloadConfirmation::new(limits.confirms_payloads),
            peer: PeerState::default(),
            phase: Phase::Open,
        }
    }

    /// Returns the identifier of the connection.
    pub(super) fn id(&self) -> &str {
        self.outgoing.connection()
    }

    pub(super) fn is_closed(&self) -> bool {
        matches!(self.phase, Phase::Closed)
    }

    pub(super) fn peer(&self) -> PeerState {
        self.peer
    }

    /// Returns whether a companion of the peer was received.
    pub(super) fn has_received(&self) -> bool {
        self.incoming.has_received()
    }

    /// Returns the number of the peer's companions that never arrived.
    pub(super) fn missing_companions(&self) -> u64 {
        self.incoming.missing_companions()
    }

    /// Creates the companion of a message that departs at `wall`, in nanoseconds since the Unix epoch.
    pub(super) fn new_companion(&mut self, kind: u8, wall: i64, now: MonoTime) -> MessageInfo {
        self.heartbeats.note_sent(now);
        self.outgoing.new_companion(kind, wall)
    }

    /// Returns a companion for a fragment of a message. The fragment takes the number of the message, and the message
    /// gets the next number, because its last companion is sent after the fragment.
    pub(super) fn new_fragment(&mut self, message: &mut MessageInfo) -> MessageInfo {
        self.outgoing.new_fragment(message)
    }

    /// Creates the companion of a message with frames that departs at `wall`, in nanoseconds since the Unix epoch. The
    /// caller must call [`note_sent`](Self::note_sent) or [`take_back_numbers`](Self::take_back_numbers) next.
    pub(super) fn new_data_companion(&mut self, wall: i64) -> MessageInfo {
        self.outgoing.new_companion(MessageInfo::DATA, wall)
    }

    /// Notes that a message was sent, which replaces the next heartbeat.
    pub(super) fn note_sent(&mut self, now: MonoTime) {
        self.heartbeats.note_sent(now);
    }

    /// Takes back the numbers from `first` on, whose companions were not sent.
    pub(super) fn take_back_numbers(&mut self, first: u64) {
        self.outgoing.take_back_numbers(first);
    }

    /// Handles a companion of this connection.
    pub(super) fn receive_companion(&mut self, info: MessageInfo, now: MonoTime) {
        if self.is_closed() {
            return;
        }
        self.heartbeats.note_received(now);
        self.incoming.receive(info.sequence);
        match info.kind {
            MessageInfo::DATA => self.assembly.receive_data(info, now, &mut self.events),
            MessageInfo::HELLO => {
                // A hello and a welcome have no frames. Their list of frame lengths contains the size of the other
                // end's receive buffer.
                self.peer.receive_buffer_bytes = info.frame_lengths.first().copied();
                self.events.push(Event::Hello);
            }
            MessageInfo::WELCOME => {
                self.peer.receive_buffer_bytes = info.frame_lengths.first().copied();
                self.events.push(Event::Welcome);
            }
            MessageInfo::HEARTBEAT => {}
            MessageInfo::SUBSCRIBED => self.peer.is_subscribed = true,
            MessageInfo::PART => self.assembly.receive_fragment(&info, now),
            MessageInfo::LOST => {
                // The peer received the companion, which names the request, but not the payload.
                let loss = MessageLoss { tag: request_number(&info), received: 1, total: 2 };
                self.events.push(Event::OutgoingLost(loss));
            }
            MessageInfo::GOODBYE => {
                self.peer.has_left = true;
                self.phase = Phase::Leaving(peernet_sample::printable_line(&info.reason).into_owned());
                self.handle_overtaking_messages();
            }
            kind => self.events.push(Event::InvalidData(format!("a message of the unknown kind {kind}"))),
        }
    }

    /// Handles a payload of this connection.
    pub(super) fn receive_payload(&mut self, stamp: i64, payload: Bytes, now: MonoTime) {
        if self.is_closed() {
            return;
        }
        self.heartbeats.note_received(now);
        self.confirmation.note_payload();
        self.assembly.receive_payload(stamp, payload, now, &mut self.events);
        self.handle_overtaking_messages();
    }

    /// Handles the messages that overtook payloads, once no companion waits for its payload: delivers the messages
    /// about the session, and ends the connection if the peer has said goodbye. A message may overtake a payload,
    /// because the two topics have no common order.
    fn handle_overtaking_messages(&mut self) {
        let has_all_payloads = self.assembly.deliver_overtaking_messages(&mut self.events);
        if has_all_payloads && let Phase::Leaving(reason) = &mut self.phase {
            let reason = std::mem::take(reason);
            self.end(reason);
        }
    }

    /// Changes the budget for messages that arrive from now on.
    pub(super) fn set_budget(&mut self, budget: Arc<MemoryBudget>) {
        self.assembly.set_budget(budget);
    }

    /// Handles the timers that have expired. [`next_timer`](Self::next_timer) returns the time of the next timer.
    pub(super) fn tick(&mut self, now: MonoTime) {
        self.assembly.expire(now, &mut self.events);
        self.handle_overtaking_messages();
        if self.heartbeats.is_peer_silent(now) {
            let silence = || "the peer has been silent for too long".to_owned();
            // A peer that has said goodbye is expected to be silent. The reason of its goodbye is more useful than a
            // report of the silence.
            let goodbye = match &mut self.phase {
                Phase::Leaving(reason) => Some(std::mem::take(reason)),
                Phase::Open | Phase::Closed => None,
            };
            self.end(goodbye.unwrap_or_else(silence));
        }
    }

    /// Returns the next message that is due without a call to send: a heartbeat, a confirmation, or a notice that a
    /// message arrived only in part.
    pub(super) fn next_notice(&mut self, wall: i64, now: MonoTime) -> Option<MessageInfo> {
        if self.is_closed() {
            return None;
        }
        // Losses are reported first, because a request of the other end waits for the report.
        if let Some(request) = self.events.pop_lost_request() {
            return Some(MessageInfo { request, ..self.new_companion(MessageInfo::LOST, wall, now) });
        }
        if self.confirmation.take_if_due() {
            return Some(self.new_companion(MessageInfo::SUBSCRIBED, wall, now));
        }
        self.heartbeats.is_due(now).then(|| self.new_companion(MessageInfo::HEARTBEAT, wall, now))
    }

    /// Returns the time for the next call of [`tick`](Self::tick).
    pub(super) fn next_timer(&self) -> Option<MonoTime> {
        if self.is_closed() {
            return None;
        }
        let heartbeats = self.heartbeats.next_timer();
        Some(self.assembly.next_timer().map_or(heartbeats, |next| next.min(heartbeats)))
    }

    pub(super) fn next_event(&mut self) -> Option<Event> {
        self.events.pop()
    }

    /// Reports an invalid message of the peer.
    pub(super) fn report_invalid(&mut self, problem: String) {
        if !self.is_closed() {
            self.events.push(Event::InvalidData(problem));
        }
    }

    /// Adds an [`Event::Remark`] with this text.
    pub(super) fn remark(&mut self, text: String) {
        self.events.push(Event::Remark(text));
    }

    /// Ends the connection. Later calls do not change the reason.
    pub(super) fn end(&mut self, reason: String) {
        if !self.is_closed() {
            self.phase = Phase::Closed;
            self.events.push(Event::Gone(reason));
        }
    }
}

#[cfg(test)]
mod tests;
