//! Positions of node names in the list of a batch.

use std::collections::HashMap;

use peernet_logger::{Measure, Name, Unit};

/// Key of a row of the table `name`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::write) struct NameKey {
    pub(in crate::write) text: Name,
    pub(in crate::write) kind: Name,
    /// `true` if the kind is custom.
    pub(in crate::write) custom: bool,
    pub(in crate::write) unit: Unit,
}

impl NameKey {
    fn new(name: &Name, measure: &Measure) -> Self {
        let custom = matches!(measure, Measure::Custom(..));
        Self { text: name.clone(), kind: measure.kind(), custom, unit: measure.unit() }
    }

    /// Returns whether this is the key of a node with this name and measure. Does not allocate the node's key.
    fn matches(&self, name: &Name, measure: &Measure) -> bool {
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
    /// Positions of the names of the previous tree, by node. Most trees have the same names as the previous tree.
    previous_tree: Vec<u32>,
}

impl LocalNames {
    /// Returns the position of the name of a node. `node` is the index of the node in its tree.
    pub(super) fn position(&mut self, node: usize, name: &Name, measure: &Measure) -> u32 {
        if let Some(position) = self.previous_tree.get(node)
            && self.list[*position as usize].matches(name, measure)
        {
            return *position;
        }
        let key = NameKey::new(name, measure);
        let position = *self.positions.entry(key).or_insert_with_key(|key| {
            self.list.push(key.clone());
            self.list.len() as u32 - 1
        });
        if self.previous_tree.len() <= node {
            self.previous_tree.resize(node + 1, position);
        }
        self.previous_tree[node] = position;
        position
    }
}
