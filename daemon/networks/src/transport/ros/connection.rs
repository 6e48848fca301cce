//! One end of a virtual connection over topics, without I/O.
//!
//! A connection has a random identifier, which all its companions carry. It ends by a goodbye, by silence, or by the end of the
//! peer's topic, which its driver notices.

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
use super::pairing::request_of;
use crate::transport::MessageLoss;
use crate::transport::memory::MemoryBudget;

/// Bounds of a connection.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConnectionLimits {
    /// Bytes of all frames of a message.
    pub(super) max_message_bytes: u64,
    /// Whether this end says that it receives the payload topic, which the other one cannot know.
    pub(super) confirms_payloads: bool,
    /// Largest number of messages of which only one half has arrived.
    pub(super) max_incomplete: usize,
    /// Timeout of the other half of a message.
    pub(super) pairing_timeout: Span,
    pub(super) heartbeat_interval: Span,
    pub(super) heartbeat_timeout: Span,
}

/// One end.
#[derive(Debug)]
pub(super) struct Connection {
    outgoing: OutgoingSequence,
    incoming: IncomingSequence,
    heartbeats: Heartbeats,
    assembly: MessageAssembly,
    events: EventQueue,
    confirmation: PayloadConfirmation,
    /// State of the other end, as it says.
    peer: PeerState,
    phase: Phase,
}

/// Progress of a connection from its beginning to its end.
#[derive(Debug)]
enum Phase {
    Open,
    /// The peer has said goodbye with a reason, which waits for payloads that it overtook.
    Leaving(String),
    Closed,
}

/// State of the other end of a connection, as it says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PeerState {
    /// Bytes of the longest payload message that it takes, if that is bounded.
    pub(super) receive_buffer_bytes: Option<u32>,
    /// Payloads of this connection arrive there: they need not travel in their companions as well.
    pub(super) is_subscribed: bool,
    /// It has said goodbye.
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

    /// Returns the number of companions of the peer that never arrived.
    pub(super) fn missed(&self) -> u64 {
        self.incoming.missed()
    }

    /// Begins a message that departs at `wall`, nanoseconds since the Unix epoch.
    pub(super) fn begin(&mut self, kind: u8, wall: i64, now: MonoTime) -> MessageInfo {
        self.heartbeats.note_sent(now);
        self.outgoing.begin(kind, wall)
    }

    /// Returns a companion for the first bytes of a message, and gives the message the number after it.
    pub(super) fn begin_part(&mut self, message: &mut MessageInfo) -> MessageInfo {
        self.outgoing.begin_part(message)
    }

    /// Takes a companion of this connection that arrived.
    pub(super) fn hear_info(&mut self, info: MessageInfo, now: MonoTime) {
        if self.is_closed() {
            return;
        }
        self.heartbeats.note_heard(now);
        self.incoming.hear(info.sequence);
        match info.kind {
            MessageInfo::DATA => self.assembly.hear_data(info, now, &mut self.events),
            MessageInfo::HELLO => {
                self.peer.receive_buffer_bytes = info.frame_lengths.first().copied();
                self.events.push(Event::Hello);
            }
            MessageInfo::WELCOME => {
                self.peer.receive_buffer_bytes = info.frame_lengths.first().copied();
                self.events.push(Event::Welcome);
            }
            MessageInfo::HEARTBEAT => {}
            MessageInfo::SUBSCRIBED => self.peer.is_subscribed = true,
            MessageInfo::PART => self.assembly.hear_part(&info, now),
            MessageInfo::LOST => {
                let loss = MessageLoss { tag: request_of(&info), received: 1, total: 2 };
                self.events.push(Event::Lost(loss));
            }
            MessageInfo::GOODBYE => {
                self.peer.has_left = true;
                self.phase = Phase::Leaving(peernet_sample::printable_line(&info.reason).into_owned());
                self.end_after_payloads();
            }
            kind => self.events.push(Event::Garbage(format!("a message of the unknown kind {kind}"))),
        }
    }

    /// Takes a payload of this connection that arrived.
    pub(super) fn hear_payload(&mut self, stamp: i64, payload: Bytes, now: MonoTime) {
        if self.is_closed() {
            return;
        }
        self.heartbeats.note_heard(now);
        self.confirmation.note_payload();
        self.assembly.hear_payload(stamp, payload, now, &mut self.events);
        self.end_after_payloads();
    }

    /// Ends the connection after a goodbye. Both topics have no common order: payloads whose companions came are awaited.
    fn end_after_payloads(&mut self) {
        let has_all_payloads = self.assembly.deliver_overtaking(&mut self.events);
        if has_all_payloads && let Phase::Leaving(reason) = &mut self.phase {
            let reason = std::mem::take(reason);
            self.end(reason);
        }
    }

    /// Changes the budget of messages that arrive from now on.
    pub(super) fn set_budget(&mut self, budget: Arc<MemoryBudget>) {
        self.assembly.set_budget(budget);
    }

    /// Handles the timers that have expired; [`next_timer`](Self::next_timer) says when the next one does.
    pub(super) fn tick(&mut self, now: MonoTime) {
        self.assembly.expire(now, &mut self.events);
        self.end_after_payloads();
        if self.heartbeats.is_peer_silent(now) {
            let silence = || "the peer has been silent for too long".to_owned();
            let goodbye = match &mut self.phase {
                Phase::Leaving(reason) => Some(std::mem::take(reason)),
                Phase::Open | Phase::Closed => None,
            };
            self.end(goodbye.unwrap_or_else(silence));
        }
    }

    /// Returns the next message that is due without a call to send: a heartbeat, or a notice that a message arrived in part.
    pub(super) fn next_notice(&mut self, wall: i64, now: MonoTime) -> Option<MessageInfo> {
        if self.is_closed() {
            return None;
        }
        if let Some(request) = self.events.pop_lost_request() {
            return Some(MessageInfo { request, ..self.begin(MessageInfo::LOST, wall, now) });
        }
        if self.confirmation.take_due() {
            return Some(self.begin(MessageInfo::SUBSCRIBED, wall, now));
        }
        self.heartbeats.is_due(now).then(|| self.begin(MessageInfo::HEARTBEAT, wall, now))
    }

    /// Returns when [`tick`](Self::tick) is to be called next.
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

    /// Counts a message of the peer that makes no sense.
    pub(super) fn garbage(&mut self, problem: String) {
        if !self.is_closed() {
            self.events.push(Event::Garbage(problem));
        }
    }

    /// Reports a condition that makes the connection worse than it could be.
    pub(super) fn remark(&mut self, text: String) {
        self.events.push(Event::Remark(text));
    }

    /// Ends the connection; the first reason counts.
    pub(super) fn end(&mut self, reason: String) {
        if !self.is_closed() {
            self.phase = Phase::Closed;
            self.events.push(Event::Gone(reason));
        }
    }
}

#[cfg(test)]
mod tests;
