//! What is claimed about the clock, and what several claims come to.

use peernet_clock::{DelaySource, Discipline, Interval, MonoTime, Span};

/// How fast the error of a disciplined clock may grow: PHI of RFC 5905, section 7.2, parts per million.
pub(super) const GROWTH_PPM: f64 = 15.0;

/// Someone's word about the wall clock.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Answer {
    /// Who says it.
    pub(super) source: DelaySource,
    /// `None` when nothing is claimed: the clock is not synchronised, or nobody knows how well.
    pub(super) claim: Option<Claim>,
    /// In words.
    pub(super) text: String,
}

/// The clock's error (clock minus true time) lay within an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Claim {
    /// When it was made.
    pub(super) at: MonoTime,
    /// The interval then.
    pub(super) error: Interval,
    /// How fast it widens at both ends, parts per million.
    pub(super) growth_ppm: f64,
}

impl Claim {
    /// What it comes to at a later time.
    pub(super) fn at(&self, now: MonoTime) -> Interval {
        let age = now - self.at;
        let growth = Span::from_nanos((age.nanos().max(0) as f64 * self.growth_ppm * 1e-6).ceil() as i64);
        Interval { lo: self.error.lo - growth, hi: self.error.hi + growth }
    }
}

/// What all answers come to.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Summary {
    /// The intersection of all claims (Marzullo's algorithm, with no claim allowed to be wrong); `None` when there is
    /// none, or when they exclude each other.
    pub(super) discipline: Option<Discipline>,
    /// In words.
    pub(super) text: String,
    /// Whether claims exclude each other.
    pub(super) contradictory: bool,
}

/// Merges answers into what holds at `until`, somewhat later than now: a claim must hold until the next replaces it.
pub(super) fn merge(answers: &[Answer], until: MonoTime) -> Summary {
    let claims: Vec<(&Answer, Interval)> =
        answers.iter().filter_map(|answer| Some((answer, answer.claim?.at(until)))).collect();
    let words = |answers: &mut dyn Iterator<Item = &Answer>| {
        answers.map(|answer| answer.text.as_str()).collect::<Vec<_>>().join("; ")
    };
    let narrowest = claims.iter().min_by_key(|(_, error)| error.width());
    let common = claims.iter().map(|(_, error)| Some(*error));
    let common = common.reduce(|a, b| a?.intersection(b?));
    let (Some((narrowest, _)), Some(common)) = (narrowest, common) else {
        let text = match answers {
            [] => "nobody is asked how well the clock is set".to_owned(),
            answers => words(&mut answers.iter()),
        };
        return Summary { text, ..Summary::default() };
    };
    let Some(error) = common else {
        let each: Vec<String> = claims
            .iter()
            .map(|(answer, error)| format!("{}: error {} to {}", answer.text, error.lo, error.hi))
            .collect();
        let text = format!("claims exclude each other, none is used ({})", each.join("; "));
        return Summary { discipline: None, text, contradictory: true };
    };
    Summary {
        discipline: Some(Discipline { source: narrowest.source, error }),
        text: words(&mut claims.iter().map(|(answer, _)| *answer)),
        contradictory: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(source: DelaySource, bounds: Option<(i64, i64)>) -> Answer {
        let claim = bounds.map(|(lo, hi)| Claim {
            at: MonoTime::from_nanos(0),
            error: Interval { lo: Span::from_millis(lo), hi: Span::from_millis(hi) },
            growth_ppm: GROWTH_PPM,
        });
        Answer { source, claim, text: source.to_string() }
    }

    fn merged(kernel: Option<(i64, i64)>, chrony: Option<(i64, i64)>) -> Summary {
        let answers = [answer(DelaySource::Kernel, kernel), answer(DelaySource::Chrony, chrony)];
        merge(&answers, MonoTime::from_nanos(0))
    }

    #[test]
    fn two_claims_become_what_both_allow() {
        let both = merged(Some((-5, 5)), Some((1, 9)));
        let error = Interval { lo: Span::from_millis(1), hi: Span::from_millis(5) };
        assert_eq!(both.discipline, Some(Discipline { source: DelaySource::Chrony, error }));
        assert_eq!(both.text, "kernel; chrony");
    }

    #[test]
    fn who_claims_nothing_does_not_disturb_the_other() {
        let one = merged(None, Some((1, 9)));
        assert_eq!(one.discipline.map(|claim| claim.source), Some(DelaySource::Chrony));
        assert_eq!(one.text, "chrony");
        let none = merged(None, None);
        assert_eq!(
            (none.discipline, none.text.as_str(), none.contradictory),
            (None, "kernel; chrony", false)
        );
        assert_eq!(merge(&[], MonoTime::from_nanos(0)).discipline, None);
    }

    #[test]
    fn claims_that_exclude_each_other_are_told_and_not_used() {
        let apart = merged(Some((-5, 0)), Some((1, 9)));
        assert_eq!((apart.discipline, apart.contradictory), (None, true));
        for part in ["kernel: error -5.000 ms to 0.000 ms", "chrony: error 1.000 ms to 9.000 ms"] {
            assert!(apart.text.contains(part), "{}", apart.text);
        }
    }

    #[test]
    fn a_claim_widens_as_it_ages() {
        let claim = answer(DelaySource::Kernel, Some((-1, 1))).claim.expect("it was given one");
        let later = claim.at(MonoTime::from_nanos(10_000_000_000));
        let expected = Span::from_micros(1000 + 150);
        assert_eq!(later, Interval { lo: -expected, hi: expected });
    }
}
