//! Figure of a run over time: latency, with episodes, warm-up and failed iterations.

mod bins;

use peernet_statistics::number::count;

use super::histogram::shown_range_of;
use crate::look::{INK, Mark, Style, stage};
use crate::plot::{At, Axis, Figure, Item, Key, Path, Plot, Strip, Swatch, Unit};
use crate::scale::Scale;
use bins::{Bin, bins};
use peernet_analysis::order::SortedValues;
use peernet_analysis::warm_up::MAX_EPISODE_BORDERS;

/// Number of equal bins into which the horizontal axis is divided. A line has at most one median for each bin.
const BIN_COUNT: usize = 290;
/// Height of the strip that shows failed iterations, points.
const STRIP_HEIGHT: f64 = 6.0;
/// Half the width of the cross of a failed iteration, points.
const CROSS_HALF_WIDTH: f64 = 1.7;
/// Radius of a mark on a line, points.
const RADIUS: f64 = 1.7;
/// Maximum number of marks on a line.
const MAX_MARKS: usize = 7;
/// Number of places at which a mark can be within the group of bins that share the mark. The marks of one line are
/// always at the same place, and the marks of another line at another place, so that they do not overlap.
const MARK_POSITIONS: usize = 4;
/// A line is interrupted between two values only if the distance of the values is more than this number of bins.
const MIN_GAP_BINS: f64 = 12.0;
/// Minimum width of a period of warm-up, points.
const MIN_WARM_UP_WIDTH: f64 = 0.6;

/// Latencies of a run over time. Latencies are in seconds, times in the unit of the horizontal axis.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeSeries {
    /// Title of the figure.
    pub title: String,
    /// Title of the horizontal axis: `Time since the start, s` or `Iteration`.
    pub x_title: String,
    /// True if the horizontal axis shows the numbers of iterations instead of times.
    pub x_is_iteration: bool,
    /// Unit of the vertical axis.
    pub unit: Unit,
    /// Line of the total, drawn as the median and the range of each bin.
    pub total: Line,
    /// Lines of stages, drawn as the median of each bin.
    pub stages: Vec<Line>,
    /// Periods of warm-up, each with its beginning and end.
    pub warm_up: Vec<(f64, f64)>,
    /// Start times of all episodes except the first.
    pub episode_starts: Vec<f64>,
    /// Times of failed iterations, also of those in the warm-up.
    pub failure_times: Vec<f64>,
    /// Number of failed iterations in the warm-up.
    pub failed_in_warm_up: u64,
    /// Notes below the figure, such as what is left out.
    pub notes: Vec<String>,
}

/// Line of a quantity over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Name of the stage or of the total's column.
    pub name: String,
    /// Pairs of a time and a value.
    pub values: Vec<(f64, f64)>,
}

impl TimeSeries {
    /// Returns the first and the last time of all values and failed iterations; `None` if there are none.
    fn time_range(&self) -> Option<(f64, f64)> {
        let lines = self.stages.iter().chain([&self.total]);
        let times = lines
            .flat_map(|line| line.values.iter().map(|(at, _)| *at))
            .chain(self.failure_times.iter().copied());
        times.filter(|at| at.is_finite()).fold(None, |range: Option<(f64, f64)>, at| {
            Some(range.map_or((at, at), |(lo, hi)| (lo.min(at), hi.max(at))))
        })
    }

    /// Returns the range of latencies that is shown: all latencies of the total and the stages except outliers.
    fn shown_range(&self) -> Option<(f64, f64)> {
        let line_range = |line: &Line| {
            shown_range_of(
                &line
                    .values
                    .iter()
                    .map(|(_, value)| *value)
                    .filter(|v| v.is_finite())
                    .collect::<SortedValues>(),
            )
        };
        let total = line_range(&self.total);
        // A stage is a part of the total, so values of a stage above the total's range are outliers, too.
        let max_total = total.map_or(f64::INFINITY, |(_, max)| max);
        let stages = self.stages.iter().filter_map(line_range).map(|(lo, hi)| (lo, hi.min(max_total)));
        stages.chain(total).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// Returns whether the borders between episodes are drawn. Too many borders would hide the lines.
    fn has_borders(&self) -> bool {
        !self.episode_starts.is_empty() && self.episode_starts.len() <= MAX_EPISODE_BORDERS as usize
    }

    fn legend(&self) -> Vec<Key> {
        let total = Swatch::Line(Style::line("strong", INK.light, 0.75));
        let mut keys = vec![Key::new(total, format!("{} (band: range)", self.total.name))];
        let stages = self.stages.iter().enumerate().map(|(index, line)| {
            let look = stage(&line.name);
            Key::new(Swatch::Curve(look.line(0.9), mark_shape(index), look.mark()), line.name.clone())
        });
        keys.extend(stages);
        if !self.warm_up.is_empty() {
            keys.push(Key::new(Swatch::Area(Style::shade()), "warm-up"));
        }
        if !self.failure_times.is_empty() {
            let failed = (self.failure_times.len() as u64).saturating_sub(self.failed_in_warm_up);
            let in_warm_up = match self.failed_in_warm_up {
                0 => String::new(),
                failed => format!(", and {} in the warm-up", count(failed)),
            };
            let text = format!("failed ({}{in_warm_up})", count(failed));
            keys.push(Key::new(Swatch::Mark(Mark::Cross, Style::failed_iteration()), text));
        }
        if self.has_borders() {
            keys.push(Key::new(Swatch::Line(Style::border()), "new episode"));
        }
        keys
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let plots =
            self.time_range().zip(self.shown_range()).map(|(times, latencies)| self.plot(times, latencies));
        let (title, notes) = (self.title.clone(), self.notes.clone());
        Figure {
            title,
            legend: self.legend(),
            notes,
            plots: plots.into_iter().collect(),
            ..Figure::default()
        }
    }

    /// Lays the plot out. Its axes show these times, and these latencies in seconds.
    fn plot(&self, times: (f64, f64), latencies: (f64, f64)) -> Plot {
        let x_scale = Scale::linear(times);
        let x =
            Axis::new(if self.x_is_iteration { x_scale.whole() } else { x_scale }, self.x_title.clone(), "");
        let y_scale = Scale::from_zero((latencies.0 * self.unit.per_si, latencies.1 * self.unit.per_si));
        let mut plot = Plot::new(x, self.unit.axis(y_scale).with_grid());
        let mut items = self.background_items(&plot);
        items.extend(self.line_items(&plot, &self.total, None));
        for (index, line) in self.stages.iter().enumerate() {
            items.extend(self.line_items(&plot, line, Some(index)));
        }
        plot.items = items;
        plot.top_strip = self.failures_strip(&plot);
        plot.remark = self.remark(y_scale.ends().1);
        plot
    }

    /// Returns the areas of warm-up and the borders between episodes.
    fn background_items(&self, plot: &Plot) -> Vec<Item> {
        let x = |at: f64| plot.x.scale.at(at);
        let warm_up = self.warm_up.iter().map(|(from, to)| Item::Rect {
            from: At::new(x(*from), 0.0),
            to: At::new(x(*to), 1.0),
            min_size: (MIN_WARM_UP_WIDTH, 0.0),
            style: Style::shade(),
        });
        let borders = self.episode_starts.iter().filter(|_| self.has_borders());
        let borders =
            borders.map(|at| Item::line(At::new(x(*at), 1.0), At::new(x(*at), 0.0), Style::border()));
        warm_up.chain(borders).collect()
    }

    /// Returns the medians of a stage as a line with marks. `stage_index` is the index of the stage. For the total,
    /// `stage_index` is `None`. The line of the total has no marks, but a band that shows the range of the values.
    fn line_items(&self, plot: &Plot, line: &Line, stage_index: Option<usize>) -> Vec<Item> {
        let bins = bins(&line.values, plot.x.scale.ends(), BIN_COUNT);
        let x = |bin: &Bin| (bin.index as f64 + 0.5) / BIN_COUNT as f64;
        let y = |value: f64| plot.y_share(value * self.unit.per_si);
        let steps: SortedValues =
            bins.windows(2).map(|pair| (pair[1].index - pair[0].index) as f64).collect();
        // If there are few values, their bins are far apart even without a gap in time. The maximum distance within
        // a line therefore grows with the median distance.
        let max_step = (4.0 * steps.median().unwrap_or_default()).max(MIN_GAP_BINS);
        let pieces = || bins.chunk_by(|a, b| (b.index - a.index) as f64 <= max_step);
        let medians =
            pieces().flat_map(|piece| piece.iter().map(|bin| Some((x(bin), y(bin.median)))).chain([None]));
        let medians = Path::line(medians);
        let Some(stage_index) = stage_index else {
            let band = pieces().flat_map(|piece| {
                piece.iter().map(|bin| Some((x(bin), y(bin.max), y(bin.min)))).chain([None])
            });
            let median = Style::line("strong", INK.light, 0.6);
            return vec![Item::path(Path::band(band), Style::band()), Item::path(medians, median)];
        };
        let look = stage(&line.name);
        let mut items = vec![Item::path(medians, look.line(0.9))];
        // Consecutive bins share a mark. The position of the mark among these bins depends on the stage, so that
        // no mark hides another.
        let bins_per_mark = BIN_COUNT.div_ceil(MAX_MARKS);
        for group in bins.chunk_by(|a, b| a.index / bins_per_mark == b.index / bins_per_mark) {
            if let Some(bin) = group.get(group.len() * (stage_index + 1) / (MARK_POSITIONS + 1)) {
                items.push(Item::mark(
                    At::new(x(bin), y(bin.median)),
                    mark_shape(stage_index),
                    RADIUS,
                    look.mark(),
                ));
            }
        }
        items
    }

    /// Returns the strip above the plot with a cross for each failed iteration; `None` if no iteration failed.
    fn failures_strip(&self, plot: &Plot) -> Option<Strip> {
        if self.failure_times.is_empty() {
            return None;
        }
        let mut items = vec![Item::line(At::new(0.0, 0.5), At::new(1.0, 0.5), Style::grid())];
        // Failed iterations in the same bin share a cross.
        let bin = |at: &f64| (plot.x.scale.at(*at) * BIN_COUNT as f64) as usize;
        let mut bins: Vec<usize> = self.failure_times.iter().map(bin).collect();
        bins.sort_unstable();
        bins.dedup();
        let cross = |bin: usize| {
            Item::mark(
                At::new(bin as f64 / BIN_COUNT as f64, 0.5),
                Mark::Cross,
                CROSS_HALF_WIDTH,
                Style::failed_iteration(),
            )
        };
        items.extend(bins.into_iter().map(cross));
        Some(Strip { items, size: STRIP_HEIGHT })
    }

    /// Returns the number of totals above the end of the axis as text: `12 beyond 90 ms`. `None` if no total is above
    /// the end. `end` is in the unit that is shown.
    fn remark(&self, end: f64) -> Option<String> {
        let max_shown = end / self.unit.per_si;
        let beyond = self.total.values.iter().filter(|(_, value)| *value > max_shown).count();
        (beyond > 0)
            .then(|| format!("{} beyond {}", count(beyond as u64), self.unit.format_value(max_shown, 0.0)))
    }
}

/// Returns the shape of the marks of the stage with this index.
fn mark_shape(stage_index: usize) -> Mark {
    Mark::OF_SERIES[stage_index % Mark::OF_SERIES.len()]
}
