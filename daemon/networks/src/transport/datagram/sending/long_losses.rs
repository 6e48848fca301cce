//! Detection of a path that no longer carries long datagrams while short ones arrive.

use peernet_clock::{MonoTime, Span};

/// Number of successive messages that must lose all their long datagrams before the path counts as broken for long
/// datagrams.
// With 30 % random loss and messages of two datagrams, this happens by chance in about one of 47,000 sequences of 16
// messages. Such a message counts if either datagram is lost, because the one that arrived may be the short one.
const MIN_MESSAGES: u32 = 16;
/// The first of these messages must have been lost at least this long ago.
const MIN_DURATION: Span = Span::from_seconds(1);

/// Observes messages of several datagrams. All datagrams of a message except the last have the largest length.
#[derive(Debug, Default)]
pub(super) struct LongLossDetector {
    losses: Option<LongLosses>,
}

/// Successive lost messages. Each had several datagrams, and at most one of its datagrams arrived.
#[derive(Clone, Copy, Debug)]
struct LongLosses {
    /// Number of these messages.
    messages: u32,
    /// Number of datagrams that the other end had reported as lost when the first of these messages was lost.
    lost_before: u64,
    /// Time at which the first of these losses was reported.
    since: MonoTime,
}

impl LongLossDetector {
    /// Notes that a message of `fragments` fragments arrived.
    pub(super) fn record_arrival(&mut self, fragments: u32) {
        if fragments > 1 {
            self.losses = None;
        }
    }

    /// Notes that a message was lost. `received` of its `fragments` fragments arrived. `lost_datagrams` is the number
    /// of datagrams that the other end has reported as lost.
    pub(super) fn record_loss(&mut self, fragments: u32, received: u32, lost_datagrams: u64, now: MonoTime) {
        // A single fragment that arrived may be the last fragment, which is shorter than the others.
        if received > 1 {
            self.losses = None;
        } else if fragments > 1 {
            let losses = self.losses.get_or_insert(LongLosses {
                messages: 0,
                lost_before: lost_datagrams,
                since: now,
            });
            losses.messages += 1;
        }
    }

    /// Returns whether the longest datagrams no longer arrive. `lost_datagrams` is the number of lost datagrams that
    /// the other end has reported. This number is needed because the other end may also give up messages for other
    /// reasons.
    pub(super) fn loses_all(&self, lost_datagrams: u64, now: MonoTime) -> bool {
        self.losses.is_some_and(|losses| {
            losses.messages >= MIN_MESSAGES
                && lost_datagrams.saturating_sub(losses.lost_before) >= u64::from(MIN_MESSAGES)
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
            detector.record_loss(5, u32::from(n % 2 == 0), 0, at(n));
        }
        detector
    }

    #[test]
    fn enough_losses_over_enough_time_are_detected() {
        assert!(after_losses(16).loses_all(16, at(1_000)));
        assert!(!after_losses(16).loses_all(16, at(999)), "the first loss is less than a second ago");
        assert!(
            !after_losses(16).loses_all(15, at(1_000)),
            "too few lost datagrams: the other end gave up messages for another reason"
        );
        assert!(!after_losses(15).loses_all(16, at(1_000)), "too few messages");
    }

    #[test]
    fn arrived_long_datagram_resets_losses() {
        let mut detector = after_losses(16);
        detector.record_arrival(1);
        detector.record_loss(1, 0, 0, at(500));
        assert!(detector.loses_all(16, at(1_000)), "messages of one datagram do not reset the losses");
        detector.record_arrival(2);
        assert!(!detector.loses_all(16, at(1_000)));
        let mut detector = after_losses(16);
        detector.record_loss(5, 2, 0, at(500));
        assert!(!detector.loses_all(16, at(1_000)));
    }
}
