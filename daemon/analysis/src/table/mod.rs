//! Tables: for programs as CSV, for people as text, Markdown and LaTeX.

mod csv;
mod latex;
mod markdown;
mod text;

pub use csv::csv_text;
pub(crate) use csv::write_csv;
pub use latex::escape as latex_escape;
pub use text::text;

use peernet_statistics::number::decimals;

/// Returns the number of decimals of a column. The number that is closest to zero, but not zero, has three significant
/// digits. If the numbers differ much, this rule would give very many decimals. There are therefore at most two
/// decimals more than the largest number needs for three digits.
pub fn decimals_of(values: impl Iterator<Item = f64>) -> usize {
    let (mut needed, mut largest) = (0, 0.0_f64);
    for value in values.filter(|value| value.is_finite() && *value != 0.0) {
        needed = needed.max(decimals(value, 3));
        largest = largest.max(value.abs());
    }
    needed.min(decimals(largest, 3) + 2)
}

/// Table: rows of cells under a header.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Table {
    /// Titles of the columns.
    pub header: Vec<String>,
    /// Number of columns from the left that are text and aligned left. The other columns are numbers and aligned right.
    pub label_columns: usize,
    /// Rows with as many cells as the header.
    pub rows: Vec<Vec<String>>,
    /// Marked cell, such as the smallest mean: the index of the row and the index of the column.
    pub marked: Option<(usize, usize)>,
}

impl Table {
    /// Returns the text for a terminal: columns as wide as their longest cell; an asterisk follows the marked cell.
    pub fn text(&self) -> String {
        text::table(self)
    }

    /// Returns Markdown as GitHub and most other programs read it; the marked cell is bold.
    pub fn markdown(&self) -> String {
        markdown::table(self)
    }

    /// Returns LaTeX for the package `booktabs`, with everything escaped; the marked cell is bold.
    pub fn latex(&self, caption: &str) -> String {
        latex::table(self, caption)
    }
}

/// Table with a title above it and explanations below it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CaptionedTable {
    pub(crate) heading: String,
    pub(crate) table: Table,
    pub(crate) notes: String,
}

impl CaptionedTable {
    /// Returns the text for a terminal.
    pub fn text(&self) -> String {
        format!("{}\n\n{}\n\n{}", self.heading, self.table.text(), self.notes)
    }

    /// Returns Markdown.
    pub fn markdown(&self) -> String {
        format!("{}\n\n{}\n{}\n", self.heading, self.table.markdown(), self.notes)
    }

    /// Returns LaTeX for the package booktabs.
    pub fn latex(&self) -> String {
        self.table.latex(&format!("{} {}", self.heading, self.notes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn column_has_equal_decimals() {
        assert_eq!(decimals_of([0.000_34, 6.5].into_iter()), 4, "shown as 0.0003 and 6.5000");
        assert_eq!(decimals_of([0.041_8, 0.394].into_iter()), 4);
        assert_eq!(decimals_of([640.1, 16.2, 0.0, f64::INFINITY].into_iter()), 1);
    }
}
