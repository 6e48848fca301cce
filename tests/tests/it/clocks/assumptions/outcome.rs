//! Comparison of a case's reported delays with the truth.

use peernet_clock::{RawTime, Span};
use peernet_tests::record_measurements;
use peernet_tests::truth::{Delay, HostClock, Iteration, true_times};

/// Largest error of the computed truth: the inverse of both clocks' drift is rounded, and so are stored values.
const MAX_TRUTH_ERROR: Span = Span::from_nanos(3);

/// Length of the period at the end of a case. Its delays show the result.
const END_PERIOD: Span = Span::from_seconds(3);

/// Delay with its judgement.
#[derive(Debug)]
struct JudgedDelay {
    sent: RawTime,
    received: RawTime,
    #[expect(dead_code, reason = "for messages of failed assertions")]
    verdict: String,
    /// `true` if the verdict is `ok` or `limited`.
    is_good: bool,
    /// Distance between the interval and the truth; zero if the delay is not good.
    error: Span,
}

impl JudgedDelay {
    fn new(delay: &Delay, sender: &HostClock, receiver: &HostClock) -> Self {
        let (sent, received) = true_times(delay, sender, receiver);
        let truth = received - sent;
        let is_good = ["ok", "limited"].contains(&delay.verdict.as_str());
        if delay.verdict == "inconsistent" {
            assert!(
                delay.value.is_none() && delay.bounds.is_none(),
                "an inconsistent delay has a value or bounds: {delay:?}"
            );
        }
        let error = match delay.bounds {
            Some((lo, hi)) if is_good => (lo - truth).max(truth - hi).max(Span::ZERO),
            None if is_good => panic!("a good delay has no bounds: {delay:?}"),
            _ => Span::ZERO,
        };
        Self { sent, received, verdict: delay.verdict.clone(), is_good, error }
    }
}

/// Result of a case.
pub(super) struct Outcome {
    case: &'static str,
    /// Delays in the order of time, by the kernel's clock.
    delays: Vec<JudgedDelay>,
    incidents: String,
}

impl Outcome {
    pub(super) fn new(
        case: &'static str,
        iterations: &[Iteration],
        [edge, cloud]: [&HostClock; 2],
        incidents: String,
    ) -> Self {
        let delays = iterations.iter().flat_map(|iteration| {
            [JudgedDelay::new(&iteration.up, edge, cloud), JudgedDelay::new(&iteration.down, cloud, edge)]
        });
        let mut delays: Vec<JudgedDelay> = delays.collect();
        delays.sort_by_key(|delay| delay.sent);
        Self { case, delays, incidents }
    }

    /// Prints how often and for how long intervals were wrong. Checks that the messages with wrong intervals arrived after
    /// the time `violated`, and were sent at most `allowed` after it.
    pub(super) fn assert_wrong_for_at_most(&self, allowed: Span, violated: RawTime) {
        let wrong: Vec<&JudgedDelay> =
            self.delays.iter().filter(|delay| delay.error > MAX_TRUTH_ERROR).collect();
        let since_violation = |delay: &JudgedDelay| delay.sent - violated;
        let last_wrong = wrong.last().map_or(Span::ZERO, |last| since_violation(last));
        let max_error = wrong.iter().map(|delay| delay.error).max().unwrap_or_default();
        let good = self.delays.iter().filter(|delay| delay.is_good).count();
        let figures = [
            ("delays judged ok or limited", format!("{good} of {}", self.delays.len())),
            ("intervals without the truth", wrong.len().to_string()),
            ("time from the violation to the last of these", last_wrong.to_string()),
            ("largest distance from interval to truth", max_error.to_string()),
        ];
        record_measurements(self.case, &figures);
        for delay in wrong {
            let is_allowed = delay.received >= violated && since_violation(delay) <= allowed;
            assert!(
                is_allowed,
                "{}: wrong interval {} after the violation: {delay:?}",
                self.case,
                since_violation(delay)
            );
        }
    }

    /// Checks that no interval misses the truth.
    pub(super) fn assert_never_wrong(&self) {
        // The violation is before the first delay, and no time is allowed after it, so no interval may be wrong.
        self.assert_wrong_for_at_most(Span::ZERO, self.delays[0].sent - Span::from_seconds(1));
    }

    fn last_delays(&self) -> impl Iterator<Item = &JudgedDelay> {
        let end = self.delays[self.delays.len() - 1].sent;
        self.delays.iter().filter(move |delay| end - delay.sent < END_PERIOD)
    }

    /// Checks that all delays at the end are good.
    pub(super) fn assert_good_at_end(&self) {
        let not_good: Vec<&JudgedDelay> = self.last_delays().filter(|delay| !delay.is_good).collect();
        assert!(
            not_good.is_empty(),
            "{}: {} delays at the end are not good, such as {:?}; incidents: {}",
            self.case,
            not_good.len(),
            not_good[0],
            self.incidents
        );
    }

    /// Checks that no delay at the end is good.
    pub(super) fn assert_no_good_delay_at_end(&self) {
        let good: Vec<&JudgedDelay> = self.last_delays().filter(|delay| delay.is_good).collect();
        assert!(good.is_empty(), "{}: delays at the end are good: {good:?}", self.case);
    }

    /// Checks that an incident contains this text.
    pub(super) fn assert_incidents_contain(&self, text: &str) {
        assert!(self.incidents.contains(text), "{}: {text} is not in {}", self.case, self.incidents);
    }
}
