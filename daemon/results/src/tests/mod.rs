//! Tests that write rows to files and read them back.

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

/// Appends the rows to an empty [`Rows`] and returns it.
fn to_rows(rows: &[Row]) -> Rows {
    rows.iter().cloned().collect()
}
