//! Columns of `data.csv`, and the nodes of a tree that their values come from.

use std::collections::HashMap;

use peernet_logger::{IterationValues, Measure, Node, NodeId, NodeRole, Tree, Unit, stage};

use super::Column;

/// Column with the number of scheduled starts that an open loop skipped before this iteration, because the pipeline was
/// too far behind.
pub const SKIPPED_STARTS: &str = "skipped-starts";
/// Column of the time from the intended to the real start, in an open loop. This time is a part of `unattributed`.
pub const LATENESS: &str = "lateness";

/// Kind of the cells of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnKind {
    /// Value of a node of the tree.
    Node,
    /// Other number: a property of the iteration, such as its start time, or of a one-way delay, such as its bounds.
    Property,
    /// Text: the outcome with its reason, or the verdict and the source of a one-way delay.
    Text,
}

/// Number of columns of the paper's original program.
pub const PUBLISHED_COLUMN_COUNT: usize = 13;

/// Columns of every `data.csv`: first the columns of the paper's original program in their order, then the columns of
/// this program. After these columns, the file of a run has the columns of its further measurements.
pub const FIXED_COLUMNS: [(&str, ColumnKind); 47] = [
    ("iteration", ColumnKind::Property),
    ("sensing", ColumnKind::Node),
    ("upload", ColumnKind::Node),
    ("preprocessing", ColumnKind::Node),
    ("inference", ColumnKind::Node),
    ("postprocessing", ColumnKind::Node),
    ("download", ColumnKind::Node),
    ("download-bytes", ColumnKind::Node),
    ("download-logger-bytes", ColumnKind::Node),
    ("upload-bytes", ColumnKind::Node),
    ("upload-logger-bytes", ColumnKind::Node),
    ("upload-throughput", ColumnKind::Node),
    ("download-throughput", ColumnKind::Node),
    ("upload-raw", ColumnKind::Property),
    ("upload-lo", ColumnKind::Property),
    ("upload-hi", ColumnKind::Property),
    ("upload-verdict", ColumnKind::Text),
    ("upload-source", ColumnKind::Text),
    ("download-raw", ColumnKind::Property),
    ("download-lo", ColumnKind::Property),
    ("download-hi", ColumnKind::Property),
    ("download-verdict", ColumnKind::Text),
    ("download-source", ColumnKind::Text),
    ("upload-throughput-lo", ColumnKind::Node),
    ("upload-throughput-hi", ColumnKind::Node),
    ("download-throughput-lo", ColumnKind::Node),
    ("download-throughput-hi", ColumnKind::Node),
    ("capture", ColumnKind::Node),
    ("transform", ColumnKind::Node),
    ("encode", ColumnKind::Node),
    ("send-queue", ColumnKind::Node),
    ("queue", ColumnKind::Node),
    ("ipc", ColumnKind::Node),
    ("actuation", ColumnKind::Node),
    (SKIPPED_STARTS, ColumnKind::Node),
    (LATENESS, ColumnKind::Node),
    ("total", ColumnKind::Node),
    ("stages-total", ColumnKind::Node),
    ("unattributed", ColumnKind::Node),
    ("top-1", ColumnKind::Node),
    ("top-5", ColumnKind::Node),
    ("at", ColumnKind::Property),
    ("episode", ColumnKind::Property),
    ("step", ColumnKind::Property),
    ("warm-up", ColumnKind::Property),
    ("outcome", ColumnKind::Text),
    ("reason", ColumnKind::Text),
];

/// Returns the names of the columns of the paper's original program, in their order.
pub fn published_columns() -> impl Iterator<Item = &'static str> {
    FIXED_COLUMNS[..PUBLISHED_COLUMN_COUNT].iter().map(|(name, _)| *name)
}

/// Returns the stages of the paper's original program. Their sum is the *Total* of the paper.
pub fn published_stages() -> impl Iterator<Item = &'static str> {
    published_columns().filter(|name| stage::ORDER.iter().any(|stage| stage == name))
}

/// Returns the index of a column in [`FIXED_COLUMNS`]; `None` for a further column of a run.
fn fixed_index(name: &str) -> Option<usize> {
    FIXED_COLUMNS.iter().position(|(fixed, _)| *fixed == name)
}

/// Returns the name of a column. The name of a fixed column is not allocated.
pub fn column(name: &str) -> Column {
    fixed_index(name)
        .map_or_else(|| Column::Owned(name.to_owned()), |index| Column::Borrowed(FIXED_COLUMNS[index].0))
}

/// Returns every number of a tree with the name of its column. First come the fixed columns, in their order, then the
/// other columns, in the order in which they were logged.
///
/// The rules for names are those of the paper's original program: the names of nested nodes are joined with `_`, and
/// `_val` is appended for a node that has both a value and children. The fixed columns are exceptions, because their
/// names never change: the column is `sensing` and not `sensing_val`, although the node has children. The columns of
/// its children are `capture` and `transform`, not `sensing_capture` and `sensing_transform`.
pub(super) fn values(tree: &Tree) -> Vec<(Column, f64)> {
    TreeValues::from_tree(tree).values()
}

/// Measurements of a tree.
#[derive(Default)]
pub(super) struct TreeValues<'a> {
    /// Values of the names that have one value in each iteration, such as the names of stages.
    of_iteration: IterationValues,
    /// Columns and values of the bounds of throughputs. The bounds are in the node of their throughput.
    bounds: Vec<(&'static str, f64)>,
    /// Name, value and unit of each further column.
    further: Vec<(Column, f64, Unit)>,
    /// Number of children that were added so far, by parent and name.
    siblings: HashMap<(NodeId, &'a str), usize>,
}

impl<'a> TreeValues<'a> {
    pub(super) fn from_tree(tree: &'a Tree) -> Self {
        let mut tree_values = TreeValues::default();
        let mut prefixes: Vec<Column> = vec![Column::Borrowed(""); tree.nodes().len()];
        // The first node is the root, which has no column.
        for (id, node) in tree.iter().skip(1) {
            prefixes[id.index()] = tree_values.add_node(tree, id, node, &prefixes);
        }
        tree_values
    }

    pub(super) fn values(self) -> Vec<(Column, f64)> {
        let Self { of_iteration, bounds, further, .. } = self;
        let fixed = FIXED_COLUMNS.into_iter().filter_map(|(name, _)| {
            // If several nodes of one throughput have bounds, the bounds of the last node count.
            let bound = || bounds.iter().rev().find(|(column, _)| *column == name).map(|(_, bound)| *bound);
            Some((Column::Borrowed(name), of_iteration.get(name).or_else(bound)?))
        });
        fixed.chain(further.into_iter().map(|(name, value, _)| (name, value))).collect()
    }

    /// Returns the names and the units of the further columns.
    pub(super) fn units(&self) -> impl Iterator<Item = (&str, &Unit)> {
        self.further.iter().map(|(name, _, unit)| (name.as_ref(), unit))
    }

    /// Adds the value of a node. Returns the text with which the column names of the node's children begin. `prefixes`
    /// has these texts for the nodes that were added before.
    fn add_node(&mut self, tree: &Tree, id: NodeId, node: &'a Node, prefixes: &[Column]) -> Column {
        let parent = node.parent.unwrap_or(NodeId::ROOT);
        let value = node.measure.value().filter(|value| !value.is_nan());
        if let NodeRole::OfIteration(_) = self.of_iteration.add(id, node.parent, &node.name, value) {
            let name = column(&node.name);
            // A name that is owned has no fixed column, so its value gets a further column.
            if let (Column::Owned(name), Some(sum)) = (&name, self.of_iteration.get(&node.name)) {
                self.set_further(name, sum, node.measure.unit());
            }
            if let Measure::Throughput(rate) = &node.measure {
                self.set_bounds(&name, rate.bounds);
            }
            return name;
        }
        let occurrence = self.siblings.entry((parent, node.name.as_str())).or_default();
        *occurrence += 1;
        let mut label = match prefixes[parent.index()].as_ref() {
            "" => node.name.to_string(),
            prefix => format!("{prefix}_{}", node.name),
        };
        if *occurrence > 1 {
            label = format!("{label}_{occurrence}");
        }
        if let Some(value) = value {
            let name =
                if tree.children(id).next().is_some() { format!("{label}_val") } else { label.clone() };
            let name = self.unique_name(name);
            self.further.push((Column::Owned(name), value, node.measure.unit()));
        }
        Column::Owned(label)
    }

    /// Sets the value of a further column. A value that the column already has is replaced.
    fn set_further(&mut self, name: &str, value: f64, unit: Unit) {
        match self.further.iter_mut().find(|(other, ..)| other == name) {
            Some((_, previous, _)) => *previous = value,
            None => self.further.push((Column::Owned(name.to_owned()), value, unit)),
        }
    }

    /// Sets the columns with the bounds of a throughput.
    fn set_bounds(&mut self, name: &str, bounds: Option<(f64, f64)>) {
        let Some((lo, hi)) = bounds else { return };
        for (suffix, value) in [("lo", lo), ("hi", hi)] {
            if let Some(column) = fixed_index(&format!("{name}-{suffix}")) {
                self.bounds.push((FIXED_COLUMNS[column].0, value));
            }
        }
    }

    /// Returns the name. If another column of the row has the same name, a number is appended.
    fn unique_name(&self, name: String) -> String {
        let is_taken =
            |name: &str| fixed_index(name).is_some() || self.further.iter().any(|(other, ..)| other == name);
        if !is_taken(&name) {
            return name;
        }
        let mut numbered_names = (2..).map(|number| format!("{name}_{number}"));
        numbered_names.find(|name| !is_taken(name)).unwrap_or(name)
    }
}
