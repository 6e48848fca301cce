//! Histogram of counted values, with lines at quantiles.

use super::count;
use crate::look::{Stage, Style, TextStyle};
use crate::plot::{Anchor, At, Axis, Item, Label, Plot, Unit};
use crate::scale::Scale;
use crate::text::width;

/// Width of the bar of a distribution with a single bin, as a share of the plot.
const SINGLE_BAR_WIDTH: f64 = 0.1;
/// Minimum width and height of a bar in a file, points, so that even one iteration in ten thousand is visible.
const MIN_BAR_SIZE: (f64, f64) = (0.4, 0.45);
/// Distance from the line of a quantile to its label, as a multiple of the type size.
const LABEL_GAP: f64 = 0.3;
/// Distance between two rows of labels, as a multiple of the type size.
const ROW_DISTANCE: f64 = 1.3;
/// Distance from the plot to the lowest row of labels, as a multiple of the type size.
const FIRST_ROW_DISTANCE: f64 = 0.4;

/// Meaning of the bars of a distribution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum View {
    /// A bar shows the number of samples in its bin.
    #[default]
    Counts,
    /// A bar shows the share of samples up to the end of its bin.
    Cumulative,
}

/// Noun for the number of values of a distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CountNoun {
    /// `iterations`, if each iteration has one value at most.
    Iterations,
    /// `values`, if an iteration may have several values.
    Values,
}

/// Distribution with the number of samples in each bin, for pages and files. The counts come from a sketch or from
/// [`Bins`](super::Bins).
#[derive(Clone, Debug, PartialEq)]
pub struct Distribution {
    /// Edges of the bins, SI units. There is one edge more than there are counts.
    pub edges: Vec<f64>,
    /// Number of samples in each bin.
    pub counts: Vec<u64>,
    /// Noun for the number of samples.
    pub count_noun: CountNoun,
    /// Number of samples below the first bin, and number of samples above the last bin.
    pub beyond: (u64, u64),
    /// Quantiles that have a line, each with its name (`median`, `p95` or `p99`) and its value in SI units.
    pub quantiles: Vec<(&'static str, f64)>,
    /// Quantity and unit.
    pub unit: Unit,
    /// Stage that determines the colour of the bars.
    pub stage: Stage,
    /// Meaning of the bars.
    pub view: View,
    /// True if the scale of the counts is logarithmic.
    pub is_logarithmic: bool,
    /// Minimum width of the plot, as a multiple of the type size of its labels.
    pub min_width_em: f64,
}

impl Distribution {
    /// Lays the distribution out.
    pub fn plot(&self) -> Plot {
        let mut plot = Plot::new(self.value_axis(), self.count_axis().with_grid());
        plot.items = self.bars(&plot);
        let (quantile_items, label_rows) = self.quantile_items(&plot);
        plot.items.extend(quantile_items);
        plot.lines_above = label_rows;
        plot.remark = beyond_remark(self.beyond, self.value_range(), &self.unit);
        plot
    }

    fn value_range(&self) -> (f64, f64) {
        let end = |edge: Option<&f64>| edge.copied().unwrap_or_default();
        (end(self.edges.first()), end(self.edges.last()))
    }

    /// Returns the axis of values. A single bin lies in the middle of the axis and does not fill the plot.
    fn value_axis(&self) -> Axis {
        let ((from, to), per_si) = (self.value_range(), self.unit.per_si);
        let middle = f64::midpoint(from, to) * per_si;
        let scale = if self.counts.len() == 1 {
            Scale::linear((middle, middle))
        } else {
            Scale::linear((from * per_si, to * per_si))
        };
        self.unit.axis(scale)
    }

    fn count_axis(&self) -> Axis {
        let (title, unit) = match self.count_noun {
            CountNoun::Iterations => ("Iterations", "iterations"),
            CountNoun::Values => ("Values", "values"),
        };
        match self.view {
            View::Counts => {
                let largest_count = self.counts.iter().copied().max().unwrap_or_default() as f64;
                let scale = if self.is_logarithmic {
                    // The axis begins below 1, so that a bin of one sample is visible.
                    Scale::logarithmic((0.5, largest_count.max(10.0)))
                } else {
                    Scale::from_zero((0.0, largest_count))
                };
                Axis::new(scale.whole(), title, unit)
            }
            View::Cumulative => Axis::new(Scale::linear((0.0, 100.0)), format!("{title} up to here, %"), "%"),
        }
    }

    /// Returns the height of each bar, in the unit of the vertical axis.
    fn heights(&self) -> Vec<f64> {
        let total = self.counts.iter().sum::<u64>() + self.beyond.0 + self.beyond.1;
        let cumulative_percents = self.counts.iter().scan(self.beyond.0, |sum, count| {
            *sum += count;
            Some(*sum as f64 / total.max(1) as f64 * 100.0)
        });
        match self.view {
            View::Counts => self.counts.iter().map(|count| *count as f64).collect(),
            View::Cumulative => cumulative_percents.collect(),
        }
    }

    fn bars(&self, plot: &Plot) -> Vec<Item> {
        let style = self.stage.plain().bin();
        let (low, _) = plot.y.scale.ends();
        let bar = |(edges, height): (&[f64], f64)| {
            let (mut from, mut to) =
                (plot.at(edges[0] * self.unit.per_si, low), plot.at(edges[1] * self.unit.per_si, height));
            if self.counts.len() == 1 {
                // The width of a single bin depends on the value, so its bar has a fixed width.
                (from.x, to.x) = (0.5 - SINGLE_BAR_WIDTH / 2.0, 0.5 + SINGLE_BAR_WIDTH / 2.0);
            }
            Item::Rect { from, to, min_size: MIN_BAR_SIZE, style: style.clone() }
        };
        self.edges.windows(2).zip(self.heights()).filter(|(_, height)| *height > 0.0).map(bar).collect()
    }

    /// Returns the lines of quantiles with their labels above the plot, and the number of rows of labels.
    fn quantile_items(&self, plot: &Plot) -> (Vec<Item>, usize) {
        let (from, to) = self.value_range();
        // The values in a single bin are all equal, so the width of this bin says nothing about their spread.
        let spread = if self.counts.len() == 1 { 0.0 } else { to - from };
        // Row and right end of each label that is already placed.
        let mut label_ends: Vec<(usize, f64)> = Vec::new();
        let mut placed = Vec::new();
        for (name, value) in self.quantiles.iter().filter(|(_, value)| (from..=to).contains(value)) {
            let x = plot.x.scale.at(value * self.unit.per_si);
            let text = format!("{name} {}", self.unit.format_value(*value, spread));
            // One gap separates a label from its line. At least two gaps separate neighbouring labels.
            let label_width = (width(&text, 1.0) + 3.0 * LABEL_GAP) / self.min_width_em;
            // The label of the median is at the left of its line if there is room. The other labels are at the right of
            // their lines if there is room.
            let anchor = match *name {
                "median" if x > label_width => Anchor::End,
                _ if x + label_width > 1.0 => Anchor::End,
                _ => Anchor::Start,
            };
            let left = if anchor == Anchor::End { x - label_width } else { x };
            // A label that would overlap an earlier label moves to the next row.
            let row = (0..).find(|row| !label_ends.iter().any(|(other, end)| other == row && left < *end));
            let row = row.unwrap_or_default();
            label_ends.push((row, left + label_width));
            placed.push((*name, x, text, anchor, row));
        }
        let mut items = Vec::new();
        for (name, x, text, anchor, row) in placed {
            let gap = if anchor == Anchor::End { -LABEL_GAP } else { LABEL_GAP };
            let (bottom, top) = (At::new(x, 1.0), At::new(x, 0.0));
            items.push(Item::line(bottom, top, Style::rim()));
            items.push(Item::line(bottom, top, Style::quantile(name)));
            let label = Label::new(top, text, TextStyle::MARK).anchored(anchor);
            items.push(Item::Text(label.shifted(gap, -FIRST_ROW_DISTANCE - ROW_DISTANCE * row as f64)));
        }
        let rows = label_ends.iter().map(|(row, _)| row + 1).max().unwrap_or_default();
        (items, rows)
    }
}

/// Returns the numbers of values below and above the ends of an axis: `← 3 below 1.2 ms · 12 beyond 23.2 ms →`. `None`
/// if all values are on the axis. The ends are in SI units.
pub(in crate::drawing) fn beyond_remark(
    (below, above): (u64, u64),
    (from, to): (f64, f64),
    unit: &Unit,
) -> Option<String> {
    let below = (below > 0).then(|| format!("← {} below {}", count(below), unit.format_value(from, 0.0)));
    let above = (above > 0).then(|| format!("{} beyond {} →", count(above), unit.format_value(to, 0.0)));
    let counts: Vec<String> = below.into_iter().chain(above).collect();
    (!counts.is_empty()).then(|| counts.join(" · "))
}
