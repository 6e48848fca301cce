//! Noticing that long datagrams do not pass any more while short ones do.

use peernet_clock::{MonoTime, Span};

/// Messages in a row, and their least duration, that have to lose all long datagrams before these count as not passing. Chance
/// alone does so once in 40,000 times where 30 % are lost and messages have two datagrams.
const MIN_MESSAGES: u32 = 16;
const MIN_DURATION: Span = Span::from_seconds(1);

/// Watches the messages of several datagrams, all but the last of which are as long as they may be.
#[derive(Debug, Default)]
pub(super) struct LongLossDetector {
    losses: Option<LongLosses>,
}

/// Messages of several datagrams in a row of which at most one arrived.
#[derive(Clone, Copy, Debug)]
struct LongLosses {
    messages: u32,
    /// Datagrams that the other end had reported as lost before.
    before: u64,
    /// When the first of them was reported.
    since: MonoTime,
}

impl LongLossDetector {
    /// Notes that a message of `fragments` fragments arrived as a whole.
    pub(super) fn arrive(&mut self, fragments: u32) {
        if fragments > 1 {
            self.losses = None;
        }
    }

    /// Notes that a message was lost of which `received` fragments arrived; the other end has reported `lost` datagrams as lost.
    pub(super) fn lose(&mut self, fragments: u32, received: u32, lost: u64, now: MonoTime) {
        // The one that arrived may be the last, which is shorter than the others.
        if received > 1 {
            self.losses = None;
        } else if fragments > 1 {
            let losses = self.losses.get_or_insert(LongLosses { messages: 0, before: lost, since: now });
            losses.messages += 1;
        }
    }

    /// Whether none of the longest datagrams arrives any more. `lost` is the number of lost datagrams that the other end
    /// has reported: it may give messages up for other reasons, too.
    pub(super) fn loses_all(&self, lost: u64, now: MonoTime) -> bool {
        self.losses.is_some_and(|losses| {
            losses.messages >= MIN_MESSAGES
                && lost.saturating_sub(losses.before) >= u64::from(MIN_MESSAGES)
                && now - losses.since >= MIN_DURATION
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    fn after_losses(count: i64) -> LongLossDetector {
        let mut detector = LongLossDetector::default();
        for n in 0..count {
            detector.lose(5, u32::from(n % 2 == 0), 0, at(n));
        }
        detector
    }

    #[test]
    fn enough_lost_messages_for_long_enough_are_noticed() {
        assert!(after_losses(16).loses_all(16, at(1_000)));
        assert!(!after_losses(16).loses_all(16, at(999)), "not for long enough");
        assert!(!after_losses(16).loses_all(15, at(1_000)), "given up for another reason");
        assert!(!after_losses(15).loses_all(16, at(1_000)), "too few messages");
    }

    #[test]
    fn long_datagram_that_arrives_ends_the_row() {
        let mut detector = after_losses(16);
        detector.arrive(1);
        detector.lose(1, 0, 0, at(500));
        assert!(detector.loses_all(16, at(1_000)), "messages of one datagram say nothing");
        detector.arrive(2);
        assert!(!detector.loses_all(16, at(1_000)));
        let mut detector = after_losses(16);
        detector.lose(5, 2, 0, at(500));
        assert!(!detector.loses_all(16, at(1_000)));
    }
}
