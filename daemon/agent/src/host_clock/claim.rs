//! Claims about the error of the wall clock, and their combination.

use peernet_clock::{ClockClaim, DelaySource, Interval, MonoTime, Span};

/// Frequency tolerance of a disciplined clock, parts per million: the rate at which the bound of its error grows (PHI
/// of RFC 5905, section 7.2).
pub(super) const FREQUENCY_TOLERANCE_PPM: f64 = 15.0;

/// Report of a source, such as chrony, about the wall clock.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SourceReport {
    /// The source.
    pub(super) source: DelaySource,
    /// Claim of the source; `None` if the clock is not synchronised, or the source states no error bound.
    pub(super) claim: Option<Claim>,
    /// Text of the report for people.
    pub(super) text: String,
}

/// Interval that contained the clock's error (clock minus true time) at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Claim {
    /// Time at which the claim was made.
    pub(super) at: MonoTime,
    /// The interval at that time.
    pub(super) error: Interval,
    /// Rate at which the interval widens at each of its two ends, parts per million.
    pub(super) growth_ppm: f64,
}

impl Claim {
    /// Returns the interval at a later time.
    pub(super) fn error_at(&self, now: MonoTime) -> Interval {
        let growth = (now - self.at).max(Span::ZERO).drift(self.growth_ppm);
        Interval { lo: self.error.lo - growth, hi: self.error.hi + growth }
    }
}

/// Combination of the reports of all sources.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ClaimSummary {
    /// The intersection of all claims (Marzullo's algorithm, with no claim allowed to be wrong); `None` without a
    /// claim, or if the claims contradict each other.
    pub(super) claim: Option<ClockClaim>,
    /// Text for people.
    pub(super) text: String,
    /// `true` if claims contradict each other.
    pub(super) is_contradictory: bool,
}

/// Combines reports into a summary that holds until `until`, the time at which the next summary replaces it.
pub(super) fn combine(reports: &[SourceReport], until: MonoTime) -> ClaimSummary {
    // The intervals are taken at the end of the summary's validity, because they widen with time.
    let claims: Vec<(&SourceReport, Interval)> =
        reports.iter().filter_map(|report| Some((report, report.claim?.error_at(until)))).collect();
    let join_texts = |reports: &mut dyn Iterator<Item = &SourceReport>| {
        reports.map(|report| report.text.as_str()).collect::<Vec<_>>().join("; ")
    };
    let Some((narrowest_report, narrowest_error)) = claims.iter().min_by_key(|(_, error)| error.width())
    else {
        let text = match reports {
            [] => "no source of claims is configured".to_owned(),
            reports => join_texts(&mut reports.iter()),
        };
        return ClaimSummary { text, ..ClaimSummary::default() };
    };
    // `None` if the claims contradict each other.
    let intersection =
        claims.iter().try_fold(*narrowest_error, |common, (_, error)| common.intersection(*error));
    let Some(error) = intersection else {
        let descriptions: Vec<String> = claims
            .iter()
            .map(|(report, error)| format!("{}: error {} to {}", report.text, error.lo, error.hi))
            .collect();
        let text = format!("claims contradict each other, so no claim is used ({})", descriptions.join("; "));
        return ClaimSummary { claim: None, text, is_contradictory: true };
    };
    ClaimSummary {
        claim: Some(ClockClaim { source: narrowest_report.source, error }),
        text: join_texts(&mut claims.iter().map(|(report, _)| *report)),
        is_contradictory: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(source: DelaySource, bounds: Option<(i64, i64)>) -> SourceReport {
        let claim = bounds.map(|(lo, hi)| Claim {
            at: MonoTime::from_nanos(0),
            error: Interval { lo: Span::from_millis(lo), hi: Span::from_millis(hi) },
            growth_ppm: FREQUENCY_TOLERANCE_PPM,
        });
        SourceReport { source, claim, text: source.to_string() }
    }

    fn combined(kernel: Option<(i64, i64)>, chrony: Option<(i64, i64)>) -> ClaimSummary {
        let reports = [report(DelaySource::Kernel, kernel), report(DelaySource::Chrony, chrony)];
        combine(&reports, MonoTime::from_nanos(0))
    }

    #[test]
    fn two_claims_are_combined_to_their_intersection() {
        let summary = combined(Some((-5, 5)), Some((1, 9)));
        let error = Interval { lo: Span::from_millis(1), hi: Span::from_millis(5) };
        assert_eq!(summary.claim, Some(ClockClaim { source: DelaySource::Chrony, error }));
        assert_eq!(summary.text, "kernel; chrony");
    }

    #[test]
    fn source_without_claim_leaves_claim_of_other_source() {
        let summary = combined(None, Some((1, 9)));
        assert_eq!(summary.claim.map(|claim| claim.source), Some(DelaySource::Chrony));
        assert_eq!(summary.text, "chrony");
        let summary = combined(None, None);
        assert_eq!(
            (summary.claim, summary.text.as_str(), summary.is_contradictory),
            (None, "kernel; chrony", false)
        );
        assert_eq!(combine(&[], MonoTime::from_nanos(0)).claim, None);
    }

    #[test]
    fn contradicting_claims_are_described_and_not_used() {
        let summary = combined(Some((-5, 0)), Some((1, 9)));
        assert_eq!((summary.claim, summary.is_contradictory), (None, true));
        for part in ["kernel: error -5.000 ms to 0.000 ms", "chrony: error 1.000 ms to 9.000 ms"] {
            assert!(summary.text.contains(part), "{}", summary.text);
        }
    }

    #[test]
    fn claim_widens_with_age() {
        let claim = report(DelaySource::Kernel, Some((-1, 1))).claim.expect("the report has a claim");
        let later = claim.error_at(MonoTime::from_nanos(10_000_000_000));
        let expected = Span::from_micros(1000 + 150);
        assert_eq!(later, Interval { lo: -expected, hi: expected });
    }
}
