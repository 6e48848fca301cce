//! Results as a whole: rows in, files out, rows back.

mod files;
mod published;
mod summary;

use peernet_analysis::record::{Counts, RunRecord};
use peernet_analysis::rows::{Column, Outcome, Row, Rows};
use peernet_analysis::summary::Summary;

use super::*;
use crate::iterations::iterations;

/// So many rows, the first two of them warm-up, the sixth lost.
fn rows(count: u64) -> Vec<Row> {
    iterations(count).iter().map(Row::of).collect()
}

/// As they are kept.
fn kept(rows: &[Row]) -> Rows {
    rows.iter().cloned().collect()
}
