//! In what the columns are measured that a run logged beside the standard ones.

use std::collections::BTreeMap;

use peernet_stream::Iteration;
use serde::{Deserialize, Serialize};

use super::{Row, columns};

/// The units of a run's own columns: `s`, `B`, `W`, whatever it declared. What is a plain number is not in it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Units(BTreeMap<String, String>);

impl Units {
    /// An iteration as a row; the units of its columns are remembered.
    pub fn row(&mut self, iteration: &Iteration) -> Row {
        let found = columns::Found::of(&iteration.tree);
        for (column, unit) in found.units() {
            match self.0.get_mut(column) {
                Some(known) if known != unit.symbol() => known.clear(),
                Some(_) => {}
                None if unit.symbol().is_empty() => {}
                None => drop(self.0.insert(column.to_owned(), unit.symbol().to_owned())),
            }
        }
        Row::with(iteration, found.values())
    }

    /// Returns a column's unit; `None` for a plain number, and if iterations did not agree or the unit is not known.
    pub fn of(&self, column: &str) -> Option<&str> {
        self.0.get(column).map(String::as_str).filter(|unit| !unit.is_empty())
    }
}
