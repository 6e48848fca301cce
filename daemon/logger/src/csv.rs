//! Trees as a CSV table: one row per iteration, one column per path of names.
//!
//! The format follows the paper's program. The first column is `iteration`. The column of a child of the root has the
//! name of the node. The column of a deeper node has the names of its ancestors and its own name, joined with `_`. If a
//! node has both a value and children, `_val` is appended. Columns are in the order in which nodes were logged. Values
//! are seconds, bytes and bits per second as plain numbers. A cell is empty if the iteration has no such node or if its
//! value is unknown.
//!
//! Later iterations may have nodes that earlier iterations do not have. A first pass over the trees therefore collects
//! the columns, and a second pass writes the rows, so that memory does not grow with the number of rows.

mod reading_rules;

pub use reading_rules::{PUBLISHED_WARM_UP_ROWS, column_name, ends_with_line, is_warm_up};

use std::collections::{HashMap, HashSet};
use std::io;

use crate::{Name, NodeId, Tree};

/// Name of the first column.
const ITERATION: &str = "iteration";

/// Writes a whole table. Iterates over `rows` twice.
///
/// ```
/// # use std::sync::Arc;
/// # use peernet_clock::{ClockIdentity, ManualClock, Span, WallTime};
/// # use peernet_logger::{HostId, Recorder, Unit, csv, stage};
/// # let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("b", "c")));
/// # let mut log = Recorder::new(clock.clone(), HostId::random());
/// # log.record_value(stage::UPLOAD_BYTES, 150_000.0, Unit::BYTES);
/// # let tree = log.finish();
/// let mut table = Vec::new();
/// csv::write(&mut table, [(1, &tree), (2, &tree)]).unwrap();
/// assert_eq!(String::from_utf8(table).unwrap(), "iteration,upload-bytes\n1,150000\n2,150000\n");
/// ```
///
/// # Errors
/// If writing to `out` fails.
pub fn write<'a, R>(out: impl io::Write, rows: R) -> io::Result<()>
where
    R: IntoIterator<Item = (u64, &'a Tree), IntoIter: Clone>,
{
    let rows = rows.into_iter();
    let mut columns = Columns::new();
    rows.clone().for_each(|(_, tree)| columns.add(tree));
    let mut table = Table::new(out, columns)?;
    for (iteration, tree) in rows {
        table.write_row(iteration, tree)?;
    }
    table.finish()
}

/// The columns of a table: the paths of the nodes of all trees that were added.
#[derive(Clone, Debug, Default)]
pub struct Columns {
    /// Index of each path segment in `segments`, by the index of its parent, its name, and its number among the
    /// siblings of this name, from 1.
    segment_indices: HashMap<(Option<usize>, Name, usize), usize>,
    segments: Vec<Segment>,
    /// Indices of all segments in the order of their columns.
    order: Vec<usize>,
}

/// The last name of a path, with a link to the path of the parent.
#[derive(Clone, Debug)]
struct Segment {
    /// Index of the parent's segment; `None` for children of the root.
    parent: Option<usize>,
    /// Name of the node. Of several siblings with the same name, the second gets the suffix `_2`, the third `_3`.
    label: String,
    has_value: bool,
    has_children: bool,
}

impl Columns {
    /// Creates columns with `iteration` only.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds columns for all nodes of a tree.
    pub fn add(&mut self, tree: &Tree) {
        let mut next_position = 0;
        let mut siblings = Siblings::default();
        let mut segment_of_node: Vec<Option<usize>> = vec![None; tree.nodes().len()];
        for (id, node) in tree.iter().skip(1) {
            let Some(parent) = parent_segment(tree, id, &segment_of_node) else { continue };
            let occurrence = siblings.count_occurrence(parent, &node.name);
            let key = (parent, node.name.clone(), occurrence);
            let new_index = self.segments.len();
            let index = *self.segment_indices.entry(key).or_insert(new_index);
            if index == new_index {
                self.insert(parent, &node.name, occurrence, next_position);
            }
            // A new column follows the column of the previous node of this tree.
            next_position = self
                .order
                .iter()
                .position(|other| *other == index)
                .map_or(next_position, |position| position + 1);
            self.segments[index].has_value |= has_value(tree, id);
            if let Some(parent) = parent {
                self.segments[parent].has_children = true;
            }
            segment_of_node[id.index()] = Some(index);
        }
    }

    fn insert(&mut self, parent: Option<usize>, name: &Name, occurrence: usize, position: usize) {
        let label = if occurrence == 1 { name.to_string() } else { format!("{name}_{occurrence}") };
        self.order.insert(position, self.segments.len());
        self.segments.push(Segment { parent, label, has_value: false, has_children: false });
    }

    /// Returns the columns after `iteration`: the index of the segment and the unique name of each.
    fn headers(&self) -> Vec<(usize, String)> {
        // Different paths can give the same text when they are joined with `_`, but columns need unique names.
        let mut used_headers = HashSet::from([ITERATION.to_owned()]);
        let segments_with_value = self.order.iter().copied().filter(|index| self.segments[*index].has_value);
        segments_with_value
            .map(|index| {
                let segment = &self.segments[index];
                let mut labels = vec![segment.label.as_str()];
                let mut ancestor = segment.parent;
                while let Some(parent) = ancestor {
                    labels.push(&self.segments[parent].label);
                    ancestor = self.segments[parent].parent;
                }
                labels.reverse();
                let mut path = labels.join("_");
                if segment.has_children {
                    // The suffix is that of the program that was published with the paper.
                    path.push_str("_val");
                }
                let mut header = path.clone();
                let mut number = 2;
                while !used_headers.insert(header.clone()) {
                    header = format!("{path}_{number}");
                    number += 1;
                }
                (index, header)
            })
            .collect()
    }
}

/// Returns the segment of a node's parent. The inner value is `None` if the parent is the root, which has no segment.
/// The result is `None` if the node has no parent, or if its parent has no segment and is not the root.
fn parent_segment(tree: &Tree, id: NodeId, segment_of_node: &[Option<usize>]) -> Option<Option<usize>> {
    match tree.get(id)?.parent? {
        NodeId::ROOT => Some(None),
        parent => segment_of_node[parent.index()].map(Some),
    }
}

/// Number of nodes of a tree that were seen so far, by segment of the parent and by name.
#[derive(Default)]
struct Siblings<'a>(HashMap<(Option<usize>, &'a Name), usize>);

impl<'a> Siblings<'a> {
    fn count_occurrence(&mut self, parent: Option<usize>, name: &'a Name) -> usize {
        let count = self.0.entry((parent, name)).or_default();
        *count += 1;
        *count
    }
}

fn has_value(tree: &Tree, id: NodeId) -> bool {
    tree.get(id).is_some_and(|node| !matches!(node.measure, crate::Measure::Container))
}

/// A table with fixed columns that is written row by row.
#[derive(Debug)]
pub struct Table<W: io::Write> {
    out: ::csv::Writer<W>,
    columns: Columns,
    /// Position of each segment's column.
    column_of_segment: HashMap<usize, usize>,
    cells: Vec<String>,
}

impl<W: io::Write> Table<W> {
    /// Creates a table and writes its header.
    ///
    /// # Errors
    /// If writing to `out` fails.
    pub fn new(out: W, columns: Columns) -> io::Result<Self> {
        let headers = columns.headers();
        let mut out = ::csv::Writer::from_writer(out);
        out.write_record(
            std::iter::once(ITERATION).chain(headers.iter().map(|(_, header)| header.as_str())),
        )?;
        let column_of_segment =
            headers.iter().enumerate().map(|(column, (segment, _))| (*segment, column)).collect();
        Ok(Self { out, columns, column_of_segment, cells: vec![String::new(); headers.len()] })
    }

    /// Writes the row of an iteration. Nodes without a column are left out: add the tree to the [`Columns`] first.
    ///
    /// # Errors
    /// If writing to `out` fails.
    pub fn write_row(&mut self, iteration: u64, tree: &Tree) -> io::Result<()> {
        self.cells.iter_mut().for_each(String::clear);
        let mut siblings = Siblings::default();
        let mut segment_of_node: Vec<Option<usize>> = vec![None; tree.nodes().len()];
        for (id, node) in tree.iter().skip(1) {
            let Some(parent) = parent_segment(tree, id, &segment_of_node) else { continue };
            let key = (parent, node.name.clone(), siblings.count_occurrence(parent, &node.name));
            // A node has no column if its tree was not added to the columns.
            let Some(index) = self.columns.segment_indices.get(&key) else { continue };
            segment_of_node[id.index()] = Some(*index);
            if let (Some(column), Some(value)) = (self.column_of_segment.get(index), node.measure.value()) {
                self.cells[*column] = value.to_string();
            }
        }
        let iteration = iteration.to_string();
        let cells = self.cells.iter().map(String::as_str);
        Ok(self.out.write_record(std::iter::once(iteration.as_str()).chain(cells))?)
    }

    /// Writes buffered rows to `out`.
    ///
    /// # Errors
    /// If writing to `out` fails.
    pub fn finish(mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests;
