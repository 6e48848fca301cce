//! Axis that several distributions share. The distributions are sketches.

use peernet_statistics::Summary;
use peernet_statistics::histogram::{BinCounts, Binning, MAX_BINS, shown_range};

use crate::look::{Stage, Style};
use crate::plot::{At, Axis, Item, Unit};
use crate::scale::{Scale, ZERO_THRESHOLD};

/// Number of bins between the smallest and the largest value that is shown.
const BINS: u32 = 48;
/// Margin on both sides of the values on an axis that does not begin at zero, as a share of the range of the values.
const SIDE_MARGIN: f64 = 0.05;
/// Share by which a value may lie beyond an end of the axis and still have a position on the axis. The value may have
/// been rounded.
const ROUNDING: f64 = 1e-9;
/// A smallest value that is less than this share of the largest value becomes zero. Otherwise the smallest value would
/// make the axis logarithmic.
const ZERO_SHARE: f64 = 1e-12;
/// Approximate number of ticks on the axis.
const TICKS: usize = 5;

/// Axis of a quantity, divided into the bins of its histograms.
#[derive(Clone, Debug, PartialEq)]
pub struct BinnedAxis {
    /// Quantity and unit.
    pub unit: Unit,
    /// Scale, in the unit that is shown.
    pub scale: Scale,
    /// Edges of the bins, in the unit that is shown.
    edges: Vec<f64>,
}

impl BinnedAxis {
    /// Returns an axis of the values that a histogram shows. Tails that would compress the rest lie beyond the ends of
    /// the axis. The axis of a single distribution has the bins of the [histogram](Binning). An axis that several
    /// distributions share is logarithmic if it spans more than a decade. `None` without values.
    pub fn around<'a>(distributions: impl Iterator<Item = &'a Summary>, unit: Unit) -> Option<Self> {
        let filled: Vec<&Summary> = distributions.filter(|summary| summary.count() > 0).collect();
        if let [single] = filled.as_slice() {
            let edges: Vec<f64> =
                Binning::of(*single, MAX_BINS)?.edges().iter().map(|edge| edge * unit.per_si).collect();
            let scale = Scale::linear((*edges.first()?, *edges.last()?)).widened(TICKS);
            return Some(Self { unit, scale, edges });
        }
        let ends = Self::ends(&filled, &unit)?;
        let scale = Scale::decades(ends).unwrap_or_else(|| Scale::linear(ends).widened(TICKS));
        Some(Self::new(unit, scale, ends))
    }

    /// Returns a linear axis that begins at zero and ends a little above the largest value that a histogram shows. The
    /// axis begins near the smallest value instead if an axis from zero would squeeze all values into a corner, or if
    /// the smallest value is negative. `None` without values.
    // The axis is linear for any range, because the line of latency over the length of answers would be a curve on a
    // logarithmic axis.
    pub fn from_zero<'a>(distributions: impl Iterator<Item = &'a Summary>, unit: Unit) -> Option<Self> {
        let filled: Vec<&Summary> = distributions.filter(|summary| summary.count() > 0).collect();
        let (lo, hi) = Self::ends(&filled, &unit)?;
        let margin = (hi - lo) * SIDE_MARGIN;
        let is_squeezed = lo > hi * ZERO_THRESHOLD;
        match lo {
            _ if lo < 0.0 => {
                let scale = Scale::linear((lo, hi.max(0.0))).widened(TICKS);
                Some(Self::new(unit, scale, (lo, hi)))
            }
            _ if is_squeezed => {
                let scale = Scale::linear((lo - margin, hi + margin)).widened(TICKS);
                Some(Self::new(unit, scale, (lo, hi)))
            }
            _ => {
                // On an axis from zero, even the lower tail has a position, so the bins begin at the
                // smallest value of all distributions.
                let min = filled.iter().map(|summary| summary.moments.min * unit.per_si).fold(lo, f64::min);
                Some(Self::new(unit, Scale::up_to(hi + margin / 2.0, TICKS + 1), (min.max(0.0), hi)))
            }
        }
    }

    fn new(unit: Unit, scale: Scale, (lo, hi): (f64, f64)) -> Self {
        let edge = |index: u32| scale.between(lo, hi, f64::from(index) / f64::from(BINS));
        Self { unit, scale, edges: (0..=BINS).map(edge).collect() }
    }

    /// Returns the ends of the union of the [shown ranges](shown_range) of all distributions, in the unit that is
    /// shown. `None` without values.
    fn ends(distributions: &[&Summary], unit: &Unit) -> Option<(f64, f64)> {
        let ends = |summary: &&Summary| {
            let (lo, hi) = shown_range(*summary)?;
            let lo = if lo.abs() < hi.abs() * ZERO_SHARE { 0.0 } else { lo };
            Some((lo * unit.per_si, hi * unit.per_si))
        };
        let (lo, hi) = distributions.iter().filter_map(ends).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        // If all values are equal, the range is widened, because a bin needs a width.
        Some((lo, if hi > lo { hi } else { lo + lo.abs().max(1e-6) * 0.01 }))
    }

    /// Returns this axis as an axis of a plot.
    pub fn axis(&self) -> Axis {
        self.unit.axis(self.scale).with_grid()
    }

    /// Returns the smallest and the largest value that have a position on the axis, in SI units.
    pub fn range(&self) -> (f64, f64) {
        let [lo, hi] = [self.edges.first(), self.edges.last()].map(|edge| edge.copied().unwrap_or_default());
        ((lo - lo.abs() * ROUNDING) / self.unit.per_si, (hi + hi.abs() * ROUNDING) / self.unit.per_si)
    }

    /// Returns the position of a value in SI units; `None` for a value beyond an end of the axis.
    pub fn at(&self, value: f64) -> Option<f64> {
        let (lo, hi) = self.range();
        (lo..=hi).contains(&value).then(|| self.scale.at(value * self.unit.per_si))
    }

    /// Returns the edges of the bins in SI units.
    fn edges_si(&self) -> Vec<f64> {
        self.edges.iter().map(|edge| edge / self.unit.per_si).collect()
    }

    /// Returns the number of values below the lower end of the axis, and the number of values above its
    /// upper end.
    pub fn beyond(&self, values: &Summary) -> (u64, u64) {
        let BinCounts { below, above, .. } = values.count_in(&self.edges_si(), self.range());
        (below, above)
    }

    /// Returns the beginning, the end and the height of each bar of a distribution, as shares of the plot. The bar of
    /// the bin with most values has the full height.
    pub fn bars(&self, values: &Summary) -> Vec<[f64; 3]> {
        let cumulative = values.counts_below(&self.edges_si(), self.range());
        let counts: Vec<f64> = cumulative.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let largest_count = counts.iter().copied().fold(0.0, f64::max);
        let filled_bins = self.edges.windows(2).zip(&counts).filter(|(_, count)| **count > 0.0);
        let bar = |(edges, count): (&[f64], &f64)| {
            [self.scale.at(edges[0]), self.scale.at(edges[1]), count / largest_count]
        };
        filled_bins.map(bar).collect()
    }

    /// Returns a small histogram. `median_interval` is an interval of the median in SI units, which is drawn as a band;
    /// `None` if there is no band.
    pub fn histogram(
        &self,
        values: &Summary,
        stage: &Stage,
        median_interval: Option<(f64, f64)>,
    ) -> Vec<Item> {
        let mut items = Item::grid(&self.scale);
        items.extend(self.upright_bars(values, &stage.plain().bin()));
        items.extend(median_interval.map(|(lo, hi)| {
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

    /// Returns the upright bars of a distribution above a horizontal axis.
    pub fn upright_bars(&self, values: &Summary, style: &Style) -> Vec<Item> {
        let bar = |[from, to, height]: [f64; 3]| {
            Item::rect(At::new(from, 1.0 - height), At::new(to, 1.0), style.clone())
        };
        self.bars(values).into_iter().map(bar).collect()
    }

    /// Returns the horizontal bars of a distribution at the right of a vertical axis.
    pub fn horizontal_bars(&self, values: &Summary, style: &Style) -> Vec<Item> {
        let bar = |[from, to, width]: [f64; 3]| {
            Item::rect(At::new(0.0, 1.0 - to), At::new(width, 1.0 - from), style.clone())
        };
        self.bars(values).into_iter().map(bar).collect()
    }
}
