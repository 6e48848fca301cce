//! Figures of the results of `peernet-analysis`, drawn for pages and files.
//!
//! ```text
//! Loaded, Loaded, … ── of_results ─────┐
//! Study ────────────── of_calibration ─┴─ drawing ── SVG, PNG, PDF, text
//! ```
//!
//! `of_results` decides which figures a run (`Loaded`) or an experiment has. `of_calibration` decides which figures the
//! calibration of a link (`Study`) has. Both use `of_messages` for the figures of delay against the size of messages.
//! `drawing` defines the layout of all figures.

pub mod drawing;
pub mod look;
mod of_calibration;
mod of_messages;
mod of_results;
pub mod plot;
pub mod render;
pub mod scale;
pub mod svg;
pub mod text;

pub use of_calibration::draw_calibration;
pub use of_messages::payload_figures;
pub use of_results::{Columns, Kind, MissingData, PlotError, WrittenFigures, draw, of_experiment, of_run};
