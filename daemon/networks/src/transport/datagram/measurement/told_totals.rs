//! What the other end tells of this end's datagrams.

use crate::transport::datagram::counting::ArrivalTotals;
use crate::transport::datagram::false_claim::FalseClaim;

/// Copies of each datagram that a network may make, on the average.
const MAX_COPIES: u64 = 16;

/// The totals of this end's datagrams by the account of the other end.
///
/// No total falls, and none is above what two packets in succession say: one that was altered or forged does not stay.
#[derive(Debug, Default)]
pub(super) struct ToldTotals {
    last: Option<ArrivalTotals>,
    confirmed: Option<ArrivalTotals>,
}

impl ToldTotals {
    /// The other end tells totals; `sent` is how many datagrams left here.
    ///
    /// # Errors
    /// When they are more than `sent` can have led to.
    pub(super) fn tell(&mut self, totals: ArrivalTotals, sent: u64) -> Result<(), FalseClaim> {
        let ArrivalTotals { lost, duplicated, reordered } = totals;
        if lost.max(reordered) > sent || duplicated > sent.saturating_mul(MAX_COPIES) {
            return Err(FalseClaim::Totals);
        }
        if let Some(last) = self.last.replace(totals) {
            self.confirmed = Some(self.confirmed.unwrap_or_default().max(last.min(totals)));
        }
        Ok(())
    }

    /// The totals; `None` until the other end has told them twice.
    pub(super) const fn totals(&self) -> Option<ArrivalTotals> {
        self.confirmed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn totals(lost: u64, duplicated: u64, reordered: u64) -> ArrivalTotals {
        ArrivalTotals { lost, duplicated, reordered }
    }

    #[test]
    fn totals_follow_what_is_told_twice() {
        let mut told = ToldTotals::default();
        assert_eq!(told.tell(totals(1, 2, 3), 10), Ok(()));
        assert_eq!(told.totals(), None);
        assert_eq!(told.tell(totals(2, 2, 4), 10), Ok(()));
        assert_eq!(told.totals(), Some(totals(1, 2, 3)));
        assert_eq!(told.tell(totals(9, 9, 9), 10), Ok(()));
        assert_eq!(told.totals(), Some(totals(2, 2, 4)), "one packet alone is not believed");
        assert_eq!(told.tell(totals(2, 3, 4), 10), Ok(()));
        assert_eq!(told.totals(), Some(totals(2, 3, 4)));
        assert_eq!(told.tell(totals(1, 1, 1), 10), Ok(()));
        assert_eq!(told.totals(), Some(totals(2, 3, 4)), "no total falls");
    }

    #[test]
    fn totals_above_what_was_sent_are_refused() {
        let mut told = ToldTotals::default();
        for absurd in [totals(11, 0, 0), totals(0, 161, 0), totals(0, 0, 11), totals(u64::MAX, 0, 0)] {
            assert_eq!(told.tell(absurd, 10), Err(FalseClaim::Totals));
        }
        assert_eq!(told.totals(), None);
    }
}
