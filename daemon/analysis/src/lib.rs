//! Analysis of recorded iterations: fits, comparisons, verdicts, tables, studies.
//!
//! ```text
//! messages of `peernet calibrate` ── calibration (fits, bounds, verdict) ── table   CSV, text, Markdown, LaTeX
//!                                    └─ fit, order                           │
//! iterations ── rows ─┬─ loaded (record, rows) ── compare ──────────────────┘
//!                     └─ accuracy, deadline, trust, slowness, summary
//! ```
//!
//! Each question has one function. Pages, REST API and commands call the same function, so that their answers agree.
//! The function takes one plain value, such as [`compare::MeanEstimate`], [`trust::TrustInput`] or
//! [`slowness::Medians`]. `peernet-results` fills this value from rows, `peernet-store` from roll-ups. There is no
//! single value for all questions, because a page would then read the data of all questions to answer one question.
//!
//! Files contain every value, so medians and quantiles from files are exact; the quantiles of a sketch are within 1 %.
//! Medians from files have confidence intervals. Medians from roll-ups have none, because the bootstrap needs single
//! values.
//!
//! The only I/O is the writing of tables and of `calibration.json`, and the search for figure files
//! in a folder ([`figure_files`]). `peernet-results` reads and writes files of results, and
//! `peernet-figures` draws figures.

pub mod accuracy;
pub mod actuator_results;
pub mod answer_length;
mod batches;
pub mod calibration;
pub mod clock_points;
pub mod compare;
pub mod concurrent_edges;
pub mod deadline;
pub mod delays;
pub mod duration_estimates;
mod error;
pub mod figure_files;
pub mod fit;
pub mod loaded;
pub mod message_sizes;
pub mod model_places;
pub mod offset_trend;
pub mod order;
pub mod outcomes;
pub mod pace;
pub mod payload_study;
pub mod quality;
pub mod record;
pub mod rows;
pub mod run_selection;
mod run_trust_input;
pub mod sensor_study;
pub mod slowness;
pub mod stage_split;
pub mod standstill;
pub mod summary;
pub mod table;
#[cfg(test)]
mod testing;
pub mod total_column;
pub mod transfer;
pub mod trust;
pub mod unaccounted_time;
pub mod users;
pub mod warm_up;

pub use error::{WriteError, write_file};
