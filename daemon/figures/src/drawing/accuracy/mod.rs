//! Accuracy against latency.

mod numbers;

use peernet_statistics::number::{fixed, significant};

use crate::look::{Fill, INK, Mark, Style, WHITE};
use crate::plot::{At, Axis, Figure, Item, Plot, Table, Unit};
use crate::scale::Scale;
use crate::sheet::file;
use peernet_analysis::accuracy;

/// Half the width of a whisker's cap, points.
const CAP_HALF_WIDTH: f64 = 1.4;
/// Radius of a point, and width of the rim that separates it from its neighbours, points.
const RADIUS: f64 = 2.1;
const RIM: f64 = 0.4;
/// Ratio of the largest to the smallest latency from which the axis is logarithmic.
const LOGARITHMIC_RATIO: f64 = 12.0;
/// Room beyond the intervals, percentage points.
const AXIS_MARGIN: f64 = 2.0;
/// Difference of accuracies, as a share of the axis, below which horizontal whiskers overlap.
const OVERLAP_DISTANCE: f64 = 0.03;

/// Accuracy and latency of one configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// Name of the configuration, for the key.
    pub label: String,
    /// Number of correct answers.
    pub right: u64,
    /// Number of scored answers.
    pub count: u64,
    /// Median latency, seconds.
    pub median: f64,
    /// 95th percentile, seconds; `None` for few values.
    pub p95: Option<f64>,
}

impl Score {
    /// Returns the share of correct answers with its 95 % interval: low, share, high, in per cent. `None` without an answer.
    fn accuracy(&self) -> Option<[f64; 3]> {
        let accuracy::Accuracy { share, interval: (low, high), .. } =
            accuracy::Accuracy::from_counts(self.right, self.count, 0)?;
        Some([low, share, high].map(|share| share * 100.0))
    }

    fn p95_latency(&self) -> Option<f64> {
        self.p95.filter(|p95| p95.is_finite())
    }
}

/// Figure with a numbered point for each configuration, and a key to the numbers below.
#[derive(Clone, Debug, PartialEq)]
pub struct Accuracy {
    /// Title of the figure.
    pub title: String,
    /// Unit of the horizontal axis: a latency.
    pub unit: Unit,
    /// Points of the figure. Points without an answer or without a latency are not drawn.
    pub scores: Vec<Score>,
    /// Notes below the figure, such as what is left out.
    pub notes: Vec<String>,
}

/// Position of a point, vertical extent of its interval, and horizontal position of its 95th percentile. Shares of the plot.
struct Spot {
    at: At,
    interval: (f64, f64),
    p95: Option<f64>,
}

impl Accuracy {
    fn shown_scores(&self) -> impl Iterator<Item = (&Score, [f64; 3])> {
        let finite = self.scores.iter().filter(|score| score.median.is_finite() && score.median > 0.0);
        finite.filter_map(|score| Some((score, score.accuracy()?)))
    }

    /// Returns the lowest and the highest end of the intervals, per cent.
    fn interval_range(&self) -> Option<(f64, f64)> {
        self.shown_scores().map(|(_, [low, _, high])| (low, high)).reduce(union)
    }

    /// Returns whether points have horizontal whiskers. If two whiskers would overlap, no point has one.
    fn has_whiskers(&self) -> bool {
        let Some((low, high)) = self.interval_range() else { return false };
        let near = (high - low + 2.0 * AXIS_MARGIN) * OVERLAP_DISTANCE;
        let reach = |score: &Score| (score.median, score.p95_latency().unwrap_or(score.median));
        let shown: Vec<((f64, f64), f64)> =
            self.shown_scores().map(|(score, [_, share, _])| (reach(score), share)).collect();
        let touch = |((from, to), share): &((f64, f64), f64), ((other, late), level): &((f64, f64), f64)| {
            (share - level).abs() < near && from <= late && other <= to
        };
        let alone = |(number, one)| shown[number + 1..].iter().all(|other| !touch(one, other));
        shown.iter().enumerate().all(alone)
            && self.shown_scores().any(|(score, _)| score.p95_latency().is_some())
    }

    fn notes(&self) -> Vec<String> {
        let across = if self.has_whiskers() { " · across: to the 95th percentile" } else { "" };
        let parts = format!("point: median · upright: 95 % interval (Wilson){across}");
        std::iter::once(parts).chain(self.notes.iter().cloned()).collect()
    }

    fn axes(&self) -> Option<Plot> {
        let (low, high) = self.interval_range()?;
        let late =
            |score: &Score| score.p95_latency().filter(|_| self.has_whiskers()).unwrap_or(score.median);
        let (fast, slow) = self
            .shown_scores()
            .map(|(score, _)| (score.median * self.unit.per_si, late(score) * self.unit.per_si))
            .reduce(union)?;
        // Points at 100 % are complete because the axis ends a little above 100, below the next mark.
        let edge = (high - low).max(1.0) * 0.04;
        let shares = Scale::linear(((low - AXIS_MARGIN).max(-edge), (high + AXIS_MARGIN).min(100.0 + edge)));
        let across = if slow > fast * LOGARITHMIC_RATIO {
            let room = (slow / fast).powf(0.08);
            Scale::logarithmic((fast / room, slow * room))
        } else {
            Scale::from_zero((0.0, slow * 1.04))
        };
        let up = Axis::new(shares, "Top-1 accuracy, %", "%");
        Some(Plot::new(self.unit.axis(across).with_grid(), up.with_grid()))
    }

    fn spots(&self, plot: &Plot) -> Vec<Spot> {
        let across = |value: f64| plot.x.scale.at(value * self.unit.per_si);
        let has_whiskers = self.has_whiskers();
        let spot = |(score, [low, share, high]): (&Score, [f64; 3])| Spot {
            at: plot.at(score.median * self.unit.per_si, share),
            interval: (plot.up(low), plot.up(high)),
            p95: score.p95_latency().filter(|_| has_whiskers).map(across),
        };
        self.shown_scores().map(spot).collect()
    }

    /// Returns the key to the numbers.
    fn table(&self) -> Table {
        let has_late = self.shown_scores().any(|(score, _)| score.p95_latency().is_some());
        let show = |value: f64| significant(value * self.unit.per_si);
        let cells = |[accuracy, median, late]: [String; 3]| {
            [accuracy, median].into_iter().chain(has_late.then_some(late)).collect::<Vec<_>>()
        };
        let symbol = &self.unit.symbol;
        let titles = cells(["accuracy, %".to_owned(), format!("median, {symbol}"), format!("p95, {symbol}")]);
        let lines = self.shown_scores().map(|(score, [_, share, _])| {
            let late = score.p95_latency().map_or_else(|| "—".to_owned(), show);
            (score.label.clone(), cells([fixed(share, 1), show(score.median), late]))
        });
        Table { titles, lines: lines.collect() }
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let mut figure = Figure {
            title: self.title.clone(),
            notes: self.notes(),
            plots: self.axes().into_iter().collect(),
            table: self.table(),
            ..Figure::default()
        };
        let areas = file::areas(&figure);
        if let (Some(plot), Some(area)) = (figure.plots.first_mut(), areas.first()) {
            let spots = self.spots(plot);
            let mut items: Vec<Item> = spots.iter().flat_map(Spot::whiskers).collect();
            items.extend(numbers::items(area, &spots, &plot.y.title));
            items.extend(spots.iter().flat_map(Spot::point));
            plot.items = items;
        }
        figure
    }
}

fn union((lo, hi): (f64, f64), (a, b): (f64, f64)) -> (f64, f64) {
    (lo.min(a), hi.max(b))
}

impl Spot {
    fn whiskers(&self) -> Vec<Item> {
        let pen = Style::line("whisk2", INK.light.tint(0.55), 0.45);
        let (bottom, top) = self.interval;
        let ends = [bottom, top].map(|y| At { y, ..self.at });
        let mut items = Item::whisker(ends, [true; 2], CAP_HALF_WIDTH, &pen);
        if let Some(late) = self.p95 {
            let late = At { x: late, ..self.at };
            items.push(Item::line(self.at, late, pen.clone()));
            items.push(Item::line(late.aside(0.0, -CAP_HALF_WIDTH), late.aside(0.0, CAP_HALF_WIDTH), pen));
        }
        items
    }

    fn point(&self) -> [Item; 2] {
        let rim = Style::area("rim", Fill::of(WHITE));
        [
            Item::mark(self.at, Mark::Disc, RADIUS, rim),
            Item::mark(self.at, Mark::Disc, RADIUS - RIM, Style::ink()),
        ]
    }
}
