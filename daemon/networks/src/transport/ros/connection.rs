//! One end of a virtual connection over topics, without I/O.
//!
//! A connection is what the companions of one random identifier belong to. It ends by a goodbye, by silence, or by the end
//! of the peer's topic, which its driver notices.

use std::collections::VecDeque;
use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};
use peernet_ros::messages::{Header, MessageInfo, Time};

use super::frames;
use super::pairing::{Half, Pairing, request_of};
use super::parts::Parts;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{Frames, MessageLoss};

/// Largest stamp of a header, in nanoseconds: what both versions of ROS can say.
const MAX_STAMP: i64 = i32::MAX as i64 * 1_000_000_000;

/// Bounds of a connection.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConnectionLimits {
    /// Bytes of all frames of a message.
    pub(super) max_message_bytes: u64,
    /// Whether this end says that it receives the payload topic, which the other one cannot know.
    pub(super) confirms_payloads: bool,
    /// Messages of which only one half is there.
    pub(super) max_incomplete: usize,
    /// How long the other half is awaited.
    pub(super) pairing_timeout: Span,
    pub(super) heartbeat_interval: Span,
    pub(super) heartbeat_timeout: Span,
}

/// Something that happened on a connection.
#[derive(Debug)]
pub(super) enum Event {
    /// The edge says hello, again if it has not heard the welcome.
    Hello,
    /// The cloud's answer.
    Welcome,
    Message(Frames, Vec<Reservation>),
    /// A message of the peer did not arrive as a whole.
    Incomplete(MessageLoss),
    /// A message to the peer did not arrive as a whole.
    Lost(MessageLoss),
    Garbage(String),
    /// What makes the connection worse than it could be, on what object, and what to do.
    Remark(String),
    Gone(String),
}

/// One end.
#[derive(Debug)]
pub(super) struct Connection {
    id: String,
    limits: ConnectionLimits,
    budget: Arc<MemoryBudget>,
    next_sequence: u64,
    last_stamp: i64,
    /// Number of the peer's next companion; unknown before the first.
    expected: Option<u64>,
    missed: u64,
    heard_at: MonoTime,
    sent_at: MonoTime,
    pairing: Pairing,
    events: VecDeque<Event>,
    /// Requests whose message arrived in part; the peer is told.
    notices: VecDeque<u64>,
    /// The first bytes of a message whose companion is still to come.
    parts: Option<Parts>,
    /// Stamp of the last companion with all frames of its message.
    last_whole: i64,
    /// Whether a payload arrived, which is to be confirmed once.
    confirmation: Confirmation,
    /// Messages about the session itself that wait for payloads which they overtook.
    overtaking: Vec<(MessageInfo, Reservation)>,
    /// Reason of a goodbye that waits for payloads which it overtook.
    goodbye: Option<String>,
    /// State of the other end, as it says.
    peer: PeerState,
    is_closed: bool,
}

/// Whether the other end knows that payloads arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Confirmation {
    NothingArrived,
    Due,
    Sent,
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
            id,
            pairing: Pairing::new(limits.max_incomplete, limits.pairing_timeout),
            limits,
            budget,
            next_sequence: 0,
            last_stamp: 0,
            expected: None,
            missed: 0,
            heard_at: now,
            sent_at: now,
            events: VecDeque::new(),
            notices: VecDeque::new(),
            parts: None,
            last_whole: i64::MIN,
            confirmation: Confirmation::NothingArrived,
            overtaking: Vec::new(),
            goodbye: None,
            peer: PeerState::default(),
            is_closed: false,
        }
    }

    pub(super) fn id(&self) -> &str {
        &self.id
    }

    pub(super) fn is_closed(&self) -> bool {
        self.is_closed
    }

    pub(super) fn peer(&self) -> PeerState {
        self.peer
    }

    /// Companions of the peer that never arrived.
    pub(super) fn missed(&self) -> u64 {
        self.missed
    }

    /// Begins a message that departs at `wall`, nanoseconds since the Unix epoch. Stamps increase whatever the wall clock
    /// does, because a payload is found by its stamp.
    pub(super) fn begin(&mut self, kind: u8, wall: i64, now: MonoTime) -> MessageInfo {
        let least = self.last_stamp + 1;
        self.last_stamp = if wall <= MAX_STAMP { wall.max(least) } else { least };
        self.sent_at = now;
        let sequence = self.next_sequence;
        self.next_sequence += 1;
        let stamp = Time::from_nanos(self.last_stamp);
        let seq = u32::try_from(sequence & u64::from(u32::MAX)).unwrap_or_default();
        let header = Header { seq, stamp, frame_id: self.id.clone() };
        MessageInfo { header, kind, sequence, request: MessageInfo::NO_REQUEST, ..MessageInfo::default() }
    }

    /// Returns a companion for the first bytes of a message, and gives the message the number after it.
    pub(super) fn begin_part(&mut self, message: &mut MessageInfo) -> MessageInfo {
        let header = message.header.clone();
        let part = MessageInfo {
            header,
            kind: MessageInfo::PART,
            sequence: message.sequence,
            ..MessageInfo::default()
        };
        message.sequence = self.next_sequence;
        self.next_sequence += 1;
        MessageInfo { request: message.request, ..part }
    }

    /// A companion of this connection arrived.
    pub(super) fn hear_info(&mut self, info: MessageInfo, now: MonoTime) {
        if self.is_closed {
            return;
        }
        self.heard_at = now;
        let expected = self.expected.unwrap_or(info.sequence);
        self.missed += info.sequence.saturating_sub(expected);
        self.expected = Some(info.sequence.saturating_add(1).max(expected));
        match info.kind {
            MessageInfo::DATA => self.hear_data(info, now),
            MessageInfo::HELLO => {
                self.peer.receive_buffer_bytes = info.frame_lengths.first().copied();
                self.events.push_back(Event::Hello);
            }
            MessageInfo::WELCOME => {
                self.peer.receive_buffer_bytes = info.frame_lengths.first().copied();
                self.events.push_back(Event::Welcome);
            }
            MessageInfo::HEARTBEAT => {}
            MessageInfo::SUBSCRIBED => self.peer.is_subscribed = true,
            MessageInfo::PART => {
                let parts = self.parts.take();
                self.parts =
                    Parts::extended(parts, (&info, now), &self.budget, self.limits.max_message_bytes);
            }
            MessageInfo::LOST => {
                let loss = MessageLoss { tag: request_of(&info), received: 1, total: 2 };
                self.events.push_back(Event::Lost(loss));
            }
            MessageInfo::GOODBYE => {
                self.peer.has_left = true;
                self.goodbye = Some(peernet_sample::printable_line(&info.reason).into_owned());
                self.end_after_payloads();
            }
            kind => self.events.push_back(Event::Garbage(format!("a message of the unknown kind {kind}"))),
        }
    }

    /// Ends the connection after a goodbye. Both topics have no common order: payloads whose companions came are awaited.
    fn end_after_payloads(&mut self) {
        if self.pairing.awaits_payloads() {
            return;
        }
        self.deliver_overtaking();
        if let Some(reason) = self.goodbye.take() {
            self.end(reason);
        }
    }

    fn deliver_overtaking(&mut self) {
        for (info, reserved) in std::mem::take(&mut self.overtaking) {
            self.deliver(&info, None, vec![reserved]);
        }
    }

    fn hear_data(&mut self, mut info: MessageInfo, now: MonoTime) {
        // Parts of another message are of one that was given up. The memory of the whole is counted below.
        if let Some(parts) = self.parts.take().filter(|parts| parts.is_of(&info)) {
            info.frames = parts.joined(&info.frames);
        }
        if let Err(problem) = frames::check(&info, self.limits.max_message_bytes) {
            self.events.push_back(Event::Garbage(problem.to_string()));
            return;
        }
        let Some(reserved) = self.reserve(info.frames.len()) else {
            self.lose(vec![MessageLoss { tag: request_of(&info), received: 1, total: 2 }]);
            return;
        };
        let stamp = info.header.stamp.as_nanos();
        let mut lost = Vec::new();
        if info.has_payload {
            let half = Half::Info(Box::new(info));
            let pair = self.pairing.add(stamp, half, reserved, now, &mut lost);
            self.lose(lost);
            if let Some(pair) = pair {
                self.deliver(&pair.info, Some(&pair.payload), pair.reserved.into());
            }
        } else {
            // The payload may come as well, until it is confirmed that payloads do.
            self.last_whole = stamp.max(self.last_whole);
            self.pairing.drop_payload(stamp);
            self.pairing.skip(stamp, &mut lost);
            self.lose(lost);
            // It may end the session, of which answers would be lost then.
            if info.request == MessageInfo::NO_REQUEST && self.pairing.awaits_payloads() {
                self.overtaking.push((info, reserved));
            } else {
                self.deliver(&info, None, vec![reserved]);
            }
        }
    }

    /// A payload of this connection arrived.
    pub(super) fn hear_payload(&mut self, stamp: i64, payload: Bytes, now: MonoTime) {
        if self.is_closed {
            return;
        }
        self.heard_at = now;
        if self.limits.confirms_payloads && self.confirmation == Confirmation::NothingArrived {
            self.confirmation = Confirmation::Due;
        }
        // Its companion had all frames.
        if self.limits.confirms_payloads && stamp <= self.last_whole && !self.pairing.awaits_payload(stamp) {
            return;
        }
        let length = payload.len() as u64;
        if length > self.limits.max_message_bytes {
            self.events.push_back(Event::Garbage(format!("a payload of {length} bytes")));
            return;
        }
        // Its companion is still to come, and tells which request it was.
        let Some(reserved) = self.reserve(payload.len()) else { return };
        let mut lost = Vec::new();
        let pair = self.pairing.add(stamp, Half::Payload(payload), reserved, now, &mut lost);
        self.lose(lost);
        if let Some(pair) = pair {
            self.deliver(&pair.info, Some(&pair.payload), pair.reserved.into());
        }
        self.end_after_payloads();
    }

    /// Changes the budget of messages that arrive from now on.
    pub(super) fn set_budget(&mut self, budget: Arc<MemoryBudget>) {
        self.budget = budget;
    }

    fn reserve(&self, bytes: usize) -> Option<Reservation> {
        let mut reserved = Reservation::empty(&self.budget);
        reserved.set(&self.budget, bytes as u64).ok().map(|()| reserved)
    }

    fn deliver(&mut self, info: &MessageInfo, payload: Option<&Bytes>, reserved: Vec<Reservation>) {
        self.events.push_back(match frames::unpack(info, payload) {
            Ok(frames) => Event::Message(frames, reserved),
            Err(problem) => Event::Garbage(problem.to_string()),
        });
    }

    fn lose(&mut self, lost: Vec<MessageLoss>) {
        for loss in lost {
            self.notices.extend(loss.tag);
            self.events.push_back(Event::Incomplete(loss));
        }
    }

    /// The time has come that [`next_timer`](Self::next_timer) said.
    pub(super) fn tick(&mut self, now: MonoTime) {
        let mut lost = Vec::new();
        self.pairing.expire(now, &mut lost);
        // The companion that they belong to was lost, which its number shows.
        let patience = self.limits.pairing_timeout;
        self.parts = self.parts.take().filter(|parts| !parts.is_overdue(now, patience));
        self.lose(lost);
        self.end_after_payloads();
        if !self.is_closed && now - self.heard_at >= self.limits.heartbeat_timeout {
            let goodbye = self.goodbye.take();
            self.end(goodbye.unwrap_or_else(|| "the peer has been silent for too long".to_owned()));
        }
    }

    /// The next message that nobody asked to send: a heartbeat, or that a message arrived in part.
    pub(super) fn next_notice(&mut self, wall: i64, now: MonoTime) -> Option<MessageInfo> {
        if self.is_closed {
            return None;
        }
        if let Some(request) = self.notices.pop_front() {
            return Some(MessageInfo { request, ..self.begin(MessageInfo::LOST, wall, now) });
        }
        if self.confirmation == Confirmation::Due {
            self.confirmation = Confirmation::Sent;
            return Some(self.begin(MessageInfo::SUBSCRIBED, wall, now));
        }
        let is_due = now - self.sent_at >= self.limits.heartbeat_interval;
        is_due.then(|| self.begin(MessageInfo::HEARTBEAT, wall, now))
    }

    pub(super) fn next_timer(&self) -> Option<MonoTime> {
        if self.is_closed {
            return None;
        }
        let heartbeats = (self.sent_at + self.limits.heartbeat_interval)
            .min(self.heard_at + self.limits.heartbeat_timeout);
        Some(self.pairing.next_timer().map_or(heartbeats, |next| next.min(heartbeats)))
    }

    pub(super) fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Counts a message of the peer that makes no sense.
    pub(super) fn garbage(&mut self, problem: String) {
        if !self.is_closed {
            self.events.push_back(Event::Garbage(problem));
        }
    }

    /// Says what makes the connection worse than it could be.
    pub(super) fn remark(&mut self, text: String) {
        self.events.push_back(Event::Remark(text));
    }

    /// Ends the connection; the first reason counts.
    pub(super) fn end(&mut self, reason: String) {
        if !self.is_closed {
            self.is_closed = true;
            self.events.push_back(Event::Gone(reason));
        }
    }
}

#[cfg(test)]
mod tests;
