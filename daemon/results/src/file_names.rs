//! The names of the files in a folder of results.

/// The rows.
pub(crate) const DATA: &str = "data.csv";
/// Everything but the rows.
pub(crate) const RECORD: &str = "run.json";
/// The summary.
pub(crate) const SUMMARIES: [&str; 3] = ["summary.md", "summary.csv", "summary.tex"];
