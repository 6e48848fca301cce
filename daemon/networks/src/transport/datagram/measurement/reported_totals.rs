//! Totals of this end's datagrams that the other end reports.

use crate::transport::datagram::arrival_counter::{ArrivalTotals, MAX_GAP};
use crate::transport::datagram::false_claim::FalseClaim;

/// Largest plausible number of copies that a network makes of each datagram, on average.
const MAX_COPIES: u64 = 16;

/// Totals of this end's datagrams, as the other end reports them.
///
/// A total rises only to the lower of two successive reports, and it never decreases. A total that was altered or
/// forged in one packet is therefore not kept.
#[derive(Debug, Default)]
pub(super) struct ReportedTotals {
    last_report: Option<ArrivalTotals>,
    /// Totals that a second report has confirmed.
    confirmed: Option<ArrivalTotals>,
}

impl ReportedTotals {
    /// Handles a report. `sent` is the number of datagrams that this end has sent.
    ///
    /// # Errors
    /// If the totals are higher than `sent` allows.
    pub(super) fn receive(&mut self, totals: ArrivalTotals, sent: u64) -> Result<(), FalseClaim> {
        let ArrivalTotals { lost, duplicated, reordered } = totals;
        // The other end may have believed one altered number. Its report is then slightly wrong, and not a false claim.
        if lost.max(reordered) > sent.saturating_add(MAX_GAP) || duplicated > sent.saturating_mul(MAX_COPIES)
        {
            return Err(FalseClaim::TooManyDatagrams);
        }
        let totals = ArrivalTotals { lost: lost.min(sent), duplicated, reordered: reordered.min(sent) };
        if let Some(previous) = self.last_report.replace(totals) {
            self.confirmed = Some(self.confirmed.unwrap_or_default().max(previous.min(totals)));
        }
        Ok(())
    }

    /// Returns the totals; `None` before the second report.
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
    fn totals_are_minimum_of_two_reports_and_never_decrease() {
        let mut reported = ReportedTotals::default();
        assert_eq!(reported.receive(totals(1, 2, 3), 10), Ok(()));
        assert_eq!(reported.totals(), None);
        assert_eq!(reported.receive(totals(2, 2, 4), 10), Ok(()));
        assert_eq!(reported.totals(), Some(totals(1, 2, 3)));
        assert_eq!(reported.receive(totals(9, 9, 9), 10), Ok(()));
        assert_eq!(reported.totals(), Some(totals(2, 2, 4)), "a single high report is not believed");
        assert_eq!(reported.receive(totals(2, 3, 4), 10), Ok(()));
        assert_eq!(reported.totals(), Some(totals(2, 3, 4)));
        assert_eq!(reported.receive(totals(1, 1, 1), 10), Ok(()));
        assert_eq!(reported.totals(), Some(totals(2, 3, 4)), "a lower report decreases no total");
    }

    #[test]
    fn totals_above_what_was_sent_are_refused() {
        let mut reported = ReportedTotals::default();
        for impossible in [totals(75, 0, 0), totals(0, 161, 0), totals(0, 0, 75), totals(u64::MAX, 0, 0)] {
            assert_eq!(reported.receive(impossible, 10), Err(FalseClaim::TooManyDatagrams));
        }
        assert_eq!(reported.totals(), None);
    }

    #[test]
    fn totals_slightly_above_what_was_sent_are_reduced() {
        let mut reported = ReportedTotals::default();
        for _ in 0..2 {
            assert_eq!(reported.receive(totals(11, 0, 12), 10), Ok(()));
        }
        assert_eq!(reported.totals(), Some(totals(10, 0, 10)));
    }
}
