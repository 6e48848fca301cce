//! Assembles the messages of the peer from their companions and payloads.

use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};
use peernet_ros::messages::MessageInfo;

use super::ConnectionLimits;
use super::events::{Event, EventQueue};
use crate::transport::MessageLoss;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::ros::fragments::FrameFragments;
use crate::transport::ros::frames::{self, FramesError};
use crate::transport::ros::pairing::{MessageHalf, Pairing, request_number};

/// Memory of a message about the session that waits, in addition to the bytes that the peer sent: more than a companion
/// and the list of its frame lengths take. Bytes.
const WAITING_OVERHEAD_BYTES: usize = 1_024;

/// Messages that have arrived in part. Their memory is reserved, and each waits for a limited time.
#[derive(Debug)]
pub(super) struct MessageAssembly {
    /// Largest sum of the lengths of all frames of a message. Bytes.
    max_message_bytes: u64,
    /// `true` if a payload may arrive although its companion had all frames.
    may_get_payload_twice: bool,
    /// Time limit for the next fragment of a message.
    fragment_timeout: Span,
    budget: Arc<MemoryBudget>,
    pairing: Pairing,
    /// Fragments of a message whose last companion has not arrived.
    fragments: Option<FrameFragments>,
    /// Stamp of the last companion with all frames of its message.
    last_whole_stamp: i64,
    /// Messages about the session itself that wait for earlier payloads which they overtook.
    overtaking_messages: Vec<(MessageInfo, Reservation)>,
}

impl MessageAssembly {
    pub(super) fn new(limits: &ConnectionLimits, budget: Arc<MemoryBudget>) -> Self {
        Self {
            max_message_bytes: limits.max_message_bytes,
            // Until this end has confirmed that payloads arrive, the other end sends each payload twice.
            may_get_payload_twice: limits.confirms_payloads,
            fragment_timeout: limits.pairing_timeout,
            budget,
            pairing: Pairing::new(limits.max_incomplete, limits.pairing_timeout),
            fragments: None,
            last_whole_stamp: i64::MIN,
            overtaking_messages: Vec::new(),
        }
    }

    /// Changes the budget for messages that arrive from now on.
    pub(super) fn set_budget(&mut self, budget: Arc<MemoryBudget>) {
        self.budget = budget;
    }

    /// Handles a fragment of a message.
    pub(super) fn receive_fragment(&mut self, fragment: &MessageInfo, now: MonoTime) {
        let earlier_fragments = self.fragments.take();
        self.fragments = Some(FrameFragments::with_fragment(
            earlier_fragments,
            (fragment, now),
            &self.budget,
            self.max_message_bytes,
        ));
    }

    /// Handles the companion of a message.
    pub(super) fn receive_data(
        &mut self,
        mut companion: MessageInfo,
        now: MonoTime,
        events: &mut EventQueue,
    ) {
        // Fragments of another message are dropped: companions arrive in order, so the last companion of that message
        // does not arrive any more. The memory of the whole message is reserved below.
        let mut has_lost_fragments = false;
        if let Some(fragments) = self.fragments.take().filter(|fragments| fragments.belong_to(&companion)) {
            match fragments.join(&companion.frames) {
                Some(frames) => companion.frames = frames,
                None => has_lost_fragments = true,
            }
        }
        // A loss counts the companion and the payload as two fragments, of which the companion has arrived.
        let loss = MessageLoss { tag: request_number(&companion), received: 1, total: 2 };
        match frames::check_lengths(&companion, self.max_message_bytes) {
            Ok(()) => {}
            // Memory was short for the fragments, which is no fault of the peer.
            Err(FramesError::Lengths) if has_lost_fragments => {
                events.push_incomplete(vec![loss]);
                return;
            }
            Err(problem) => {
                events.push(Event::InvalidData(problem.to_string()));
                return;
            }
        }
        // The peer chooses the length of the reason, which a companion with frames does not need.
        let length = companion.frames.len() + companion.reason.len();
        let Some(mut reserved) = self.reserve(length) else {
            events.push_incomplete(vec![loss]);
            return;
        };
        let stamp = companion.header.stamp.as_nanos();
        if companion.has_payload {
            self.receive_half(stamp, MessageHalf::Info(Box::new(companion)), reserved, now, events);
            return;
        }
        // Until the other end knows that payloads arrive on the payload topic, it sends each payload there and in the
        // companion. The payload from the payload topic is dropped.
        self.last_whole_stamp = stamp.max(self.last_whole_stamp);
        self.pairing.drop_payload(stamp);
        let mut lost = Vec::new();
        self.pairing.note_message_without_payload(stamp, &mut lost);
        events.push_incomplete(lost);
        // A message about the session may end the session. Answers whose payloads arrive later would then be lost.
        if companion.request == MessageInfo::NO_REQUEST && self.pairing.awaits_any_payload() {
            // A message may have no bytes in its frames, so `length` alone does not bound the number of messages that
            // wait.
            let waiting_length = (length + WAITING_OVERHEAD_BYTES) as u64;
            match reserved.resize(&self.budget, waiting_length) {
                Ok(()) => self.overtaking_messages.push((companion, reserved)),
                Err(_) => events.push_incomplete(vec![loss]),
            }
        } else {
            deliver(&companion, None, vec![reserved], events);
        }
    }

    /// Handles the payload of a message.
    pub(super) fn receive_payload(
        &mut self,
        stamp: i64,
        payload: Bytes,
        now: MonoTime,
        events: &mut EventQueue,
    ) {
        // The companion of this payload has brought all frames, or the message is lost: companions arrive in order.
        if self.may_get_payload_twice && stamp <= self.last_whole_stamp && !self.pairing.awaits_payload(stamp)
        {
            return;
        }
        let length = payload.len() as u64;
        if length > self.max_message_bytes {
            events.push(Event::InvalidData(format!(
                "a payload has {length} bytes, more than max_message_bytes, {}",
                self.max_message_bytes
            )));
            return;
        }
        // If memory is short, the payload is dropped without a report. Its companion is reported as lost later, with
        // the number of the request.
        let Some(reserved) = self.reserve(payload.len()) else { return };
        self.receive_half(stamp, MessageHalf::Payload(payload), reserved, now, events);
    }

    fn receive_half(
        &mut self,
        stamp: i64,
        half: MessageHalf,
        reserved: Reservation,
        now: MonoTime,
        events: &mut EventQueue,
    ) {
        let mut lost = Vec::new();
        let pair = self.pairing.add(stamp, half, reserved, now, &mut lost);
        events.push_incomplete(lost);
        if let Some(pair) = pair {
            deliver(&pair.info, Some(&pair.payload), pair.reserved.into(), events);
        }
    }

    /// Gives up messages whose time limit has passed.
    pub(super) fn expire(&mut self, now: MonoTime, events: &mut EventQueue) {
        let mut lost = Vec::new();
        self.pairing.expire(now, &mut lost);
        // The last companion of expired fragments was lost. The gap in the numbers of companions counts this loss
        // already.
        let timeout = self.fragment_timeout;
        self.fragments = self.fragments.take().filter(|fragments| !fragments.is_overdue(now, timeout));
        events.push_incomplete(lost);
    }

    /// Delivers the messages that overtook payloads, unless a companion still waits for its payload. Returns `true` if
    /// no companion waits.
    pub(super) fn deliver_overtaking_messages(&mut self, events: &mut EventQueue) -> bool {
        if self.pairing.awaits_any_payload() {
            return false;
        }
        for (companion, reserved) in std::mem::take(&mut self.overtaking_messages) {
            deliver(&companion, None, vec![reserved], events);
        }
        true
    }

    /// Returns the time at which the next companion or payload has waited too long for its partner.
    pub(super) fn next_timer(&self) -> Option<MonoTime> {
        // Fragments have no timer, because the timers of the heartbeats cause calls of `expire` often enough.
        self.pairing.next_timer()
    }

    fn reserve(&self, bytes: usize) -> Option<Reservation> {
        let mut reserved = Reservation::empty(&self.budget);
        reserved.resize(&self.budget, bytes as u64).ok().map(|()| reserved)
    }
}

fn deliver(
    companion: &MessageInfo,
    payload: Option<&Bytes>,
    reserved: Vec<Reservation>,
    events: &mut EventQueue,
) {
    events.push(match frames::unpack(companion, payload) {
        Ok(frames) => Event::Message(frames, reserved),
        Err(problem) => Event::InvalidData(problem.to_string()),
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assembly(budget: &Arc<MemoryBudget>) -> MessageAssembly {
        let limits = ConnectionLimits {
            max_message_bytes: 100,
            confirms_payloads: false,
            max_incomplete: 4,
            pairing_timeout: Span::from_seconds(30),
            heartbeat_interval: Span::from_seconds(1),
            heartbeat_timeout: Span::from_seconds(5),
        };
        MessageAssembly::new(&limits, Arc::clone(budget))
    }

    fn companion(request: u64) -> MessageInfo {
        let mut info = MessageInfo { request, ..MessageInfo::default() };
        let has_payload = false;
        assert!(frames::pack(&mut info, &[Bytes::from_static(b"header")], has_payload));
        info
    }

    #[test]
    fn message_beyond_budget_is_lost_and_reserves_no_memory() {
        let (budget, mut events) = (MemoryBudget::new(10), EventQueue::default());
        let mut assembly = assembly(&budget);
        assembly.receive_data(companion(1), MonoTime::default(), &mut events);
        assembly.receive_data(companion(2), MonoTime::default(), &mut events);
        let first = events.pop();
        assert!(matches!(&first, Some(Event::Message(..))), "{first:?}");
        assert!(matches!(events.pop(), Some(Event::IncomingLost(MessageLoss { tag: Some(2), .. }))));
        drop(first);
        assert_eq!(budget.reserved_bytes(), 0);
    }

    #[test]
    fn messages_that_overtake_payload_need_bounded_memory() {
        let (budget, mut events) =
            (MemoryBudget::new(10 * WAITING_OVERHEAD_BYTES as u64), EventQueue::default());
        let mut assembly = assembly(&budget);
        let mut awaiting = MessageInfo::default();
        let has_payload = true;
        assert!(frames::pack(&mut awaiting, &[Bytes::new(), Bytes::new(), Bytes::new()], has_payload));
        assembly.receive_data(awaiting, MonoTime::default(), &mut events);
        for _ in 0..100 {
            let without_frames = MessageInfo { request: MessageInfo::NO_REQUEST, ..MessageInfo::default() };
            assembly.receive_data(without_frames, MonoTime::default(), &mut events);
        }
        let lost = std::iter::from_fn(|| events.pop())
            .filter(|event| matches!(event, Event::IncomingLost(MessageLoss { tag: None, .. })));
        assert_eq!(lost.count(), 90);
        assembly.expire(MonoTime::default() + Span::from_seconds(30), &mut events);
        assert!(assembly.deliver_overtaking_messages(&mut events));
        let delivered =
            std::iter::from_fn(|| events.pop()).filter(|event| matches!(event, Event::Message(..)));
        assert_eq!(delivered.count(), 10);
        assert_eq!(budget.reserved_bytes(), 0);
    }

    #[test]
    fn new_budget_applies_to_later_messages() {
        let (small, mut events) = (MemoryBudget::new(1), EventQueue::default());
        let mut assembly = assembly(&small);
        assembly.receive_payload(1, Bytes::from_static(b"xx"), MonoTime::default(), &mut events);
        assert!(assembly.next_timer().is_none());
        let large = MemoryBudget::new(10);
        assembly.set_budget(Arc::clone(&large));
        assembly.receive_payload(2, Bytes::from_static(b"xx"), MonoTime::default(), &mut events);
        assert_eq!((small.reserved_bytes(), large.reserved_bytes()), (0, 2));
        assert!(assembly.next_timer().is_some() && events.pop().is_none());
    }
}
