//! Whether the starts that an open loop ordered took place.

use serde::Deserialize;

use crate::results::{Rows, RunRecord, SKIPPED_STARTS};

/// How often a run was to begin an iteration: its pipeline's `load`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct Load {
    /// Starts per second, on average where they come at random; `None` in a closed loop, which waits for each answer.
    pub hz: Option<f64>,
}

/// What became of the ordered starts, warm-up left out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Starts {
    /// Starts per second that were ordered; `None` in a closed loop, and where it is not known.
    pub hz: Option<f64>,
    /// Iterations that began.
    pub kept: u64,
    /// Starts that were skipped because the pipeline was too far behind.
    pub skipped: u64,
}

impl Load {
    /// That of a run's record; none where it was written by a program that has another one.
    pub(super) fn of_record(record: &RunRecord) -> Self {
        record.pipeline.get("load").and_then(|load| Self::deserialize(load).ok()).unwrap_or_default()
    }
}

impl Starts {
    /// What rows say, which do not know what was ordered.
    pub fn of_rows(rows: &Rows) -> Self {
        let begun = || rows.iter().filter(|row| !row.warm_up());
        let skipped = begun().filter_map(|row| row.value(SKIPPED_STARTS)).filter(|value| *value > 0.0);
        Self { hz: None, kept: begun().count() as u64, skipped: skipped.sum::<f64>() as u64 }
    }

    /// All that came due.
    pub const fn all(&self) -> u64 {
        self.kept + self.skipped
    }

    /// The share that was skipped, 0 to 1.
    pub fn skipped_share(&self) -> f64 {
        if self.all() == 0 { 0.0 } else { self.skipped as f64 / self.all() as f64 }
    }

    /// The rate that was kept, per second.
    pub fn kept_hz(&self) -> Option<f64> {
        self.hz.map(|hz| hz * (1.0 - self.skipped_share()))
    }
}
