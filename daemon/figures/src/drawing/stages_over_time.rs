//! Plot of the stacked stages of a run over time, with the quantiles of the total. The plots of several runs have the
//! same axes. The plots are drawn only on web pages, not in files.

use peernet_analysis::stage_split::part_order;
use peernet_analysis::total_column::TotalColumn;
use peernet_logger::Name;
use peernet_statistics::MIN_VALUES_FOR_P95;

use super::stage_bar::StagePart;
use crate::look::{Style, stage};
use crate::plot::{At, Axis, Item, Key, Marks, Path, Plot, Strip, Swatch};
use crate::scale::Scale;

/// The vertical axis extends beyond the largest latency that it must show by this share of the latency.
const MARGIN: f64 = 0.05;
/// Units of the horizontal axis, as tuples: length of the longest axis with the unit, seconds; length of the unit,
/// seconds; name of the unit.
const UNITS: [(f64, f64, &str); 4] = [
    (180.0, 1.0, "seconds"),
    (10_800.0, 60.0, "minutes"),
    (259_200.0, 3_600.0, "hours"),
    (f64::INFINITY, 86_400.0, "days"),
];
/// A run is short if it takes less than this share of the axis.
const SHORT_RUN_SHARE: f64 = 0.02;
/// Minimum width of a period of warm-up, as a share of the axis.
const MIN_WARM_UP_WIDTH: f64 = 0.002;
/// Failed iterations share a mark if their distance is less than this share of the axis.
const MIN_MARK_DISTANCE: f64 = 0.005;

/// Statistics of the iterations in one period of the run. Latencies are in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct StageBucket {
    /// Beginning of the bucket, seconds since the run's first iteration.
    pub begin: f64,
    /// Median of the total.
    pub median: f64,
    /// 95th percentile of the total; `None` if there are too few values.
    pub p95: Option<f64>,
    /// Stages, each with the mean of its latencies. The sum of the means is the mean of the total.
    pub parts: Vec<StagePart>,
}

impl StageBucket {
    /// Returns the mean of the total.
    fn mean_total(&self) -> f64 {
        self.parts.iter().map(|part| part.seconds).sum()
    }
}

/// A run over time. Times are seconds since the run's first iteration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StagesOverTime {
    /// Length of the run, seconds.
    pub length: f64,
    /// Width of a bucket, seconds.
    pub width: f64,
    /// Buckets, oldest first.
    pub buckets: Vec<StageBucket>,
    /// Borders between episodes: start times of all episodes except the first.
    pub borders: Vec<f64>,
    /// Periods of warm-up, each with its beginning and end.
    pub warm_up: Vec<(f64, f64)>,
    /// Times of failed iterations.
    pub failed: Vec<f64>,
    /// The 95th percentile of the total over the whole run, seconds; `None` if there are too few values.
    pub p95: Option<f64>,
}

impl StagesOverTime {
    /// Returns the largest latency that the axis must show: the largest median or 95th percentile of
    /// a bucket. If no bucket has enough samples for a 95th percentile, the 95th percentile of the
    /// whole run takes its place. If even the whole run has too few samples, the largest mean of a
    /// bucket takes its place.
    fn largest_latency(&self) -> f64 {
        let largest = |latency: fn(&StageBucket) -> Option<f64>| {
            self.buckets.iter().filter_map(latency).reduce(f64::max)
        };
        let p95_or_mean =
            largest(|bucket| bucket.p95).or(self.p95).or_else(|| largest(|bucket| Some(bucket.mean_total())));
        p95_or_mean.into_iter().chain(largest(|bucket| Some(bucket.median))).fold(0.0, f64::max)
    }

    fn has_p95(&self) -> bool {
        self.buckets.iter().any(|bucket| bucket.p95.is_some())
    }

    /// Returns the line through the values of all buckets, as points of time and value. `None` interrupts the line
    /// where buckets or values are missing. The line has a point in the middle of each bucket. Each piece between
    /// interruptions begins at the beginning of its first bucket and ends at the end of its last bucket.
    fn outline(&self, value: impl Fn(&StageBucket) -> Option<f64>) -> Vec<Option<(f64, f64)>> {
        // Statistics leave out the iterations of the warm-up. The values of the bucket in which the warm-up ends are
        // those of iterations after the warm-up, so the line begins at the end of the warm-up and not at the beginning
        // of the bucket.
        let first_warm_up = self.warm_up.first().filter(|(from, _)| *from <= 0.0);
        let start = first_warm_up.map_or(0.0, |(_, until)| until.clamp(0.0, self.length));
        let within_run = |time: f64| time.clamp(start, self.length);
        let mut points = Vec::with_capacity(self.buckets.len() + 4);
        for consecutive in self.buckets.chunk_by(|a, b| b.begin - a.begin < self.width * 1.5) {
            // A bucket with few iterations can lack a value, such as the 95th percentile. The bucket then interrupts
            // the line, although no bucket is missing.
            for piece in consecutive.chunk_by(|a, b| value(a).is_some() == value(b).is_some()) {
                let point = |bucket: &StageBucket, share: f64| {
                    Some((within_run(bucket.begin + self.width * share), value(bucket)?))
                };
                // The line through a single bucket is horizontal, so it needs no point in the middle.
                points.extend(piece.first().map(|first| point(first, 0.0)));
                points.extend(piece.iter().filter(|_| piece.len() > 1).map(|bucket| point(bucket, 0.5)));
                points.extend(piece.last().map(|last| point(last, 1.0)));
                points.push(None);
            }
        }
        points
    }

    /// Returns the names of the stages, from the top to the bottom of the stack.
    fn stage_names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for name in self.buckets.iter().flat_map(|bucket| &bucket.parts).map(|part| part.name.as_str()) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let order: Vec<Name> = part_order().collect();
        let position = |name: &str| order.iter().position(|part| *part == *name).unwrap_or(order.len());
        names.sort_by_key(|name| std::cmp::Reverse(position(name)));
        names
    }

    /// Lays the run out on shared axes: areas of the stages, and lines over the areas. The area of each stage reaches
    /// down to the axis. The areas of lower stages are drawn over the lower part of this area.
    pub fn plot(&self, axes: &OverTimeAxes) -> Plot {
        let x = Axis::new(axes.x_scale(), "", "").marked(Marks::Round(4));
        let y = Axis::new(axes.y_scale(), "", "").marked(Marks::Round(5)).with_grid();
        let mut plot = Plot::new(x, y);
        let (unit_seconds, _) = axes.time_unit();
        let position = |point: Option<(f64, f64)>| {
            let (time, value) = point?;
            Some((plot.x.scale.at(time / unit_seconds), 1.0 - plot.y.scale.at_or_outside(value * 1e3)))
        };
        let outline =
            |value: &dyn Fn(&StageBucket) -> Option<f64>| self.outline(value).into_iter().map(position);
        let stack_height = |bucket: &StageBucket, names: &[&str]| {
            let parts = bucket.parts.iter().filter(|part| names.contains(&part.name.as_str()));
            Some(parts.map(|part| part.seconds).sum())
        };
        let mut items = Vec::new();
        let shade = |(from, until): &(f64, f64)| {
            let [from, until] = [from, until].map(|time| plot.x.scale.at(time / unit_seconds));
            Item::rect(At::new(from, 0.0), At::new(until.max(from + MIN_WARM_UP_WIDTH), 1.0), Style::shade())
        };
        items.extend(self.warm_up.iter().map(shade));
        let names = self.stage_names();
        for (index, name) in names.iter().enumerate() {
            let area = Path::area(outline(&|bucket| stack_height(bucket, &names[index..])));
            items.push(Item::path(area, stage(name).plain()));
        }
        let x_share = |time: &f64| plot.x.scale.at(time / unit_seconds);
        let ticks = |xs: Vec<f64>| Path::ticks(xs.into_iter().map(|x| (x, 0.0, 1.0)));
        let lines = [
            (ticks(self.borders.iter().map(x_share).collect()), "border"),
            (Path::line(outline(&|bucket| bucket.p95)), "p95"),
            (Path::line(outline(&|bucket| Some(bucket.median))), "median"),
        ];
        for (path, class) in lines.into_iter().filter(|(path, _)| !path.is_empty()) {
            // A wide pale line under each line separates the line from the areas.
            items.extend(["halo", class].map(|class| Item::path(path.clone(), Style::of_page(class))));
        }
        let mut failed: Vec<f64> = self.failed.iter().map(x_share).collect();
        failed.sort_by(f64::total_cmp);
        // Each failure is compared with the last mark that is kept, so marks of a long series of failures keep this
        // distance.
        failed.dedup_by(|later, earlier| *later - *earlier < MIN_MARK_DISTANCE);
        if !failed.is_empty() {
            let rail = Item::line(At::new(0.0, 1.0), At::new(1.0, 1.0), Style::rail());
            // Files do not draw this plot, so the strip needs no size.
            let items = vec![rail, Item::path(ticks(failed), Style::failed_iteration())];
            plot.top_strip = Some(Strip { items, size: 0.0 });
        }
        plot.items = items;
        plot
    }
}

/// Axes that the plots of all runs share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverTimeAxes {
    /// Length of the horizontal axis, seconds.
    length: f64,
    /// Upper end of the vertical axis, seconds.
    top: f64,
}

impl OverTimeAxes {
    /// Returns axes for these runs. Both axes begin at zero. The time axis is as long as the longest run. The axis of
    /// latencies ends a little above the largest latency that it must show. `None` if no run has a bucket.
    pub fn of(runs: &[StagesOverTime]) -> Option<Self> {
        let max = |value: fn(&StagesOverTime) -> f64| runs.iter().map(value).fold(0.0, f64::max);
        let top = max(StagesOverTime::largest_latency) * (1.0 + MARGIN);
        let has_bucket = runs.iter().any(|run| !run.buckets.is_empty());
        has_bucket.then(|| Self { length: max(|run| run.length), top: if top > 0.0 { top } else { 1e-3 } })
    }

    /// Returns the entries of the legend for the lines, marks and shades that these runs have, without the entries for
    /// stages. The median is that of `total`.
    pub fn legend(runs: &[StagesOverTime], total: TotalColumn) -> Vec<Key> {
        let any = |condition: fn(&StagesOverTime) -> bool| runs.iter().any(condition);
        let line = |class| Swatch::Line(Style::of_page(class));
        let median_text = format!("median of the {}", total.title().to_lowercase());
        // With fewer iterations, a bucket has no 95th percentile.
        let p95_text = format!("p95 (points of at least {MIN_VALUES_FOR_P95} iterations)");
        let keys = [
            (true, line("median"), median_text.as_str()),
            (any(StagesOverTime::has_p95), line("p95"), p95_text.as_str()),
            (any(|run| !run.borders.is_empty()), line("border"), "new episode"),
            (any(|run| !run.warm_up.is_empty()), Swatch::Area(Style::shade()), "warm-up"),
            (any(|run| !run.failed.is_empty()), line("lost"), "failed"),
        ];
        let shown = keys.into_iter().filter(|(is_shown, ..)| *is_shown);
        shown.map(|(_, swatch, text)| Key::new(swatch, text)).collect()
    }

    /// Returns the name of the unit of the horizontal axis, such as `minutes`.
    pub fn unit(&self) -> &'static str {
        self.time_unit().1
    }

    /// Returns the length in seconds and the name of the unit of the horizontal axis, such as 60 and `minutes`.
    fn time_unit(&self) -> (f64, &'static str) {
        let fits = |(max_length, ..): &&(f64, f64, &str)| self.length <= *max_length;
        UNITS.iter().find(fits).map_or((1.0, "seconds"), |(_, seconds, name)| (*seconds, *name))
    }

    fn x_scale(&self) -> Scale {
        Scale::linear((0.0, self.length / self.time_unit().0))
    }

    fn y_scale(&self) -> Scale {
        Scale::linear((0.0, self.top * 1e3))
    }

    /// Returns the number of a run's buckets in which the mean of the total is above the upper end
    /// of the vertical axis.
    pub fn beyond(&self, run: &StagesOverTime) -> usize {
        run.buckets.iter().filter(|bucket| bucket.mean_total() > self.top).count()
    }

    /// Returns whether a run is so short in comparison with the longest run that the short run can hardly be seen.
    pub fn is_short(&self, run: &StagesOverTime) -> bool {
        run.length < self.length * SHORT_RUN_SHARE
    }
}
