//! Results of a run: `data.csv`, `run.json`, `summary.{md,csv,tex}`; written while it runs and read back.
//!
//! ```text
//! iteration ── Row ──┬─ RowWriter ──────── data.csv ──┐
//!                    └─ Rows ── Summary ── summary.*  ├─ ResultFolder::open ── Loaded ── compare, figures
//! RunRecord ────────────────────────────── run.json ──┘
//! ```
//!
//! The format is described in `docs/results.md`.

mod cells;
mod error;
mod finish;
mod folder;
mod parse;
mod read;
mod ready;
mod summary;
mod writer;

pub use cells::Header;
pub use error::FolderError;
pub use folder::{Finished, Overwrite, ResultFolder};
pub use writer::RowWriter;

pub use crate::loaded::Loaded;
pub use crate::record::{
    Bounded, ClockCounts, Clocks, Counts, FORMAT, HostRecord, ModelRecord, NetworkConfig, Placement,
    RunRecord, User, instant,
};
pub use crate::rows::{
    Column, LATENESS, Outcome, PUBLISHED, Row, RowRef, Rows, SKIPPED_STARTS, Units, published,
};
pub use crate::summary::{Quantity, Summary};

#[cfg(test)]
mod tests;
