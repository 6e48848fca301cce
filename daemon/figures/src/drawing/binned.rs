//! Distributions of sketches on an axis that several of them share. Pages have them.

use peernet_statistics::Summary;

use super::lengths::would_squeeze;
use crate::look::{Stage, Style};
use crate::plot::{At, Axis, Item, Unit};
use crate::scale::Scale;

/// Bins between the ends of the values.
const BINS: u32 = 48;
/// Quantile above which values are only counted, so that one straggler does not compress all others into a corner.
const ENDS_AT: f64 = 0.99;
/// Share of its length by which the axis extends beyond that quantile. A largest value that is at most [`WORTH`] times this length is not
/// a straggler.
const MARGIN: f64 = 0.1;
const WORTH: f64 = 1.5;
/// Margin on both sides of values that lie far from zero, as a share of their range.
const ROOM: f64 = 0.05;
/// Ends within this share of each other are one end.
const ROUNDING: f64 = 1e-9;
/// Smallest value, as a share of the largest, that is not taken as zero. Without this limit such a value would make the axis logarithmic.
const NOTHING: f64 = 1e-12;
/// Marks on the axis.
const MARKS: usize = 5;

/// Axis of a quantity with its bins.
#[derive(Clone, Debug, PartialEq)]
pub struct BinnedAxis {
    /// Quantity and unit.
    pub unit: Unit,
    /// Scale, in the unit that is shown.
    pub scale: Scale,
    /// Edges of the bins between the ends of the values, in the unit that is shown.
    edges: Vec<f64>,
}

impl BinnedAxis {
    /// Returns an axis from the smallest of all values to the largest, or to a little above the largest 99th percentile if stragglers lie
    /// far beyond it. It is logarithmic if that is more than a decade. `None` without values.
    pub fn around<'a>(all: impl Iterator<Item = &'a Summary>, unit: Unit) -> Option<Self> {
        let ends = Self::ends(all, &unit)?;
        Some(Self::new(unit, Self::between(ends), ends))
    }

    /// Returns the same axis from zero, except if zero would squeeze all values, if they span more than a decade, or if the smallest is
    /// negative.
    pub fn from_zero<'a>(all: impl Iterator<Item = &'a Summary>, unit: Unit) -> Option<Self> {
        let (lo, hi) = Self::ends(all, &unit)?;
        let room = (hi - lo) * ROOM;
        let scale = if lo < 0.0 {
            Self::between((lo, hi.max(0.0)))
        } else if would_squeeze(lo, hi) {
            Self::between((lo - room, hi + room))
        } else {
            Scale::of_sizes([lo, hi].into_iter())
        };
        Some(Self::new(unit, scale, (lo, hi)))
    }

    fn new(unit: Unit, scale: Scale, (lo, hi): (f64, f64)) -> Self {
        let edge = |at: u32| scale.between(lo, hi, f64::from(at) / f64::from(BINS));
        Self { unit, scale, edges: (0..=BINS).map(edge).collect() }
    }

    fn between(ends: (f64, f64)) -> Scale {
        Scale::decades(ends).unwrap_or_else(|| Scale::linear(ends).widened(MARKS))
    }

    /// Returns the ends of the values that are shown.
    fn ends<'a>(all: impl Iterator<Item = &'a Summary>, unit: &Unit) -> Option<(f64, f64)> {
        let ends = |known: &Summary| {
            let (typical, most, least) = (known.quantile(ENDS_AT)?, known.moments.max, known.moments.min);
            let lo = if least.abs() < typical.abs() * NOTHING { 0.0 } else { least };
            let spread = Scale::decades((lo, typical)).unwrap_or(Scale::linear((lo, typical)));
            let beyond = |share: f64| spread.between(lo, typical, share);
            let hi = if most <= beyond(WORTH) { most } else { beyond(1.0 + MARGIN).min(most) };
            Some((lo * unit.per_si, hi * unit.per_si))
        };
        let (lo, hi) = all.filter_map(ends).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        // If all values are equal, the bins get a width that can be drawn.
        Some((lo, if hi > lo { hi } else { lo + lo.abs().max(1e-6) * 0.01 }))
    }

    /// Returns the axis of a plot.
    pub fn axis(&self) -> Axis {
        self.unit.axis(self.scale).with_grid()
    }

    /// Returns the largest value that has a place on the axis, in the unit that is measured.
    pub fn end(&self) -> f64 {
        self.edges.last().map_or(f64::INFINITY, |end| (end + end.abs() * ROUNDING) / self.unit.per_si)
    }

    /// Returns the place of a measured value; `None` beyond the end.
    pub fn at(&self, value: f64) -> Option<f64> {
        (value <= self.end()).then(|| self.scale.at(value * self.unit.per_si))
    }

    /// Returns the number of values beyond the end.
    pub fn beyond(&self, values: &Summary) -> u64 {
        let inside = values.fraction_below(self.end()).unwrap_or(1.0);
        ((1.0 - inside) * values.count() as f64).round() as u64
    }

    /// Returns begin, end and height of the bars of a distribution, as shares; the fullest bin has the full height.
    pub fn bars(&self, values: &Summary) -> Vec<[f64; 3]> {
        let mut edges: Vec<f64> = self.edges.iter().map(|edge| edge / self.unit.per_si).collect();
        if let Some(end) = edges.last_mut().filter(|_| self.end() >= values.moments.max) {
            *end = f64::INFINITY;
        }
        let counts = values.histogram(&edges);
        let most = counts.iter().copied().fold(0.0, f64::max);
        let bars = self.edges.windows(2).zip(&counts).filter(|(_, size)| **size > 0.0);
        bars.map(|(edges, size)| [self.scale.at(edges[0]), self.scale.at(edges[1]), size / most]).collect()
    }

    /// Returns a small histogram. `within` is the interval of the median, if the median is uncertain.
    pub fn histogram(&self, values: &Summary, stage: &Stage, within: Option<(f64, f64)>) -> Vec<Item> {
        let mut items = Item::grid(&self.scale);
        items.extend(self.upright(values, &stage.plain().bin()));
        items.extend(within.map(|(lo, hi)| {
            let [from, to] = [lo, hi].map(|value| self.scale.at(value * self.unit.per_si));
            Item::rect(At::new(from, 0.0), At::new(to, 1.0), Style::of_page("band"))
        }));
        items.push(Item::line(At::new(0.0, 1.0), At::new(1.0, 1.0), Style::rail()));
        if let Some(median) = values.quantile(0.5).and_then(|median| self.at(median)) {
            let line = |style| Item::line(At::new(median, 0.0), At::new(median, 1.0), style);
            items.extend([Style::halo(), Style::whisker()].map(line));
        }
        items
    }

    /// Returns the bars of a distribution above the axis.
    pub fn upright(&self, values: &Summary, style: &Style) -> Vec<Item> {
        let bar = |[from, to, height]: [f64; 3]| {
            Item::rect(At::new(from, 1.0 - height), At::new(to, 1.0), style.clone())
        };
        self.bars(values).into_iter().map(bar).collect()
    }

    /// Returns the bars of a distribution to the right of the axis.
    pub fn lying(&self, values: &Summary, style: &Style) -> Vec<Item> {
        let bar = |[from, to, width]: [f64; 3]| {
            Item::rect(At::new(0.0, 1.0 - to), At::new(width, 1.0 - from), style.clone())
        };
        self.bars(values).into_iter().map(bar).collect()
    }
}
