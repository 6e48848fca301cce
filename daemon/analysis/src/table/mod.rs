//! Tables: for programs as CSV, for people as text, Markdown and LaTeX.

mod csv;
mod latex;
mod markdown;
mod text;

pub(crate) use csv::csv;
pub use csv::csv_text;
pub use latex::escape as latex_escape;
pub use text::text;

/// Cells under a header.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Table {
    /// What the columns are.
    pub header: Vec<String>,
    /// How many columns from the left are text and stand to the left; the others are figures and stand to the right.
    pub labels: usize,
    /// Rows of as many cells as the header has.
    pub rows: Vec<Vec<String>>,
    /// Rows to be marked, as the best one.
    pub marked: Vec<usize>,
}

impl Table {
    /// For the terminal: columns as wide as their longest cell; marked rows end with an asterisk.
    pub fn text(&self) -> String {
        text::table(self)
    }

    /// As GitHub and most others read it; marked rows are bold.
    pub fn markdown(&self) -> String {
        markdown::table(self)
    }

    /// For the package `booktabs`, everything escaped; marked rows are bold.
    pub fn latex(&self, caption: &str) -> String {
        latex::table(self, caption)
    }
}

/// A table between what it is and what it means.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Captioned {
    pub(crate) heading: String,
    pub(crate) table: Table,
    pub(crate) notes: String,
}

impl Captioned {
    /// For the terminal.
    pub fn text(&self) -> String {
        format!("{}\n\n{}\n\n{}", self.heading, self.table.text(), self.notes)
    }

    /// For documents.
    pub fn markdown(&self) -> String {
        format!("{}\n\n{}\n{}\n", self.heading, self.table.markdown(), self.notes)
    }

    /// For papers, with booktabs.
    pub fn latex(&self) -> String {
        self.table.latex(&format!("{} {}", self.heading, self.notes))
    }
}
