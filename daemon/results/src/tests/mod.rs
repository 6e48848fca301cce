//! Tests of results as a whole: rows are written to files and read back.

mod files;
mod published;
mod summary;

use peernet_analysis::record::{Counts, RunRecord};
use peernet_analysis::rows::{Column, Outcome, Row, Rows};
use peernet_analysis::summary::Summary;

use super::*;
use crate::iterations::iterations;

/// Returns rows, of which the first two are warm-up and the sixth is lost.
fn rows(count: u64) -> Vec<Row> {
    iterations(count).iter().map(Row::from_iteration).collect()
}

/// Returns rows in the form in which they are kept.
fn kept(rows: &[Row]) -> Rows {
    rows.iter().cloned().collect()
}
