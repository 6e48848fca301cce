//! Units of the columns that a run logged in addition to the standard columns.

use std::collections::BTreeMap;

use peernet_stream::Iteration;
use serde::{Deserialize, Serialize};

use super::{Row, columns};

/// Units of a run's further columns: `s`, `B`, `W`, or any other that it declared. Columns of plain numbers are not included.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Units(BTreeMap<String, String>);

impl Units {
    /// Returns an iteration as a row, and stores the units of its columns.
    pub fn row(&mut self, iteration: &Iteration) -> Row {
        let found = columns::TreeValues::from_tree(&iteration.tree);
        for (column, unit) in found.units() {
            match self.0.get_mut(column) {
                Some(known) if known != unit.symbol() => known.clear(),
                Some(_) => {}
                None if unit.symbol().is_empty() => {}
                None => drop(self.0.insert(column.to_owned(), unit.symbol().to_owned())),
            }
        }
        Row::from_values(iteration, found.values())
    }

    /// Returns a column's unit; `None` for a plain number, and if iterations did not agree or the unit is not known.
    pub fn of(&self, column: &str) -> Option<&str> {
        self.0.get(column).map(String::as_str).filter(|unit| !unit.is_empty())
    }
}
