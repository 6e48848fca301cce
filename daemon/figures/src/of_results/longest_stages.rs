//! Choice of the stages that are drawn beside the total.

use peernet_analysis::rows::Rows;
use peernet_analysis::stage_split::StageSplit;
use peernet_logger::{Name, stage};

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
    /// Divides the stages by their mean latencies, as bars show them: an unknown delay counts as the mean of the known
    /// delays. Stages that took no time are in neither group.
    pub(super) fn new(rows: &Rows) -> Self {
        let split = StageSplit::from_rows(rows);
        // The sum of both directions has no column of values, so it cannot be drawn.
        let names = split.longest_stages().into_iter().map(|(name, _)| name.clone());
        let mut stages: Vec<Name> = names.filter(|name| stage::ORDER.contains(name)).collect();
        let shorter = stages.split_off(MAX_STAGES.min(stages.len()));
        let in_order = |mut stages: Vec<Name>| {
            stages.sort_by_key(|name| stage::ORDER.iter().position(|other| other == name));
            stages
        };
        Self { longest: in_order(stages), shorter: in_order(shorter) }
    }

    /// Returns a note on the stages that are not drawn; `None` if all stages are drawn.
    pub(super) fn shorter_note(&self) -> Option<String> {
        let names: Vec<&str> = self.shorter.iter().map(Name::as_str).collect();
        (!names.is_empty()).then(|| format!("shorter stages, not drawn: {}", names.join(", ")))
    }
}
