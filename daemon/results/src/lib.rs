//! Files with the results of a run: `data.csv`, `run.json` and `summary.{md,csv,tex}`. The crate writes them and reads
//! them back.
//!
//! ```text
//! iteration ── Row ──┬─ RowWriter ──────── data.csv ──┐
//!                    └─ Rows ── Summary ── summary.*  ├─ ResultFolder::open ── Loaded ── compare, figures
//! RunRecord ────────────────────────────── run.json ──┘
//! ```
//!
//! The types are in `peernet_analysis`. `docs/results.md` describes the format.

mod cells;
mod error;
mod file_names;
mod finish;
mod folder;
mod parse;
mod preparation;
mod read;
pub mod summary;
mod writer;

pub use cells::Header;
pub use error::FolderError;
pub use file_names::{DATA, RECORD, SENSOR_STUDY};
pub use finish::WrittenResults;
pub use folder::ResultFolder;
pub use preparation::{Overwrite, remove_if_exists};
pub use writer::RowWriter;

#[cfg(test)]
#[path = "../../analysis/src/testing/iterations.rs"]
mod iterations;
#[cfg(test)]
mod tests;
