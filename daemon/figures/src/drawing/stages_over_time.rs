//! Stages of one run over time, stacked, with the quantiles of the total; several runs share their axes. Pages have it.

use peernet_analysis::slowness::BOTH_DIRECTIONS;

use super::stage_bar::StagePart;
use crate::look::{STAGES, Style, stage};
use crate::plot::{At, Axis, Item, Key, Marks, Path, Plot, Strip, Swatch};
use crate::scale::Scale;

/// Share of the largest quantile by which the vertical axis extends beyond it.
const MARGIN: f64 = 0.05;
/// Units of time: longest axis that the unit is used for, seconds; length of the unit, seconds; its name.
const UNITS: [(f64, f64, &str); 4] = [
    (180.0, 1.0, "seconds"),
    (10_800.0, 60.0, "minutes"),
    (259_200.0, 3_600.0, "hours"),
    (f64::INFINITY, 86_400.0, "days"),
];
/// Runs shorter than this share of the axis are reported as short.
const SHORT: f64 = 0.02;
/// Marks on the rail that are closer than this share of it are merged.
const TOUCHING: f64 = 0.005;

/// Returns the position of a stage in a stack, counted from below.
fn place(name: &str) -> usize {
    // Both directions together take the place of the upload.
    let name = if name == BOTH_DIRECTIONS { "upload" } else { name };
    STAGES.iter().position(|known| known.name == name).unwrap_or(STAGES.len())
}

/// A bucket; seconds since the run's first iteration, and seconds of latency.
#[derive(Clone, Debug, PartialEq)]
pub struct StageBucket {
    /// Begin of the bucket.
    pub begin: f64,
    /// Median of the total.
    pub median: f64,
    /// 95th percentile of the total; `None` for few values.
    pub p95: Option<f64>,
    /// Means of the stages, which add up to that of the total.
    pub parts: Vec<StagePart>,
}

impl StageBucket {
    fn mean(&self) -> f64 {
        self.parts.iter().map(|part| part.seconds).sum()
    }
}

/// A run over time; moments are seconds since its first iteration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StagesOverTime {
    /// Length of the run.
    pub length: f64,
    /// Width of a bucket, seconds.
    pub width: f64,
    /// Buckets, oldest first.
    pub buckets: Vec<StageBucket>,
    /// Beginnings of episodes, except the first.
    pub borders: Vec<f64>,
    /// End of the warm-up.
    pub warm_up: Option<f64>,
    /// Iterations without an answer.
    pub unanswered: Vec<f64>,
    /// The 95th percentile of the whole run, seconds.
    pub p95: Option<f64>,
}

impl StagesOverTime {
    /// Returns the largest quantile; where no bucket has enough samples for a high one, that of the whole run.
    fn reach(&self) -> f64 {
        let largest =
            |of: fn(&StageBucket) -> Option<f64>| self.buckets.iter().filter_map(of).reduce(f64::max);
        let high =
            largest(|bucket| bucket.p95).or(self.p95).or_else(|| largest(|bucket| Some(bucket.mean())));
        high.into_iter().chain(largest(|bucket| Some(bucket.median))).fold(0.0, f64::max)
    }

    fn has_p95(&self) -> bool {
        self.buckets.iter().any(|bucket| bucket.p95.is_some())
    }

    /// Returns the line of one value of all buckets: each in the middle of its bucket, and the ends of a piece without a gap extended to
    /// the ends of their buckets.
    fn outline(&self, value: impl Fn(&StageBucket) -> Option<f64>) -> Vec<Option<(f64, f64)>> {
        // A bucket in which the warm-up ends holds nothing from before.
        let begun = self.warm_up.unwrap_or(0.0).clamp(0.0, self.length);
        let inside = |at: f64| at.clamp(begun, self.length);
        let mut points = Vec::with_capacity(self.buckets.len() + 4);
        for piece in self.buckets.chunk_by(|a, b| b.begin - a.begin < self.width * 1.5) {
            // A quantile may be missing in the midst of a piece.
            for known in piece.chunk_by(|a, b| value(a).is_some() == value(b).is_some()) {
                let point = |bucket: &StageBucket, share: f64| {
                    Some((inside(bucket.begin + self.width * share), value(bucket)?))
                };
                points.extend(known.first().map(|first| point(first, 0.0)));
                points.extend(known.iter().filter(|_| known.len() > 1).map(|bucket| point(bucket, 0.5)));
                points.extend(known.last().map(|last| point(last, 1.0)));
                points.push(None);
            }
        }
        points
    }

    /// Returns the names of the stages, the uppermost of the stack first.
    fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for name in self.buckets.iter().flat_map(|bucket| &bucket.parts).map(|part| part.name.as_str()) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names.sort_by_key(|name| std::cmp::Reverse(place(name)));
        names
    }

    /// Lays it out on axes that hold it: areas, each of which covers those below it too, and lines over them.
    pub fn plot(&self, axes: &OverTimeAxes) -> Plot {
        let x = Axis::new(axes.x(), "", "").marked(Marks::Round(4));
        let y = Axis::new(axes.y(), "", "").marked(Marks::Round(5)).with_grid();
        let mut plot = Plot::new(x, y);
        let (seconds, _) = axes.times();
        let at = |point: Option<(f64, f64)>| {
            let (at, value) = point?;
            Some((plot.x.scale.at(at / seconds), 1.0 - plot.y.scale.at_or_outside(value * 1e3)))
        };
        let outline = |value: &dyn Fn(&StageBucket) -> Option<f64>| self.outline(value).into_iter().map(at);
        let below = |bucket: &StageBucket, name: &str| {
            let parts = bucket.parts.iter().filter(|part| place(&part.name) <= place(name));
            Some(parts.map(|part| part.seconds).sum())
        };
        let mut items = Vec::new();
        if let Some(until) = self.warm_up {
            let end = plot.x.scale.at(until / seconds);
            items.push(Item::rect(At::new(0.0, 0.0), At::new(end, 1.0), Style::shade()));
        }
        for name in self.names() {
            let area = Path::area(outline(&|bucket| below(bucket, name)));
            items.push(Item::path(area, stage(name).plain()));
        }
        let across = |at: &f64| plot.x.scale.at(at / seconds);
        let ticks = |places: Vec<f64>| Path::ticks(places.into_iter().map(|x| (x, 0.0, 1.0)));
        let lines = [
            (ticks(self.borders.iter().map(across).collect()), "border"),
            (Path::line(outline(&|bucket| bucket.p95)), "p95"),
            (Path::line(outline(&|bucket| Some(bucket.median))), "median"),
        ];
        for (path, class) in lines.into_iter().filter(|(path, _)| !path.is_empty()) {
            items.extend(["under", class].map(|class| Item::path(path.clone(), Style::of_page(class))));
        }
        let mut lost: Vec<f64> = self.unanswered.iter().map(across).collect();
        lost.sort_by(f64::total_cmp);
        lost.dedup_by(|b, a| *b - *a < TOUCHING);
        if !lost.is_empty() {
            let rail = Item::line(At::new(0.0, 1.0), At::new(1.0, 1.0), Style::rail());
            let items = vec![rail, Item::path(ticks(lost), Style::lost())];
            plot.above = Some(Strip { items, size: 0.0 });
        }
        plot.items = items;
        plot
    }
}

/// The axes that all runs share: seconds across, and upwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverTimeAxes {
    length: f64,
    top: f64,
}

impl OverTimeAxes {
    /// Returns axes from zero to the end of the longest run, and to a little above the largest quantile; `None` without a bucket.
    pub fn of(all: &[StagesOverTime]) -> Option<Self> {
        let most = |of: fn(&StagesOverTime) -> f64| all.iter().map(of).fold(0.0, f64::max);
        let top = most(StagesOverTime::reach) * (1.0 + MARGIN);
        let known = all.iter().any(|one| !one.buckets.is_empty());
        known.then(|| Self { length: most(|one| one.length), top: if top > 0.0 { top } else { 1e-3 } })
    }

    /// Returns the entries of the legend for what these runs have beside their stages.
    pub fn legend(all: &[StagesOverTime]) -> Vec<Key> {
        let has = |of: fn(&StagesOverTime) -> bool| all.iter().any(of);
        let line = |class| Swatch::Line(Style::of_page(class));
        let keys = [
            (true, line("median"), "median of the total"),
            (has(StagesOverTime::has_p95), line("p95"), "p95 of points with 60 iterations"),
            (has(|one| !one.borders.is_empty()), line("border"), "new episode"),
            (has(|one| one.warm_up.is_some()), Swatch::Area(Style::shade()), "warm-up"),
            (has(|one| !one.unanswered.is_empty()), line("lost"), "no answer"),
        ];
        keys.into_iter().filter(|(has, ..)| *has).map(|(_, swatch, text)| Key::new(swatch, text)).collect()
    }

    /// Returns the unit of the horizontal axis.
    pub fn unit(&self) -> &'static str {
        self.times().1
    }

    fn times(&self) -> (f64, &'static str) {
        let fits = |(most, ..): &&(f64, f64, &str)| self.length <= *most;
        UNITS.iter().find(fits).map_or((1.0, "seconds"), |(_, seconds, name)| (*seconds, *name))
    }

    fn x(&self) -> Scale {
        Scale::linear((0.0, self.length / self.times().0))
    }

    fn y(&self) -> Scale {
        Scale::linear((0.0, self.top * 1e3))
    }

    /// Returns the number of buckets of a run whose mean is beyond the upper end.
    pub fn beyond(&self, run: &StagesOverTime) -> usize {
        run.buckets.iter().filter(|bucket| bucket.mean() > self.top).count()
    }

    /// Returns whether a run is so short beside the longest that it can hardly be seen.
    pub fn is_short(&self, run: &StagesOverTime) -> bool {
        run.length < self.length * SHORT
    }
}
