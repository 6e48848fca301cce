//! Results of a run as they are read back, and whether they are complete.

use std::path::PathBuf;

use peernet_statistics::number::counted;

use crate::accuracy::UnknownLabels;
use crate::record::{Counts, RunRecord};
use crate::rows::Rows;
use crate::run_trust_input::early_end;

/// Text that replaces the reason for the end of a run if its folder has rows, but no record. A run writes its record
/// after its rows.
pub const NO_RECORD: &str =
    "run.json is missing: the run is in progress or was killed, or data.csv was copied without it";

/// Results that were read back.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// Folder that the results were read from.
    pub folder: PathBuf,
    /// Record of the run.
    pub record: RunRecord,
    /// Iterations of the run, in order.
    pub rows: Rows,
}

/// Difference between the rows and the counts in `run.json`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RowsDamage {
    /// The number of rows is the same, but outcomes or warm-up differ.
    #[error("the outcomes or the warm-up iterations in data.csv differ from the counts in run.json")]
    Outcomes,
    /// There are more or fewer rows than `run.json` counts.
    #[error("data.csv has {}, but run.json counts {}", counted(*.rows, "row"), counted(*.measured, "iteration"))]
    Length {
        /// Number of rows.
        rows: u64,
        /// Number of iterations that were measured.
        measured: u64,
    },
}

impl Loaded {
    /// Returns the reason why the rows are incomplete, in one clause: some measurements are missing, or the run was
    /// interrupted, broke off, was killed or is still in progress. `None` if the rows are complete, or if it is not
    /// known whether they are, as for files of other programs.
    pub fn incompleteness(&self) -> Option<String> {
        let has_no_record = self.record.reason.failure() == Some(NO_RECORD);
        self.damage().map(|damage| damage.to_string()).or_else(|| match has_no_record {
            true => Some(NO_RECORD.to_owned()),
            false => early_end(&self.record, &self.rows).map(|end| format!("the run {end}")),
        })
    }

    /// Returns the difference between the rows of `data.csv` and the counts in `run.json`. A difference shows that a
    /// file was truncated or changed. `None` if rows and counts agree, or if there are no counts.
    pub fn damage(&self) -> Option<RowsDamage> {
        let record_counts = self.record.counts;
        let row_counts = Counts::from_rows(&self.rows, record_counts.unseen);
        let has_record_counts = self.record.format > 0 && record_counts != Counts::default();
        let differ = has_record_counts && row_counts != record_counts;
        differ.then(|| match (self.rows.len() as u64, record_counts.measured_with_warm_up()) {
            (rows, measured) if rows == measured => RowsDamage::Outcomes,
            (rows, measured) => RowsDamage::Length { rows, measured },
        })
    }

    /// Returns the samples whose label is not a class of the model. Their answers are neither right nor wrong.
    fn unknown_labels(&self) -> Option<UnknownLabels> {
        UnknownLabels::from_rows(&self.rows, &self.record.facts)
    }
}

/// Returns the unknown labels of several runs together, with the examples of the first run that has unknown labels.
pub fn unknown_labels<'a>(runs: impl IntoIterator<Item = &'a Loaded>) -> Option<UnknownLabels> {
    runs.into_iter().filter_map(Loaded::unknown_labels).reduce(|all, more| all.merged_with(&more))
}
