//! Figures: one drawing, as SVG and as PNG, legible at the width of one column.
//!
//! No system font is needed: the PNG's text is drawn with the font in `assets/`, and the SVG's stays text. What differs
//! by colour differs by mark, dash or hatch as well.

mod accuracy;
mod course;
mod histogram;
mod kit;
mod lengths;
mod paired;
mod scaling;
mod sharing;
mod stacked;
mod stage;

pub use accuracy::{Accuracy, Score};
pub use course::{Course, Line};
pub use histogram::{Bins, Histogram};
pub use kit::{DOWNLOAD, Drawn, Figure, FigureError, Fill, Hatch, INK, Mark, Paper, UPLOAD, Unit};
pub use lengths::{Lengths, would_squeeze};
pub use paired::{Group, MOST_GROUPS, MOST_SIDES, Paired};
pub use scaling::{Parts, Scaling, Series, Value};
pub use sharing::{MOST_CURVES, Sharing, SharingCurve, SharingPoint};
pub use stacked::{Bar, Stacked};
pub use stage::{UNATTRIBUTED, stage_fill, stage_line};

#[cfg(test)]
mod tests;
