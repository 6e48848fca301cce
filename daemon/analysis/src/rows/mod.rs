//! The rows of a run as columns.
//!
//! ```text
//! iteration ── Row ── Rows ── RowRef
//! ```
//!
//! A [`Row`] is made from an iteration. [`Rows`] stores the numbers of many rows by column. A [`RowRef`] refers to one
//! of the stored rows.

mod chunks;
mod columns;
mod numbers;
mod row;
mod row_ref;
#[cfg(test)]
mod tests;
mod units;

pub use columns::{
    ColumnKind, FIXED_COLUMNS, LATENESS, PUBLISHED_COLUMN_COUNT, SKIPPED_STARTS, column, published_columns,
    published_stages,
};
pub(crate) use row::judged_delay;
pub use row::{Column, Outcome, Row};
pub use row_ref::RowRef;
pub use units::Units;

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use peernet_clock::{DelaySource, Verdict};

use chunks::Chunks;
use numbers::Numbers;

/// Iterations of a run, in order. Each iteration takes about 150 bytes of memory, whereas a [`Row`] takes more than a
/// thousand.
///
/// No number is rounded: every row comes out exactly as it was appended.
#[derive(Clone)]
pub struct Rows {
    names: Vec<Column>,
    /// Index of each column in `names` and `numbers`.
    column_indexes: HashMap<Column, usize>,
    /// Columns of numbers, in the order of `names`. Each column is as long as `outcomes`.
    numbers: Vec<Numbers>,
    /// Outcome of each iteration, and whether it is warm-up.
    outcomes: Chunks<(Outcome, bool)>,
    /// Verdicts on the delays, upload and download.
    verdicts: [Chunks<Option<JudgedDelay>>; 2],
    /// Index and reason of each row that has a reason, in order. Consecutive equal reasons share their text.
    reasons: Vec<(usize, Arc<str>)>,
    /// Memory of the last row that was appended. The next row uses this memory instead of allocating.
    builder: RowBuilder,
}

/// Column of the flag for warm-up. It is stored with the outcomes, because every statistic reads both.
const WARM_UP: &str = "warm-up";

/// Magnitude above which a number cannot have been measured: a year is 3·10⁷ s, and the fastest links carry 10¹⁵ bit/s.
const MAX_MAGNITUDE: f64 = 1e18;

/// Returns whether a number can have been measured. Figures leave out all numbers that are not plausible.
pub fn is_plausible(value: f64) -> bool {
    value.abs() <= MAX_MAGNITUDE
}

/// Verdict on a delay, and the source of the clock relation that corrected the delay.
pub type JudgedDelay = (Verdict, DelaySource);

/// Row that is built cell by cell: its numbers by the index of their column, and its other values.
#[derive(Clone, Debug, Default)]
pub struct RowBuilder {
    /// Number of each column, at the index from [`RowBuilder::column_index`]; `None` for a missing number.
    pub numbers: Vec<Option<f64>>,
    /// Outcome of the iteration; `None` stands for [`Outcome::Ok`].
    pub outcome: Option<Outcome>,
    /// True if the iteration is warm-up, which is excluded from statistics.
    pub warm_up: bool,
    /// Reason for a missing answer, if one was reported.
    pub reason: Option<String>,
    /// Verdicts on the delays, upload and download.
    pub verdicts: [Option<JudgedDelay>; 2],
}

impl Default for Rows {
    fn default() -> Self {
        let mut rows = Self {
            names: Vec::new(),
            column_indexes: HashMap::new(),
            numbers: Vec::new(),
            outcomes: Chunks::default(),
            verdicts: [Chunks::default(), Chunks::default()],
            reasons: Vec::new(),
            builder: RowBuilder::default(),
        };
        for (name, _) in FIXED_COLUMNS {
            rows.column_index(&Column::Borrowed(name));
        }
        rows
    }
}

impl Rows {
    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        self.outcomes.len()
    }

    /// Returns whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Appends a row.
    pub fn push(&mut self, row: &Row) {
        let mut builder = self.build_row();
        for (name, kind) in FIXED_COLUMNS {
            // The numbers of nodes are in `row.values`. The flag for warm-up is stored with the outcomes.
            if kind != ColumnKind::Node && name != WARM_UP {
                builder.numbers[self.column_indexes[name]] = row.value(name);
            }
        }
        for (name, value) in &row.values {
            // If two values have the same name, the first value is used.
            let index = builder.column_index(self, name);
            builder.numbers[index] = builder.numbers[index].or(Some(*value));
        }
        (builder.outcome, builder.warm_up) = (Some(row.outcome), row.warm_up);
        builder.reason.clone_from(&row.reason);
        builder.verdicts =
            [row.upload, row.download].map(|delay| delay.map(|delay| (delay.verdict, delay.source)));
        self.push_built(builder);
    }

    /// Returns an empty row. The caller fills it and passes it to [`Self::push_built`].
    pub fn build_row(&mut self) -> RowBuilder {
        let mut builder = std::mem::take(&mut self.builder);
        builder.numbers.clear();
        builder.numbers.resize(self.names.len(), None);
        RowBuilder { numbers: builder.numbers, ..RowBuilder::default() }
    }

    /// Appends a row that was built.
    pub fn push_built(&mut self, mut builder: RowBuilder) {
        for (numbers, number) in self.numbers.iter_mut().zip(&builder.numbers) {
            numbers.push(*number);
        }
        if let Some(reason) = builder.reason.take() {
            // A broken connection gives many iterations in succession the same reason.
            let previous = self.reasons.last().map(|(_, previous)| previous);
            let same_reason = previous.filter(|previous| ***previous == *reason);
            let reason = same_reason.map_or_else(|| Arc::from(reason), Arc::clone);
            self.reasons.push((self.outcomes.len(), reason));
        }
        self.verdicts.iter_mut().zip(builder.verdicts).for_each(|(verdicts, verdict)| verdicts.push(verdict));
        self.outcomes.push((builder.outcome.unwrap_or(Outcome::Ok), builder.warm_up));
        self.builder = builder;
    }

    /// Returns the index of a column. If no column has this name, the column is appended.
    fn column_index(&mut self, name: &Column) -> usize {
        if let Some(index) = self.column_indexes.get(name) {
            return *index;
        }
        self.numbers.push(Numbers::missing(self.outcomes.len()));
        self.column_indexes.insert(name.clone(), self.names.len());
        self.names.push(name.clone());
        self.names.len() - 1
    }

    /// Returns the names of the columns: first the fixed columns, which every `data.csv` has, then the
    /// further columns of this run.
    pub fn names(&self) -> &[Column] {
        &self.names
    }

    /// Returns the columns that a name may stand for: the column with this name, or else the columns of all nodes with
    /// this name. The column of a node begins with the names of the node's parents (`inference_output-chunks` for
    /// `output-chunks`).
    pub fn columns_named(&self, name: &str) -> Vec<&str> {
        let names = || self.names.iter().map(|column| &**column);
        if let Some(exact) = names().find(|column| *column == name) {
            return vec![exact];
        }
        let is_node = |column: &&str| column.strip_suffix(name).is_some_and(|parents| parents.ends_with('_'));
        names().filter(is_node).collect()
    }

    /// Returns the names of the columns that have a number in at least one row that is in the statistics.
    pub fn columns_in_statistics(&self) -> impl Iterator<Item = &str> + Clone {
        let names = self.names.iter().map(|name| &**name);
        names.filter(move |name| self.values_in_statistics(name).next().is_some())
    }

    /// Returns the rows, in order.
    pub fn iter(&self) -> Iter<'_> {
        Iter { rows: self, indexes: 0..self.len() }
    }

    /// Returns a row by its index, from 0.
    pub fn get(&self, index: usize) -> Option<RowRef<'_>> {
        (index < self.len()).then(|| RowRef::new(self, index))
    }

    /// Returns the last row.
    pub fn last(&self) -> Option<RowRef<'_>> {
        self.iter().next_back()
    }

    /// Returns the numbers of a column in the rows that are in the statistics, in order.
    pub fn values_in_statistics(&self, column: &str) -> impl Iterator<Item = f64> + Clone {
        let index = self.column_indexes.get(column);
        let numbers = index.map(|index| &self.numbers[*index]);
        let in_statistics = self.iter().filter(|row| row.is_in_statistics());
        numbers
            .into_iter()
            .flat_map(move |numbers| in_statistics.clone().filter_map(|row| numbers.get(row.index())))
    }
}

#[cfg(test)]
impl Rows {
    /// Applies `change` to every row.
    pub(crate) fn change(&mut self, mut change: impl FnMut(&mut Row)) {
        let changed = self.iter().map(|row| {
            let mut row = row.to_row();
            change(&mut row);
            row
        });
        *self = changed.collect();
    }
}

impl RowBuilder {
    /// Returns the index of a column in `rows`, to which this row will be appended. If no column has this name, the
    /// column is added.
    pub fn column_index(&mut self, rows: &mut Rows, name: &Column) -> usize {
        let index = rows.column_index(name);
        self.numbers.resize(rows.names.len(), None);
        index
    }
}

/// The rows of a run, in order.
#[derive(Clone)]
pub struct Iter<'a> {
    rows: &'a Rows,
    indexes: Range<usize>,
}

impl<'a> Iterator for Iter<'a> {
    type Item = RowRef<'a>;

    fn next(&mut self) -> Option<Self::Item> {
        self.indexes.next().map(|index| RowRef::new(self.rows, index))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.indexes.size_hint()
    }
}

impl DoubleEndedIterator for Iter<'_> {
    fn next_back(&mut self) -> Option<Self::Item> {
        self.indexes.next_back().map(|index| RowRef::new(self.rows, index))
    }
}

impl ExactSizeIterator for Iter<'_> {}

impl<'a> IntoIterator for &'a Rows {
    type Item = RowRef<'a>;
    type IntoIter = Iter<'a>;

    fn into_iter(self) -> Iter<'a> {
        self.iter()
    }
}

impl Extend<Row> for Rows {
    fn extend<I: IntoIterator<Item = Row>>(&mut self, rows: I) {
        rows.into_iter().for_each(|row| self.push(&row));
    }
}

impl FromIterator<Row> for Rows {
    fn from_iter<I: IntoIterator<Item = Row>>(rows: I) -> Self {
        let mut appended = Self::default();
        appended.extend(rows);
        appended
    }
}

impl PartialEq for Rows {
    /// Returns whether both contain the same rows. The columns with numbers must have the same
    /// order, but their memory format may differ.
    fn eq(&self, other: &Self) -> bool {
        self.len() == other.len() && self.iter().zip(other.iter()).all(|(a, b)| a.to_row() == b.to_row())
    }
}

impl std::fmt::Debug for Rows {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.iter().map(RowRef::to_row)).finish()
    }
}
