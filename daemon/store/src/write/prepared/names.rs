//! Positions of node names in the list of a batch.

use std::collections::HashMap;

use peernet_logger::{Measure, Name, Unit};

/// Key of a row of the table `name`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::write) struct NameKey {
    pub(in crate::write) text: Name,
    pub(in crate::write) kind: Name,
    /// `true` if the kind is a user's own.
    pub(in crate::write) custom: bool,
    pub(in crate::write) unit: Unit,
}

impl NameKey {
    fn new(name: &Name, measure: &Measure) -> Self {
        let custom = matches!(measure, Measure::Custom(..));
        Self { text: name.clone(), kind: measure.kind(), custom, unit: measure.unit() }
    }

    /// Returns whether it is the key of a node, without allocating that key.
    fn is(&self, name: &Name, measure: &Measure) -> bool {
        self.text == *name
            && match measure {
                Measure::Custom(kind, unit, _) => self.custom && self.kind == *kind && self.unit == *unit,
                Measure::Value(_, unit) => !self.custom && self.kind == measure.kind() && self.unit == *unit,
                // The unit follows from the kind.
                _ => !self.custom && self.kind == measure.kind(),
            }
    }
}

/// The names of a batch.
#[derive(Debug, Default)]
pub(super) struct LocalNames {
    pub(super) list: Vec<NameKey>,
    /// Position in `list`.
    positions: HashMap<NameKey, u32>,
    /// Names of the tree before: the next tree mostly has the same shape.
    shape: Vec<u32>,
}

impl LocalNames {
    /// Returns the position of a name, for the node at `at` of its tree.
    pub(super) fn position(&mut self, at: usize, name: &Name, measure: &Measure) -> u32 {
        if let Some(position) = self.shape.get(at)
            && self.list[*position as usize].is(name, measure)
        {
            return *position;
        }
        let key = NameKey::new(name, measure);
        let position = *self.positions.entry(key).or_insert_with_key(|key| {
            self.list.push(key.clone());
            self.list.len() as u32 - 1
        });
        if self.shape.len() <= at {
            self.shape.resize(at + 1, position);
        }
        self.shape[at] = position;
        position
    }
}
