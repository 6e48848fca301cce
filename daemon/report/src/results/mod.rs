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
mod columns;
mod error;
mod finish;
mod folder;
mod parse;
mod read;
mod ready;
mod row;
mod rows;
mod run;
mod summary;
mod units;
mod whole;
mod writer;

pub use cells::Header;
pub use columns::{LATENESS, PUBLISHED, SKIPPED_STARTS, published};
pub use error::FolderError;
pub use folder::{Finished, Loaded, Overwrite, ResultFolder};
pub use row::{Column, Outcome, Row};
pub use rows::{RowRef, Rows};
pub use run::{
    Bounded, ClockCounts, Clocks, Counts, FORMAT, HostRecord, ModelRecord, NetworkConfig, Placement,
    RunRecord, User, instant,
};
pub(crate) use summary::Scale;
pub use summary::{Quantity, Summary};
pub use units::Units;
pub use writer::RowWriter;

#[cfg(test)]
mod tests;
