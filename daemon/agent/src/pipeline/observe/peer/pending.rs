//! Pairs of messages that wait for the peer's stamps. No I/O.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};
use peernet_logger::HostId;

use crate::observed::ObservedPair;

/// Time after which the peer is queried again for a message that the peer had not received. The peer may receive
/// messages later than this host.
const RETRY_INTERVAL: Span = Span::from_millis(100);

/// Pairs of messages that wait for the peer's stamps.
#[derive(Debug)]
pub(super) struct PendingPairs<P> {
    /// Longest wait for the stamps of a pair.
    timeout: Span,
    /// Waiting pairs, oldest first.
    pairs: VecDeque<PendingPair<P>>,
}

/// The stamps of a pair that a peer sent, and the id of that peer. Another peer may be connected when the pair is
/// recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PeerAnswer {
    pub(super) peer: HostId,
    pub(super) stamps: ObservedPair,
}

#[derive(Debug)]
struct PendingPair<P> {
    key: i64,
    /// Time of the next query.
    query_at: MonoTime,
    expires_at: MonoTime,
    /// Latest answer, in which a message is still missing.
    answer: Option<PeerAnswer>,
    pair: P,
}

impl<P> PendingPairs<P> {
    pub(super) const fn new(timeout: Span) -> Self {
        Self { timeout, pairs: VecDeque::new() }
    }

    /// Adds a pair that was completed at `now`.
    pub(super) fn add(&mut self, key: i64, pair: P, now: MonoTime) {
        let expires_at = now + self.timeout;
        self.pairs.push_back(PendingPair { key, query_at: now, expires_at, answer: None, pair });
    }

    /// Returns up to `max_keys` keys that are due to be queried at `now`. These keys are due again after
    /// [`RETRY_INTERVAL`].
    pub(super) fn take_due(&mut self, now: MonoTime, max_keys: usize) -> Vec<i64> {
        let due_pairs = self.pairs.iter_mut().filter(|pending| pending.query_at <= now).take(max_keys);
        due_pairs
            .map(|pending| {
                pending.query_at = now + RETRY_INTERVAL;
                pending.key
            })
            .collect()
    }

    /// Returns the time at which the next query is due; `None` if no pair waits.
    pub(super) fn next_due(&self) -> Option<MonoTime> {
        self.pairs.iter().map(|pending| pending.query_at).min()
    }

    /// Handles an answer of the peer. If the answer has both messages, removes and returns the pairs with the same key.
    pub(super) fn take_answer(&mut self, answer: &PeerAnswer) -> Vec<P> {
        let has_key = |pending: &PendingPair<P>| pending.key == answer.stamps.key;
        if !answer.stamps.is_complete() {
            self.pairs
                .iter_mut()
                .filter(|pending| has_key(pending))
                .for_each(|pending| pending.answer = Some(*answer));
            return Vec::new();
        }
        let mut settled_pairs = Vec::new();
        // Several pairs may have the same key.
        while let Some(index) = self.pairs.iter().position(has_key) {
            settled_pairs.extend(self.pairs.remove(index).map(|pending| pending.pair));
        }
        settled_pairs
    }

    /// Removes a pair whose timeout has passed by `now`, and returns it with the latest answer about it. The caller
    /// calls this method until it returns `None`.
    pub(super) fn expire(&mut self, now: MonoTime) -> Option<(P, Option<PeerAnswer>)> {
        // All pairs have the same timeout, so they expire in the order in which they were added.
        let oldest = self.pairs.pop_front_if(|oldest| oldest.expires_at <= now)?;
        Some((oldest.pair, oldest.answer))
    }

    /// Returns the time at which the next pair expires; `None` if no pair waits.
    pub(super) fn next_expiry(&self) -> Option<MonoTime> {
        self.pairs.front().map(|oldest| oldest.expires_at)
    }

    /// Removes the oldest pair, whether it has expired or not.
    pub(super) fn abandon(&mut self) -> Option<(P, Option<PeerAnswer>)> {
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

    const STAMP: HostStamp =
        HostStamp { wall: WallTime::from_unix_nanos(5), raw: RawTime::from_nanos(5), epoch: Some(0) };

    fn complete_answer(key: i64) -> PeerAnswer {
        let stamps = ObservedPair::new(key, Some(STAMP), Some(STAMP), Some(Span::ZERO));
        PeerAnswer { peer: HostId::from_bytes([1; 16]), stamps }
    }

    fn answer_without_output(key: i64) -> PeerAnswer {
        let stamps = ObservedPair::new(key, Some(STAMP), None, None);
        PeerAnswer { peer: HostId::from_bytes([1; 16]), stamps }
    }

    #[test]
    fn pair_is_queried_again_until_peer_has_both_messages() {
        let mut pending = PendingPairs::new(Span::from_seconds(5));
        pending.add(7, "seven", at(0));
        pending.add(8, "eight", at(10));
        assert_eq!(pending.take_due(at(10), 1), [7], "at most one key");
        assert_eq!(pending.take_due(at(10), 9), [8]);
        assert!(pending.take_due(at(50), 9).is_empty(), "queried 40 ms ago");
        assert!(pending.take_answer(&answer_without_output(7)).is_empty());
        assert_eq!(pending.next_due(), Some(at(110)));
        assert_eq!(pending.take_due(at(110), 9), [7, 8]);
        assert_eq!(pending.take_answer(&complete_answer(7)), ["seven"]);
        assert!(pending.take_answer(&complete_answer(7)).is_empty(), "the pair was already removed");
    }

    #[test]
    fn expired_pair_has_stamps_that_peer_sent() {
        let mut pending = PendingPairs::new(Span::from_millis(500));
        pending.add(7, "seven", at(0));
        pending.add(8, "eight", at(100));
        assert!(pending.take_answer(&answer_without_output(7)).is_empty());
        assert_eq!(pending.next_expiry(), Some(at(500)));
        assert_eq!(pending.expire(at(499)), None);
        assert_eq!(pending.expire(at(500)), Some(("seven", Some(answer_without_output(7)))));
        assert_eq!(pending.expire(at(500)), None);
        assert_eq!(pending.abandon(), Some(("eight", None)));
        assert_eq!(pending.next_expiry(), None);
    }
}
