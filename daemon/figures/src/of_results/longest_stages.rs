//! Choice of the stages that are drawn beside the total.

use peernet_analysis::rows::Rows;
use peernet_logger::{Name, stage};

use super::columns::values;

/// Maximum number of stages that are drawn. More lines would be hard to distinguish.
const MAX_STAGES: usize = 4;

/// The stages of a run, divided into the longest stages and the other stages.
pub(super) struct LongestStages {
    /// The longest stages, in the order of time.
    pub(super) longest: Vec<Name>,
    /// The other stages, in the order of time.
    shorter: Vec<Name>,
}

impl LongestStages {
    /// Divides the stages by the sums of their latencies over the rows in the statistics. Stages that took no time are
    /// in neither group.
    pub(super) fn new(rows: &Rows) -> Self {
        let sums = stage::ORDER.into_iter().map(|name| {
            let sum: f64 = values(rows, &name).values().iter().sum();
            (sum, name)
        });
        let mut stages: Vec<(f64, Name)> = sums.filter(|(sum, _)| *sum > 0.0).collect();
        stages.sort_by(|a, b| b.0.total_cmp(&a.0));
        let shorter = stages.split_off(MAX_STAGES.min(stages.len()));
        let in_order = |mut stages: Vec<(f64, Name)>| {
            stages.sort_by_key(|(_, name)| stage::ORDER.iter().position(|other| other == name));
            stages.into_iter().map(|(_, name)| name).collect()
        };
        Self { longest: in_order(stages), shorter: in_order(shorter) }
    }

    /// Returns a note on the stages that are not drawn; `None` if all stages are drawn.
    pub(super) fn shorter_note(&self) -> Option<String> {
        let names: Vec<&str> = self.shorter.iter().map(Name::as_str).collect();
        (!names.is_empty()).then(|| format!("shorter stages, not drawn: {}", names.join(", ")))
    }
}
