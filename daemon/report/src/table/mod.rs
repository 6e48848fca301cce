//! Tables: for programs as CSV, for people as text.

mod csv;
mod text;

pub(crate) use csv::csv;
pub use text::text;
