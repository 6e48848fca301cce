//! Inputs that the tests of several modules share.

mod iterations;

pub(crate) use iterations::*;

use crate::rows::{Outcome, Row, Rows};

/// Returns the rows of [`iterations`].
pub(crate) fn rows(count: u64) -> Vec<Row> {
    iterations(count).iter().map(Row::from_iteration).collect()
}

/// Returns a row without one-way delays, with these values of nodes.
pub(crate) fn row_of_values(outcome: Outcome, values: &[(&'static str, f64)]) -> Row {
    Row {
        iteration: 1,
        at: 0.0,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome,
        reason: None,
        values: values.iter().map(|(name, value)| ((*name).into(), *value)).collect(),
        upload: None,
        download: None,
    }
}

/// Appends the rows to an empty [`Rows`] and returns it.
pub(crate) fn to_rows(rows: &[Row]) -> Rows {
    rows.iter().cloned().collect()
}
