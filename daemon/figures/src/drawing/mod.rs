//! Kinds of figures. Each kind lays out results of the analysis.
//!
//! Every kind is a type with a method `figure`, `plot` or `items`. The method returns a layout of `crate::plot`, which
//! both renderers can draw: on a page and in a file. Everything that differs by colour differs by mark, dash or hatch,
//! too. If a kind is drawn only on pages, its documentation says so. The values of such a kind are sketches and means,
//! because a page does not read single iterations.

mod binned;
mod cumulative;
mod histogram;
mod inline;
mod joint;
mod lengths;
mod paired;
mod quality;
mod quartiles;
mod scaling;
mod sharing;
mod stack;
mod stacked;
mod stage_bar;
mod stages_over_time;
mod time_series;

pub use crate::plot::Unit;
pub use binned::BinnedAxis;
pub(crate) use peernet_analysis::rows::is_plausible as is_drawable;

pub use cumulative::{Cumulative, CumulativeCurve};
pub use histogram::{Bins, CountNoun, Distribution, Histogram, View};
pub use inline::{meter, share_bar, sparkline};
pub use joint::Joint;
pub use lengths::Lengths;
pub use paired::{Group, MAX_GROUPS, MAX_PLACEMENTS, Paired};
pub use quality::{MAX_QUALITY_POINTS, QualityAgainstLatency, QualityPoint};
pub use quartiles::Quartiles;
pub use scaling::{Explanations, Scaling, Series, Value};
pub use sharing::{MAX_CURVES, Sharing, SharingCurve, SharingPoint};
pub use stack::{Orientation, Stack};
pub use stacked::{Bar, Stacked};
pub use stage_bar::{BarPlace, StageBar, StagePart};
pub use stages_over_time::{OverTimeAxes, StageBucket, StagesOverTime};
pub use time_series::{Line, TimeSeries};

#[cfg(test)]
mod tests;
