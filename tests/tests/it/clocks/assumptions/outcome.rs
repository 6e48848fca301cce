//! What a case reported, against the truth.

use peernet_clock::{RawTime, Span};
use peernet_tests::measured;
use peernet_tests::truth::{Delay, HostClock, Iteration, true_times};

/// The inverse of both clocks' drift rounds, and so does what is stored.
const INEXACT: Span = Span::from_nanos(3);

/// Delays of so much time at the end of a case show what it came to.
const END: Span = Span::from_seconds(3);

/// A delay that was believed or not.
#[derive(Debug)]
struct Judged {
    sent: RawTime,
    received: RawTime,
    #[expect(dead_code, reason = "for messages of failed assertions")]
    verdict: String,
    /// With the verdict `ok` or `limited`.
    is_good: bool,
    /// Good, and its interval misses the truth by so much.
    missed: Span,
}

impl Judged {
    fn new(delay: &Delay, sender: &HostClock, receiver: &HostClock) -> Self {
        let (sent, received) = true_times(delay, sender, receiver);
        let truth = received - sent;
        let is_good = ["ok", "limited"].contains(&delay.verdict.as_str());
        if delay.verdict == "inconsistent" {
            assert!(
                delay.value.is_none() && delay.bounds.is_none(),
                "what is inconsistent has no bounds: {delay:?}"
            );
        }
        let missed = match delay.bounds {
            Some((lo, hi)) if is_good => (lo - truth).max(truth - hi).max(Span::ZERO),
            None if is_good => panic!("good, and no bounds: {delay:?}"),
            _ => Span::ZERO,
        };
        Self { sent, received, verdict: delay.verdict.clone(), is_good, missed }
    }
}

/// What came of a case.
pub(super) struct Outcome {
    what: &'static str,
    /// In the order of time, by the kernel's clock.
    delays: Vec<Judged>,
    incidents: String,
}

impl Outcome {
    pub(super) fn new(
        what: &'static str,
        iterations: &[Iteration],
        [edge, cloud]: [&HostClock; 2],
        incidents: String,
    ) -> Self {
        let delays = iterations
            .iter()
            .flat_map(|both| [Judged::new(&both.up, edge, cloud), Judged::new(&both.down, cloud, edge)]);
        let mut delays: Vec<Judged> = delays.collect();
        delays.sort_by_key(|delay| delay.sent);
        Self { what, delays, incidents }
    }

    /// Says how often and how long intervals were wrong. None may be of a message that arrived before `violated`, or was sent later than
    /// `allowed` after it.
    pub(super) fn wrong_for_at_most(&self, allowed: Span, violated: RawTime) {
        let wrong: Vec<&Judged> = self.delays.iter().filter(|delay| delay.missed > INEXACT).collect();
        let since = |delay: &Judged| delay.sent - violated;
        let longest = wrong.last().map_or(Span::ZERO, |last| since(last));
        let most = wrong.iter().map(|delay| delay.missed).max().unwrap_or_default();
        let good = self.delays.iter().filter(|delay| delay.is_good).count();
        let figures = [
            ("delays judged ok or limited", format!("{good} of {}", self.delays.len())),
            ("of those without the truth", wrong.len().to_string()),
            ("the last of those after the violation", longest.to_string()),
            ("truth missed by at most", most.to_string()),
        ];
        measured(self.what, &figures);
        for delay in wrong {
            let is_allowed = delay.received >= violated && since(delay) <= allowed;
            assert!(is_allowed, "{}: {} after the violation: {delay:?}", self.what, since(delay));
        }
    }

    /// No interval misses the truth.
    pub(super) fn is_never_wrong(&self) {
        self.wrong_for_at_most(Span::ZERO, self.delays[0].sent - Span::from_seconds(1));
    }

    fn last(&self) -> impl Iterator<Item = &Judged> {
        let last = self.delays[self.delays.len() - 1].sent;
        self.delays.iter().filter(move |delay| last - delay.sent < END)
    }

    /// At the end all delays are good.
    pub(super) fn is_good_at_the_end(&self) {
        let bad: Vec<&Judged> = self.last().filter(|delay| !delay.is_good).collect();
        assert!(
            bad.is_empty(),
            "{}: {} of the last, the first of them {:?}; incidents: {}",
            self.what,
            bad.len(),
            bad[0],
            self.incidents
        );
    }

    /// At the end no delay is believed.
    pub(super) fn is_withdrawn_at_the_end(&self) {
        let believed: Vec<&Judged> = self.last().filter(|delay| delay.is_good).collect();
        assert!(believed.is_empty(), "{}: {believed:?}", self.what);
    }

    /// Such words are in an incident.
    pub(super) fn tells(&self, words: &str) {
        assert!(self.incidents.contains(words), "{}: {words} is not in {}", self.what, self.incidents);
    }
}
