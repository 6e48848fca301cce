//! Runs that ended before they were to end.

use super::Counts;
use crate::results::{Row, RunRecord};

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
    /// What a run lacks of its pipeline's limit; `None` where it has all, or had no limit.
    pub(super) fn of(record: &RunRecord, rows: &[Row], counts: &Counts) -> Option<Self> {
        let limit = |key: &str| record.pipeline.get("limit")?.get(key)?.as_f64();
        let finished = record.reason == "finished";
        let interrupted = record.reason == "stopped";
        let (seconds, measured) = (limit("duration_s"), counts.measured() + record.counts.unseen);
        let orders = [
            (limit("iterations"), measured as f64, Unit::Iterations),
            (limit("total"), (measured + counts.warm_up) as f64, Unit::Iterations),
            (seconds, lasted(rows), Unit::Seconds),
        ];
        // A run with several limits has come as far as the one that it is nearest to.
        let ordered = orders.into_iter().filter_map(|(of, came, unit)| {
            of.filter(|of| *of > 0.0).map(|of| Self { came, of, unit, interrupted })
        });
        let early = ordered.max_by(|a, b| a.share().total_cmp(&b.share()))?;
        // Seconds are never met to the millisecond: of a run with such a limit its own word is taken.
        let whole = early.share() >= 1.0 || (finished && seconds.is_some());
        (!whole).then_some(early)
    }

    /// From 0 to 1.
    pub fn share(&self) -> f64 {
        self.came / self.of
    }
}

/// From the first to the last iteration that is no warm-up, seconds.
fn lasted(rows: &[Row]) -> f64 {
    let at = || rows.iter().filter(|row| !row.warm_up && row.at > 0.0).map(|row| row.at);
    at().next_back().zip(at().next()).map_or(0.0, |(last, first)| (last - first).max(0.0))
}
