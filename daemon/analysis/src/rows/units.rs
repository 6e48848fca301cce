//! Units of the further columns of a run, which not every `data.csv` has.

use std::collections::BTreeMap;

use peernet_stream::Iteration;
use serde::{Deserialize, Serialize};

use super::{Row, columns};

/// Units of the further columns of a run: `s`, `B`, `W`, or any other unit that the run declared. Columns of plain
/// numbers are not included.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Units(BTreeMap<String, String>);

impl Units {
    /// Converts an iteration into a row, and remembers the units of its columns.
    pub fn row(&mut self, iteration: &Iteration) -> Row {
        let tree_values = columns::TreeValues::from_tree(&iteration.tree);
        for (column, unit) in tree_values.units() {
            match self.0.get_mut(column) {
                // An empty unit marks a column whose unit differs between iterations.
                Some(symbol) if symbol != unit.symbol() => symbol.clear(),
                Some(_) => {}
                None if unit.symbol().is_empty() => {}
                None => drop(self.0.insert(column.to_owned(), unit.symbol().to_owned())),
            }
        }
        Row::from_values(iteration, tree_values.values())
    }

    /// Returns the unit of a column. `None` for a column of plain numbers, and if the unit is not known or differs
    /// between iterations.
    pub fn of(&self, column: &str) -> Option<&str> {
        self.0.get(column).map(String::as_str).filter(|unit| !unit.is_empty())
    }
}
