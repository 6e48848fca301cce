//! Kinds of figures: the layout of the results of the analysis.
//!
//! Every kind is a value with a method `figure` (or `plot`, or `items`) that makes a layout of `crate::plot`; both sheets draw it.
//! Everything that differs by colour differs by mark, dash or hatch as well. [`Distribution`], [`Stack`], [`cells`] and [`scaling_line`]
//! are for pages too.

mod accuracy;
mod course;
mod cumulative;
mod histogram;
mod lengths;
mod paired;
mod scaling;
mod sharing;
mod stack;
mod stacked;

pub use crate::plot::Unit;
pub use accuracy::{Accuracy, Score};
pub use course::{Course, Line};
pub use cumulative::{Cumulative, CumulativeCurve};
pub use histogram::{Bins, Distribution, Histogram, View};
pub use lengths::{Lengths, cells, would_squeeze};
pub use paired::{Group, MOST_GROUPS, MOST_SIDES, Paired};
pub use scaling::{Parts, Scaling, Series, Value, line as scaling_line};
pub use sharing::{MOST_CURVES, Sharing, SharingCurve, SharingPoint};
pub use stack::{Direction, Stack};
pub use stacked::{Bar, Stacked};

#[cfg(test)]
mod tests;
