//! Joins each payload with its companion, which carries the header and the tree of the message. No I/O.
//!
//! Payloads and companions are on separate topics, each of which is in order. A payload waits for its companion, and a
//! companion for its payload. If a later message arrives on the other topic first, the awaited message is certainly
//! lost. If no later message arrives, a deadline ends the wait.

use std::collections::BTreeMap;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};
use peernet_ros::messages::MessageInfo;

use crate::transport::MessageLoss;
use crate::transport::memory::Reservation;

/// Halves of messages that wait for the other half, by stamp.
#[derive(Debug)]
pub(super) struct Pairing {
    pending: BTreeMap<i64, PendingHalf>,
    max_pending: usize,
    timeout: Span,
}

#[derive(Debug)]
struct PendingHalf {
    half: MessageHalf,
    deadline: MonoTime,
    reserved: Reservation,
}

/// One half of a message.
#[derive(Debug)]
pub(super) enum MessageHalf {
    Info(Box<MessageInfo>),
    Payload(Bytes),
}

/// A whole message.
#[derive(Debug)]
pub(super) struct Pair {
    pub(super) info: Box<MessageInfo>,
    pub(super) payload: Bytes,
    pub(super) reserved: [Reservation; 2],
}

impl MessageHalf {
    fn is_info(&self) -> bool {
        matches!(self, Self::Info(_))
    }

    /// Returns the loss of the message that this half belongs to.
    fn loss(&self) -> MessageLoss {
        let tag = match self {
            Self::Info(info) => request_number(info),
            Self::Payload(_) => None,
        };
        MessageLoss { tag, received: 1, total: 2 }
    }
}

/// Returns the number of the request that a message belongs to.
pub(super) fn request_number(info: &MessageInfo) -> Option<u64> {
    (info.request != MessageInfo::NO_REQUEST).then_some(info.request)
}

impl Pairing {
    pub(super) fn new(max_pending: usize, timeout: Span) -> Self {
        Self { pending: BTreeMap::new(), max_pending, timeout }
    }

    /// Adds a half that arrived. Returns the message if it is complete now.
    pub(super) fn add(
        &mut self,
        stamp: i64,
        half: MessageHalf,
        reserved: Reservation,
        now: MonoTime,
        lost: &mut Vec<MessageLoss>,
    ) -> Option<Pair> {
        self.give_up_unmatched(stamp, half.is_info(), lost);
        match self.pending.remove(&stamp) {
            Some(waiting) if waiting.half.is_info() != half.is_info() => {
                let reserved = [waiting.reserved, reserved];
                match (waiting.half, half) {
                    (MessageHalf::Info(info), MessageHalf::Payload(payload))
                    | (MessageHalf::Payload(payload), MessageHalf::Info(info)) => {
                        return Some(Pair { info, payload, reserved });
                    }
                    // This cannot occur: the guard requires halves of different kinds.
                    _ => return None,
                }
            }
            // Two halves of the same kind have the same stamp. Which half is right is unknown; the newer half replaces
            // the older half.
            Some(waiting) => lost.push(waiting.half.loss()),
            None => {}
        }
        self.pending.insert(stamp, PendingHalf { half, deadline: now + self.timeout, reserved });
        // If one of the topics has another publisher, many halves may wait for a partner that never arrives. The limit
        // bounds their memory.
        if self.pending.len() > self.max_pending
            && let Some((_, oldest)) = self.pending.pop_first()
        {
            lost.push(oldest.half.loss());
        }
        None
    }

    /// Notes that a message without a payload arrived on the companions' topic.
    pub(super) fn note_message_without_payload(&mut self, stamp: i64, lost: &mut Vec<MessageLoss>) {
        let is_info = true;
        self.give_up_unmatched(stamp, is_info, lost);
    }

    /// Gives up halves after a message with this stamp arrived on one topic: on the companions' topic if `is_info`,
    /// else on the payload topic. Gives up the earlier halves whose partner should have arrived on that topic before.
    fn give_up_unmatched(&mut self, stamp: i64, is_info: bool, lost: &mut Vec<MessageLoss>) {
        let is_unmatched = |pending_stamp: &i64, pending: &mut PendingHalf| {
            *pending_stamp < stamp && pending.half.is_info() != is_info
        };
        lost.extend(self.pending.extract_if(.., is_unmatched).map(|(_, pending)| pending.half.loss()));
    }

    /// Gives up the halves whose time limit has passed.
    pub(super) fn expire(&mut self, now: MonoTime, lost: &mut Vec<MessageLoss>) {
        let is_expired = |_: &i64, pending: &mut PendingHalf| pending.deadline <= now;
        lost.extend(self.pending.extract_if(.., is_expired).map(|(_, pending)| pending.half.loss()));
    }

    /// Returns whether the companion with this stamp waits for its payload.
    pub(super) fn awaits_payload(&self, stamp: i64) -> bool {
        self.pending.get(&stamp).is_some_and(|pending| pending.half.is_info())
    }

    /// Drops a payload that its companion does not need.
    pub(super) fn drop_payload(&mut self, stamp: i64) {
        if self.pending.get(&stamp).is_some_and(|pending| !pending.half.is_info()) {
            self.pending.remove(&stamp);
        }
    }

    /// Returns whether any companion waits for its payload.
    pub(super) fn awaits_any_payload(&self) -> bool {
        self.pending.values().any(|pending| pending.half.is_info())
    }

    /// Returns the time at which the next half's time limit passes.
    pub(super) fn next_timer(&self) -> Option<MonoTime> {
        self.pending.values().map(|pending| pending.deadline).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::memory::MemoryBudget;

    struct PairingTest {
        pairing: Pairing,
        budget: std::sync::Arc<MemoryBudget>,
        lost: Vec<MessageLoss>,
    }

    impl PairingTest {
        fn new() -> Self {
            let max_pending = 3;
            let pairing = Pairing::new(max_pending, Span::from_seconds(1));
            Self { pairing, budget: MemoryBudget::new(100), lost: Vec::new() }
        }

        fn add(&mut self, stamp: i64, half: MessageHalf) -> Option<Pair> {
            let mut reserved = Reservation::empty(&self.budget);
            reserved.resize(&self.budget, 10).expect("there is room");
            self.pairing.add(stamp, half, reserved, MonoTime::default(), &mut self.lost)
        }

        fn add_companion(&mut self, stamp: i64) -> Option<Pair> {
            let request = u64::try_from(stamp).expect("positive");
            self.add(stamp, MessageHalf::Info(Box::new(MessageInfo { request, ..MessageInfo::default() })))
        }

        fn add_payload(&mut self, stamp: i64) -> Option<Pair> {
            self.add(stamp, MessageHalf::Payload(Bytes::from_static(b"x")))
        }
    }

    fn loss(tag: Option<u64>) -> MessageLoss {
        MessageLoss { tag, received: 1, total: 2 }
    }

    #[test]
    fn halves_are_joined_in_either_order() {
        let mut test = PairingTest::new();
        assert!(test.add_payload(1).is_none() && test.add_companion(2).is_none());
        assert_eq!(
            test.lost,
            [loss(None)],
            "the companion with stamp 2 shows that the companion with stamp 1 is lost"
        );
        assert!(test.add_payload(2).is_some());
        assert!(test.add_payload(3).is_none());
        let pair = test.add_companion(3).expect("whole");
        assert_eq!((&pair.payload[..], pair.info.request), (&b"x"[..], 3));
        drop(pair);
        assert_eq!((test.budget.reserved_bytes(), test.lost.len()), (0, 1));
    }

    #[test]
    fn later_payload_ends_waiting_for_earlier_one() {
        let mut test = PairingTest::new();
        assert!(test.add_companion(1).is_none() && test.add_companion(2).is_none());
        assert!(test.add_payload(2).is_some());
        assert_eq!(test.lost, [loss(Some(1))]);
    }

    #[test]
    fn waiting_halves_are_bounded_in_number_and_time() {
        let mut test = PairingTest::new();
        for stamp in 1..=4 {
            assert!(test.add_companion(stamp).is_none());
        }
        assert_eq!(test.lost, [loss(Some(1))]);
        let end = test.pairing.next_timer().expect("three halves wait");
        test.pairing.expire(end, &mut test.lost);
        assert_eq!((test.lost.len(), test.budget.reserved_bytes()), (4, 0));
        assert_eq!(test.pairing.next_timer(), None);
    }
}
