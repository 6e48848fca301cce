//! Runs that ended before they were to end.

use peernet_statistics::number::{counted, fixed, significant};
use peernet_stream::EndReason;
use serde::Deserialize;

use crate::rows::Rows;

/// What a run was asked for: its pipeline's `limit`. What is not there is no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct Limits {
    /// Iterations, warm-up left out.
    pub iterations: Option<f64>,
    /// Iterations with those of the warm-up.
    pub total: Option<f64>,
    /// Seconds from the first iteration that is no warm-up.
    pub duration_s: Option<f64>,
}

/// What there is of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Came {
    /// Iterations, answered or not, warm-up left out; with those that were measured and not seen.
    pub measured: u64,
    /// Iterations of the warm-up.
    pub warm_up: u64,
    /// From the first iteration that is no warm-up to the last, seconds.
    pub seconds: f64,
}

/// How far a run came of what was ordered.
#[derive(Clone, Debug, PartialEq)]
pub struct Early {
    /// What came, in the unit of `of`.
    pub came: f64,
    /// What was ordered.
    pub of: f64,
    /// What is counted.
    pub unit: Unit,
    /// Whether somebody ended it.
    pub interrupted: bool,
}

/// What an order is counted in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Iterations, answered or not.
    Iterations,
    /// Seconds of measuring.
    Seconds,
}

impl Early {
    /// What a run that ended for `reason` lacks of its order; `None` where it has all, or had no limit.
    pub fn of(limits: &Limits, came: &Came, reason: &EndReason) -> Option<Self> {
        let interrupted = *reason == EndReason::Stopped;
        let orders = [
            (limits.iterations, came.measured as f64, Unit::Iterations),
            (limits.total, (came.measured + came.warm_up) as f64, Unit::Iterations),
            (limits.duration_s, came.seconds, Unit::Seconds),
        ];
        // A run with several limits has come as far as the one that it is nearest to.
        let reached = orders.into_iter().filter_map(|(of, came, unit)| {
            of.filter(|of| *of > 0.0).map(|of| Self { came, of, unit, interrupted })
        });
        let early = reached.max_by(|a, b| a.share().total_cmp(&b.share()))?;
        // Seconds are never met to the millisecond: of a run with such a limit its own word is taken.
        let whole = early.share() >= 1.0 || (*reason == EndReason::Finished && limits.duration_s.is_some());
        (!whole).then_some(early)
    }

    /// From 0 to 1.
    pub fn share(&self) -> f64 {
        self.came / self.of
    }

    /// In words: `after 57 of 120 iterations`.
    pub(crate) fn how_far(&self) -> String {
        let Self { came, of, unit, .. } = self;
        match unit {
            Unit::Iterations => format!("after {} of {}", fixed(*came, 0), counted(*of as u64, "iteration")),
            Unit::Seconds => format!("after {} of {}\u{202f}s", fixed(*came, 1), significant(*of)),
        }
    }
}

/// From the first to the last iteration that is no warm-up, seconds.
pub(crate) fn lasted(rows: &Rows) -> f64 {
    let at = || rows.iter().filter(|row| !row.warm_up() && row.at() > 0.0).map(|row| row.at());
    at().next_back().zip(at().next()).map_or(0.0, |(last, first)| (last - first).max(0.0))
}
