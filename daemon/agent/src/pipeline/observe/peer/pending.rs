//! Pairs of messages of which the peer is still to be asked. No I/O.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};
use peernet_logger::HostId;

use crate::observed::ObservedPair;

/// Time from a question to the next one about the same messages: the peer may receive them later than this host.
const ASK_AGAIN: Span = Span::from_millis(100);

/// Pairs of messages until the peer has told of them, or for as long as that is waited for.
#[derive(Debug)]
pub(super) struct PendingPairs<P> {
    /// How long an answer is waited for.
    timeout: Span,
    /// The oldest first.
    pairs: VecDeque<Pending<P>>,
}

/// What a peer told of a pair. The session in which it did may be over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PeerAnswer {
    pub(super) peer: HostId,
    pub(super) seen: ObservedPair,
}

#[derive(Debug)]
struct Pending<P> {
    key: i64,
    ask_at: MonoTime,
    give_up_at: MonoTime,
    /// The newest answer.
    answer: Option<PeerAnswer>,
    pair: P,
}

impl<P> PendingPairs<P> {
    pub(super) const fn new(timeout: Span) -> Self {
        Self { timeout, pairs: VecDeque::new() }
    }

    /// Takes in a pair that was completed at `now`.
    pub(super) fn add(&mut self, key: i64, pair: P, now: MonoTime) {
        let give_up_at = now + self.timeout;
        self.pairs.push_back(Pending { key, ask_at: now, give_up_at, answer: None, pair });
    }

    /// Returns the keys to ask for at `now`, `most` of them; they are not due again for a while.
    pub(super) fn take_due(&mut self, now: MonoTime, most: usize) -> Vec<i64> {
        let due = self.pairs.iter_mut().filter(|pending| pending.ask_at <= now).take(most);
        due.map(|pending| {
            pending.ask_at = now + ASK_AGAIN;
            pending.key
        })
        .collect()
    }

    /// Returns when the next pair is to be asked for.
    pub(super) fn next_due(&self) -> Option<MonoTime> {
        self.pairs.iter().map(|pending| pending.ask_at).min()
    }

    /// Takes in an answer. Returns the pairs of which both messages are known now.
    pub(super) fn take_answer(&mut self, answer: &PeerAnswer) -> Vec<P> {
        let is_known = |pending: &Pending<P>| pending.key == answer.seen.key;
        if !answer.seen.is_complete() {
            self.pairs
                .iter_mut()
                .filter(|pending| is_known(pending))
                .for_each(|pending| pending.answer = Some(*answer));
            return Vec::new();
        }
        let mut settled = Vec::new();
        while let Some(index) = self.pairs.iter().position(is_known) {
            settled.extend(self.pairs.remove(index).map(|pending| pending.pair));
        }
        settled
    }

    /// Gives up the next pair that has waited for too long by `now`, with what the peer knew of it; to be called until there is
    /// none.
    pub(super) fn expire(&mut self, now: MonoTime) -> Option<(P, Option<PeerAnswer>)> {
        let oldest = self.pairs.pop_front_if(|oldest| oldest.give_up_at <= now)?;
        Some((oldest.pair, oldest.answer))
    }

    /// Returns when the next pair is given up.
    pub(super) fn next_expiry(&self) -> Option<MonoTime> {
        self.pairs.front().map(|oldest| oldest.give_up_at)
    }

    /// Gives up the oldest pair, whatever its time.
    pub(super) fn give_up(&mut self) -> Option<(P, Option<PeerAnswer>)> {
        self.pairs.pop_front().map(|oldest| (oldest.pair, oldest.answer))
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{RawTime, WallTime};

    use super::*;
    use crate::link::HostStamp;

    fn at(millis: i64) -> MonoTime {
        MonoTime::from_nanos(millis * 1_000_000)
    }

    fn answer(key: i64, has_output: bool) -> PeerAnswer {
        let stamp =
            HostStamp { wall: WallTime::from_unix_nanos(5), raw: RawTime::from_nanos(5), epoch: Some(0) };
        let output = has_output.then_some(stamp);
        let seen = ObservedPair::new(key, Some(stamp), output, has_output.then_some(Span::ZERO));
        PeerAnswer { peer: HostId::from_bytes([1; 16]), seen }
    }

    #[test]
    fn pair_is_asked_for_again_until_both_messages_are_known() {
        let mut pending = PendingPairs::new(Span::from_seconds(5));
        pending.add(7, "seven", at(0));
        pending.add(8, "eight", at(10));
        assert_eq!(pending.take_due(at(10), 1), [7], "no more than wanted");
        assert_eq!(pending.take_due(at(10), 9), [8]);
        assert!(pending.take_due(at(50), 9).is_empty(), "just asked");
        assert!(pending.take_answer(&answer(7, false)).is_empty());
        assert_eq!(pending.next_due(), Some(at(110)));
        assert_eq!(pending.take_due(at(110), 9), [7, 8]);
        assert_eq!(pending.take_answer(&answer(7, true)), ["seven"]);
        assert!(pending.take_answer(&answer(7, true)).is_empty(), "an answer settles once");
    }

    #[test]
    fn given_up_pair_comes_with_what_the_peer_knew() {
        let mut pending = PendingPairs::new(Span::from_millis(500));
        pending.add(7, "seven", at(0));
        pending.add(8, "eight", at(100));
        assert!(pending.take_answer(&answer(7, false)).is_empty());
        assert_eq!(pending.next_expiry(), Some(at(500)));
        assert_eq!(pending.expire(at(499)), None);
        assert_eq!(pending.expire(at(500)), Some(("seven", Some(answer(7, false)))));
        assert_eq!(pending.expire(at(500)), None);
        assert_eq!(pending.give_up(), Some(("eight", None)));
        assert_eq!(pending.next_expiry(), None);
    }
}
