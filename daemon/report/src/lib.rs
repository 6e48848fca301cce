//! What is made of measurements once they are there: lines fitted to them, figures, tables, studies.
//!
//! ```text
//! samples ── calibration (a study: fits, bounds, verdict) ─┬─ table   CSV, text
//!                └─ fit, order                              └─ figure  SVG, PNG
//! ```
//!
//! Pure but for writing the files: samples in, study out.

pub mod calibration;
mod error;
pub mod figure;
pub mod fit;
pub mod number;
pub mod order;
pub mod table;

pub use error::WriteError;
