//! Results of a run: `data.csv`, `run.json`, `summary.{md,csv,tex}`; written while it runs and read back.
//!
//! ```text
//! iteration ── Row ──┬─ RowWriter ── data.csv ──┐
//!                    └─ Summary ─── summary.*   ├─ ResultFolder::open ── Loaded ── compare, figure
//! RunRecord ──────────────────────── run.json ──┘
//! ```
//!
//! The format is described in `docs/results.md`.

mod cells;
mod columns;
mod error;
mod finish;
mod folder;
mod parse;
mod read;
mod ready;
mod row;
mod run;
mod summary;
mod writer;

pub use columns::{PUBLISHED, published};
pub use error::FolderError;
pub use folder::{Finished, Loaded, Overwrite, ResultFolder};
pub use row::{Column, Outcome, Row};
pub use run::{ClockCounts, Clocks, Counts, FORMAT, HostRecord, ModelRecord, Placement, RunRecord, instant};
pub(crate) use summary::Scale;
pub use summary::{Quantity, Summary};
pub use writer::RowWriter;

#[cfg(test)]
mod tests;
