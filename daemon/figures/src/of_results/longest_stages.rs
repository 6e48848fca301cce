//! Choice of the stages that have a curve beside the curve of the total.

use peernet_analysis::rows::Rows;
use peernet_logger::{Name, stage};

use super::columns::values;

/// Maximum number of stages with a curve; more curves would be hard to distinguish.
const MAX_CURVES: usize = 4;

/// The longest stages of a run and its other stages, both in the order of time.
pub(super) struct LongestStages {
    pub(super) longest: Vec<Name>,
    shorter: Vec<Name>,
}

impl LongestStages {
    /// Compares the stages by their sums over the rows in the statistics. Stages that took no time are left out.
    pub(super) fn new(rows: &Rows) -> Self {
        let sums = stage::ORDER.into_iter().map(|name| {
            let sum: f64 = values(rows, &name).values().iter().sum();
            (sum, name)
        });
        let mut stages: Vec<(f64, Name)> = sums.filter(|(sum, _)| *sum > 0.0).collect();
        stages.sort_by(|a, b| b.0.total_cmp(&a.0));
        let shorter = stages.split_off(MAX_CURVES.min(stages.len()));
        let in_order = |mut stages: Vec<(f64, Name)>| {
            stages.sort_by_key(|(_, name)| stage::ORDER.iter().position(|other| other == name));
            stages.into_iter().map(|(_, name)| name).collect()
        };
        Self { longest: in_order(stages), shorter: in_order(shorter) }
    }

    /// Returns a note on the stages without a curve; `None` if all have one.
    pub(super) fn shorter_note(&self) -> Option<String> {
        let names: Vec<&str> = self.shorter.iter().map(Name::as_str).collect();
        (!names.is_empty()).then(|| format!("shorter stages, not drawn: {}", names.join(", ")))
    }
}
