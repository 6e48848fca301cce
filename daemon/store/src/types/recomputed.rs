//! One-way delays of a run that are judged again.

use peernet_clock::{RelatedClocks, Verdict};
use peernet_logger::Name;
use serde::Serialize;

use crate::quantity_statistics::QuantityStatistics;

/// The one-way delays of a run, as the agent judged them during the run, and as the store judges them from all
/// exchanges, including exchanges after the delays. The stored stamps stay unchanged.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecomputedDelays {
    /// The number of the run.
    pub number: i64,
    /// Number of stored clock samples that were used.
    pub samples: u64,
    /// Clocks by whose stamps delays were judged again; empty if all delays keep their first judgement.
    ///
    /// Earlier versions stamped only wall clocks. The delays of their runs are judged by wall clocks, whose steps and
    /// slews affect these delays.
    pub clocks: Vec<RelatedClocks>,
    /// The delays of `upload` and of `download`; a direction without delays is absent.
    pub stages: Vec<RecomputedStage>,
}

/// The delays of one direction, as first judged and as judged again. Only successful iterations without the warm-up are
/// included.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecomputedStage {
    /// The node's name.
    pub stage: Name,
    /// Judgement as stored.
    pub before: Judgement,
    /// Judgement as computed again.
    pub after: Judgement,
}

/// Statistics of delays and of their accuracy.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Judgement {
    /// Statistics of the delays that have a value, seconds.
    pub delay: Option<QuantityStatistics>,
    /// Statistics of half the width of the delays' bounds, seconds.
    pub half_width: Option<QuantityStatistics>,
    /// Number of delays per verdict.
    pub verdicts: Vec<(Verdict, u64)>,
}
