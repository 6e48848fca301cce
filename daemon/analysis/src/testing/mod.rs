//! Inputs that the tests of several modules share.

mod iterations;

pub(crate) use iterations::*;

use crate::rows::{Row, Rows};

/// [`iterations`] as rows.
pub(crate) fn rows(count: u64) -> Vec<Row> {
    iterations(count).iter().map(Row::of).collect()
}

/// As they are kept.
pub(crate) fn kept(rows: &[Row]) -> Rows {
    rows.iter().cloned().collect()
}
