//! By how much a wall clock is wrong on purpose.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{Span, WallTime};

/// How a wall clock is made wrong: `shown = true + offset + drift × (true − since) + steps so far`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RehearsalDescription {
    /// Ahead from the start.
    pub offset: Span,
    /// Runs fast by so many parts per million.
    pub drift_ppm: f64,
    /// Steps, in any order.
    pub steps: Vec<RehearsedStep>,
    /// What the true wall clock showed at the start, when drift and steps begin to count.
    pub since: WallTime,
}

/// A step of a rehearsed clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RehearsedStep {
    /// So long after the start.
    pub at: Span,
    /// By so much.
    pub by: Span,
}

/// In words: `offset +1000 ms, drift -50 ppm, step +3000 ms after 20 s`.
impl fmt::Display for RehearsalDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let millis = |span: Span| span.nanos() as f64 / 1e6;
        write!(f, "offset {:+} ms", millis(self.offset))?;
        if self.drift_ppm != 0.0 {
            write!(f, ", drift {:+} ppm", self.drift_ppm)?;
        }
        for step in &self.steps {
            write!(f, ", step {:+} ms after {} s", millis(step.by), step.at.seconds())?;
        }
        Ok(())
    }
}

impl RehearsalDescription {
    /// What the clock shows when the true one shows `truth`.
    pub fn shown(&self, truth: WallTime) -> WallTime {
        truth + self.error_at(truth)
    }

    /// How far the clock is ahead when the true one shows `truth`.
    pub fn error_at(&self, truth: WallTime) -> Span {
        self.smooth_error_at(truth) + self.steps_until(truth).map(|step| step.by).sum()
    }

    /// What the true clock showed when this one showed `shown`, to the nanosecond.
    ///
    /// A clock that was set back shows some times twice, and one that was set forward leaves some out: then it is the
    /// last such time, or that of the step.
    pub fn true_of(&self, shown: WallTime) -> WallTime {
        let mut begins: Vec<WallTime> = self.steps.iter().map(|step| self.since + step.at).collect();
        begins.push(WallTime::from_unix_nanos(i64::MIN));
        begins.sort_unstable_by(|a, b| b.cmp(a));
        let mut end = WallTime::from_unix_nanos(i64::MAX);
        for begin in begins {
            let stepped: Span = self.steps_until(begin).map(|step| step.by).sum();
            let truth = self.smooth_true_of(shown - stepped);
            if truth >= begin {
                return truth.min(end);
            }
            end = begin;
        }
        end
    }

    fn smooth_error_at(&self, truth: WallTime) -> Span {
        let drift = (truth - self.since).nanos() as f64 * self.drift_ppm * 1e-6;
        self.offset + Span::from_nanos(drift.round() as i64)
    }

    /// The inverse without steps.
    fn smooth_true_of(&self, shown: WallTime) -> WallTime {
        let ahead = shown - self.offset;
        let elapsed = (ahead - self.since).nanos() as f64;
        let drift = elapsed - elapsed / (1.0 + self.drift_ppm * 1e-6);
        ahead - Span::from_nanos(drift.round() as i64)
    }

    pub(crate) fn steps_until(&self, truth: WallTime) -> impl Iterator<Item = &RehearsedStep> {
        let elapsed = truth - self.since;
        self.steps.iter().filter(move |step| step.at <= elapsed)
    }
}
