//! Static pictures: SVG from the server, present at first paint, printable.
//!
//! Geometry is computed here and written by templates. Lengths are percent, so that a picture grows with its panel and no style attribute
//! is needed: the content security policy forbids inline styles.

mod axis;
mod bar;
mod boxes;
mod cloud;
mod course;
mod fit;
mod histogram;
mod horizontal;
mod lengths;
mod meter;
pub(crate) mod pen;
mod ruler;
mod scatter;
mod small;
mod spark;
mod tracks;
mod waterfall;

use std::fmt;

pub(crate) use axis::{Axis, Scale};
pub(crate) use bar::{Bar, Part, ShareBar};
pub(crate) use boxes::{BoxPlot, BoxStatistics};
pub(crate) use course::{CourseAxes, CourseBucket, CourseData, CoursePlot};
pub(crate) use histogram::{DistributionView, HistogramPlot, shown_in};
pub(crate) use horizontal::Horizontal;
pub(crate) use lengths::{LengthAxis, LengthPlot, LengthValues};
pub(crate) use meter::Meter;
pub(crate) use ruler::Ruler;
pub(crate) use scatter::{Scatter, ScatterLine, ScatterPoint, ScatterSeries};
pub(crate) use small::{SmallAxis, SmallHistogram};
pub(crate) use spark::Spark;
pub(crate) use tracks::{Gap, RailSign, Segment, Strip, Track, Tracks};
pub(crate) use waterfall::{LaneDiagram, WaterfallRow};

/// A position or length along an axis, in percent of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub(crate) struct Percent(pub f64);

impl fmt::Display for Percent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3}%", self.0)
    }
}

impl askama::filters::HtmlSafe for Percent {}
