//! Plausibility check of datagram numbers beyond a gap. Such a number may have been altered or forged on the way.

use peernet_clock::MonoTime;

/// Largest gap that one packet may open without confirmation by the next packet. Networks reorder fewer packets than
/// this.
pub(in crate::transport::datagram) const MAX_GAP: u64 = 64;

/// Maximum number of datagrams that a peer can send in a millisecond: more than 16 Gbit/s in datagrams of 512 bytes.
const MAX_DATAGRAMS_PER_MILLISECOND: u64 = 4_000;

/// Decides whether a number beyond a gap is plausible.
///
/// A long gap is plausible if the next packet has a number beyond the gap as well, close to the first number (RFC 3550,
/// appendix A.1), and if the other end can have sent that many datagrams since the last plausible number.
#[derive(Debug)]
pub(super) struct GapCheck {
    /// Last number that was not plausible. The next packet may confirm it.
    suspect: Option<NewNumber>,
    /// Time of the last plausible number.
    accepted_at: MonoTime,
}

/// Number of a datagram that is newer than all datagrams known to have been sent: the expected number, or a larger one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NewNumber {
    pub(super) number: u64,
    /// `true` if a datagram with this number arrived, `false` if the other end only reported it.
    pub(super) has_arrived: bool,
}

impl GapCheck {
    pub(super) const fn new(now: MonoTime) -> Self {
        Self { suspect: None, accepted_at: now }
    }

    /// Checks a number. `expected` is the lowest number that is not known to have been sent. Returns `None` if the number
    /// is not plausible yet. Otherwise returns `Some` with the earlier number that this number confirms, or with `None`
    /// if it confirms none.
    pub(super) fn check(
        &mut self,
        expected: u64,
        candidate: NewNumber,
        now: MonoTime,
    ) -> Option<Option<NewNumber>> {
        let gap = candidate.number - expected;
        if gap <= MAX_GAP {
            (self.suspect, self.accepted_at) = (None, now);
            return Some(None);
        }
        let elapsed = u64::try_from((now - self.accepted_at).nanos() / 1_000_000).unwrap_or(0);
        // One millisecond is added, because the time was rounded down.
        let is_possible = gap <= (elapsed + 1).saturating_mul(MAX_DATAGRAMS_PER_MILLISECOND);
        let confirmed = self.suspect.filter(|suspect| is_possible && candidate.confirms(suspect));
        if confirmed.is_none() {
            self.suspect = Some(candidate);
            return None;
        }
        (self.suspect, self.accepted_at) = (None, now);
        Some(confirmed)
    }
}

impl NewNumber {
    /// Returns whether this number confirms an earlier one that was not plausible.
    fn confirms(&self, suspect: &Self) -> bool {
        let distance = suspect.number.abs_diff(self.number);
        // A datagram that the network duplicated does not confirm itself. Two reports of one number come from two
        // packets, because duplicated heartbeats are dropped before this check.
        let is_other_packet = distance > 0 || !self.has_arrived || !suspect.has_arrived;
        distance <= MAX_GAP && is_other_packet
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::Span;

    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    fn datagram(number: u64) -> NewNumber {
        NewNumber { number, has_arrived: true }
    }

    #[test]
    fn long_gap_waits_for_another_packet_beyond_it() {
        let mut check = GapCheck::new(at(0));
        assert_eq!(check.check(5, datagram(5 + MAX_GAP), at(0)), Some(None));
        assert_eq!(check.check(5, datagram(1_000), at(1)), None);
        assert_eq!(
            check.check(5, datagram(1_000), at(1)),
            None,
            "a duplicated datagram does not confirm itself"
        );
        assert_eq!(check.check(5, datagram(1_003), at(1)), Some(Some(datagram(1_000))));
        assert_eq!(check.check(5, datagram(1_000), at(2)), None);
        assert_eq!(check.check(5, datagram(6), at(2)), Some(None));
        assert_eq!(
            check.check(7, datagram(1_001), at(2)),
            None,
            "the arrival of number 6 discarded the suspect 1,000"
        );
        let reported = NewNumber { number: 1_001, has_arrived: false };
        assert_eq!(check.check(7, reported, at(2)), Some(Some(datagram(1_001))));
    }

    #[test]
    fn gap_longer_than_peer_can_have_sent_is_never_believed() {
        let mut check = GapCheck::new(at(0));
        for number in 0..10 {
            assert_eq!(check.check(0, datagram(1_000_000 + number), at(100)), None);
        }
        assert_eq!(check.check(0, datagram(1_000_010), at(300)), Some(Some(datagram(1_000_009))));
    }
}
