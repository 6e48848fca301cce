//! Progress of a peer, derived from packets that may have been altered or forged on the way.

use peernet_clock::MonoTime;

/// The number below which the peer has sent all messages.
///
/// The watermark is the highest number that two successive packets have claimed or exceeded, so that a single altered
/// packet does not move the watermark. RTP also requires a second packet after a jump (RFC 3550, appendix A.1).
#[derive(Debug, Default)]
pub(super) struct SentWatermark {
    confirmed_number: u64,
    last_claim: Claim,
}

/// Claim of one packet.
#[derive(Clone, Copy, Debug, Default)]
struct Claim {
    next: u64,
    /// Identifies the packet: a packet that the network duplicated does not confirm itself.
    packet: u64,
    claimed_at: MonoTime,
}

impl SentWatermark {
    /// Handles a packet that says that all messages below `next` were sent. `packet` identifies the packet, so that a
    /// duplicate does not count as a second packet. If the watermark moves, returns the new watermark and the time of
    /// the first claim.
    pub(super) fn claim(&mut self, next: u64, packet: u64, now: MonoTime) -> Option<(u64, MonoTime)> {
        if (next, packet) == (self.last_claim.next, self.last_claim.packet) {
            return None;
        }
        let previous = std::mem::replace(&mut self.last_claim, Claim { next, packet, claimed_at: now });
        let confirmed = next.min(previous.next);
        if confirmed <= self.confirmed_number {
            return None;
        }
        self.confirmed_number = confirmed;
        // The time of the first claim is returned, so that waiting for the second packet does not delay the detection
        // of a loss.
        Some((confirmed, previous.claimed_at))
    }

    /// Returns the claim of the last packet.
    pub(super) const fn last_claimed_number(&self) -> u64 {
        self.last_claim.next
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::Span;
    use proptest::prelude::*;

    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    #[test]
    fn confirmed_claim_has_time_of_first_packet() {
        let mut sent = SentWatermark::default();
        assert_eq!(sent.claim(5, 1, at(10)), None);
        assert_eq!(sent.claim(7, 2, at(20)), Some((5, at(10))));
        assert_eq!(sent.claim(7, 2, at(25)), None, "a duplicated packet");
        assert_eq!(sent.claim(7, 3, at(30)), Some((7, at(20))));
        assert_eq!(sent.claim(6, 4, at(40)), None, "a late packet");
        assert_eq!(sent.last_claimed_number(), 6);
    }

    #[test]
    fn gap_of_any_length_is_believed_when_confirmed() {
        let mut sent = SentWatermark::default();
        assert_eq!(sent.claim(1_000_000, 1, at(10)), None);
        assert_eq!(sent.claim(1_000_001, 2, at(20)), Some((1_000_000, at(10))));
    }

    proptest! {
        #[test]
        fn single_false_claim_does_not_raise_watermark(count in 2_u64..60, false_claim_at: prop::sample::Index, claimed: u64) {
            let mut sent = SentWatermark::default();
            let false_claim_at = false_claim_at.index(count as usize) as u64;
            for number in 0..count {
                if number == false_claim_at
                    && let Some((next, _)) = sent.claim(claimed, u64::MAX, at(number as i64))
                {
                    prop_assert!(next <= number);
                }
                if let Some((next, _)) = sent.claim(number, number, at(number as i64)) {
                    prop_assert!(next <= number);
                }
            }
        }
    }
}
