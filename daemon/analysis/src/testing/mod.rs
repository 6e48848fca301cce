//! Inputs that the tests of several modules share.

mod iterations;

pub(crate) use iterations::*;

use crate::rows::{Row, Rows};

/// Returns [`iterations`] as rows.
pub(crate) fn rows(count: u64) -> Vec<Row> {
    iterations(count).iter().map(Row::from_iteration).collect()
}

/// Returns the rows in the form in which they are stored.
pub(crate) fn kept(rows: &[Row]) -> Rows {
    rows.iter().cloned().collect()
}
