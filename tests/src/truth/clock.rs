//! Wrong clocks, turned round.

use chrono::DateTime;
use peernet_clock::{RehearsalDescription, RehearsedStep, Span, WallTime};
use serde_json::Value;

/// What a host's clock shows when the kernel's shows something.
#[derive(Clone, Debug)]
pub struct HostClock(Vec<RehearsalDescription>);

impl HostClock {
    /// A clock that is wrong as described.
    pub fn new(rehearsal: RehearsalDescription) -> Self {
        Self(vec![rehearsal])
    }

    /// A clock that is ahead by one of several offsets, at times that nobody knows.
    pub fn ahead_by(offsets: &[Span]) -> Self {
        let ahead = |offset: &Span| RehearsalDescription {
            offset: *offset,
            drift_ppm: 0.0,
            steps: Vec::new(),
            since: WallTime::default(),
        };
        Self(offsets.iter().map(ahead).collect())
    }

    /// A clock as a host tells that it is rehearsed, in the API's form; `None` for anything else.
    pub fn told(rehearsal: &Value) -> Option<Self> {
        let span = |value: &Value| value.as_f64().map(Span::from_seconds_f64);
        let since = DateTime::parse_from_rfc3339(rehearsal["since"].as_str()?).ok()?;
        let steps = rehearsal["steps"].as_array()?.iter();
        let steps =
            steps.map(|step| Some(RehearsedStep::of_wall(span(&step["at_s"])?, span(&step["by_s"])?)));
        Some(Self::new(RehearsalDescription {
            offset: span(&rehearsal["offset_s"])?,
            drift_ppm: rehearsal["drift_ppm"].as_f64()?,
            steps: steps.collect::<Option<_>>()?,
            since: WallTime::from_unix_nanos(since.timestamp_nanos_opt()?),
        }))
    }

    /// The kernel's clock itself.
    pub fn kernels() -> Self {
        Self::ahead_by(&[Span::ZERO])
    }

    /// When the rehearsal began, by the kernel's clock.
    pub fn since(&self) -> Option<WallTime> {
        self.0.first().map(|rehearsal| rehearsal.since)
    }

    /// By how much this clock is ahead when the kernel's shows `truth`.
    ///
    /// # Panics
    /// When nobody knows, because it is one of several.
    pub fn ahead(&self, truth: WallTime) -> Span {
        let [rehearsal] = &self.0[..] else { panic!("one of several: {:?}", self.0) };
        rehearsal.error_at(truth)
    }

    /// What the kernel's clock showed when this one showed `shown`.
    ///
    /// # Panics
    /// When this clock never showed that, because a step went over it, or showed it twice.
    pub fn truth(&self, shown: WallTime) -> WallTime {
        let truths = self.truths(shown);
        assert_eq!(truths.len(), 1, "a time that was shown once: {shown:?} by {:?}", self.0);
        truths[0]
    }

    /// The same for a clock that may have been set back, which shows some times twice.
    pub fn truths(&self, shown: WallTime) -> Vec<WallTime> {
        self.0.iter().flat_map(|rehearsal| truths(rehearsal, shown)).collect()
    }
}

/// `RehearsalDescription::shown`, turned round.
fn truths(rehearsal: &RehearsalDescription, shown: WallTime) -> impl Iterator<Item = WallTime> {
    let steps = &rehearsal.steps;
    (0..=steps.len()).filter_map(move |passed| {
        let stepped: Span = steps[..passed].iter().map(|step| step.by).sum();
        let ahead = shown - rehearsal.offset - stepped;
        let nanos = (ahead - rehearsal.since).nanos() as f64;
        let drifted = nanos - nanos / (1.0 + rehearsal.drift_ppm * 1e-6);
        let truth = ahead - Span::from_nanos(drifted.round() as i64);
        let elapsed = truth - rehearsal.since;
        let after = passed == 0 || steps[passed - 1].at <= elapsed;
        let before = passed == steps.len() || elapsed < steps[passed].at;
        (after && before).then_some(truth)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn what_a_rehearsed_clock_shows_leads_back_to_the_truth() {
        let since = WallTime::from_unix_nanos(1_700_000_000_000_000_000);
        let step = RehearsedStep::of_wall(Span::from_seconds(20), Span::from_seconds(3));
        let rehearsal = RehearsalDescription {
            offset: Span::from_seconds(-1),
            drift_ppm: 100.0,
            steps: vec![step],
            since,
        };
        let clock = HostClock::new(rehearsal.clone());
        for nanos in [0, 1, 19_999_999_999, 20_000_000_000, 20_000_000_001, 500_000_000_007] {
            let truth = since + Span::from_nanos(nanos);
            let found = clock.truth(rehearsal.shown(truth));
            assert!((found - truth).abs() <= Span::from_nanos(1), "{found:?} {truth:?}");
            assert_eq!(truth + clock.ahead(truth), rehearsal.shown(truth));
        }
        assert_eq!(HostClock::kernels().truth(since), since);
        let mut back = rehearsal.clone();
        back.steps[0].by = Span::from_seconds(-3);
        let clock_set_back = HostClock::new(back.clone());
        let at = |seconds| since + Span::from_seconds(seconds);
        assert_eq!(clock_set_back.truths(back.shown(at(21))).len(), 2);
        assert_eq!(clock_set_back.truths(back.shown(at(16))), [at(16)]);
        let told = serde_json::json!({
            "offset_s": -1.0, "drift_ppm": 100.0, "since": "2023-11-14T22:13:20.000000000Z",
            "steps": [{ "at_s": 20.0, "by_s": 3.0 }],
        });
        let told = HostClock::told(&told).expect("the API's form");
        let later = since + Span::from_seconds(30);
        assert_eq!(told.truth(rehearsal.shown(later)), clock.truth(rehearsal.shown(later)));
    }
}
