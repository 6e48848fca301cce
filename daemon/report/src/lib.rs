//! What is made of measurements once they are there: lines fitted to them, figures, tables, studies.
//!
//! ```text
//! samples ── calibration (a study: fits, bounds, verdict) ─┬─ table   CSV, text, Markdown, LaTeX
//!                └─ fit, order                              ├─ figure  SVG, PNG
//! iterations ── rows ─┬─ loaded (record, rows) ── compare ──┘
//!                     └─ accuracy, trust, summary
//! ```
//!
//! Pure but for writing figures and tables: samples in, study out. Files of results are read and written by
//! `peernet-results`.

pub mod accuracy;
mod batches;
pub mod calibration;
pub mod compare;
mod error;
pub mod figure;
pub mod figures;
pub mod fit;
pub mod loaded;
pub mod order;
mod passage;
pub mod record;
pub mod rows;
mod run_trust_input;
pub mod sensor_study;
pub mod summary;
pub mod table;
#[cfg(test)]
mod testing;
pub mod trust;
pub mod users;

pub use error::WriteError;
pub use passage::Passage;
