//! Figure of a quality, such as accuracy or the success of episodes, against latency.

mod numbers;

use peernet_statistics::number::significant;

use crate::look::{Fill, INK, Mark, Style, WHITE};
use crate::plot::{At, Axis, Figure, Item, Plot, Table, Unit};
use crate::render::file;
use crate::scale::Scale;
use peernet_analysis::quality::{Quality, QualityEstimate};

/// Half the width of a whisker's cap, points.
const CAP_HALF_WIDTH: f64 = 1.4;
/// Radius of a point, and width of the rim that separates it from its neighbours, points.
const RADIUS: f64 = 2.1;
const RIM: f64 = 0.4;
/// The axis is logarithmic if the ratio of the largest to the smallest latency is more than this.
const LOGARITHMIC_RATIO: f64 = 12.0;
/// Maximum number of points that a reader can distinguish.
pub const MAX_SCORES: usize = 24;
/// Room that the axis of a quality has beyond the intervals, if the quality is a share; percentage points.
const AXIS_MARGIN: f64 = 2.0;
/// The horizontal whiskers of two points can overlap if the qualities of the points differ by less than this share of
/// the axis.
const OVERLAP_DISTANCE: f64 = 0.03;

/// Quality and latency of one configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// Name of the configuration, for the table.
    pub label: String,
    /// The quality.
    pub estimate: QualityEstimate,
    /// Median latency of all iterations in the statistics, seconds.
    pub median: f64,
    /// 95th percentile, seconds; `None` for few values.
    pub p95: Option<f64>,
}

impl Score {
    fn p95_latency(&self) -> Option<f64> {
        self.p95.filter(|p95| p95.is_finite())
    }
}

/// Presentation of a quality in the figure: texts, range and unit.
struct Shown {
    title: &'static str,
    /// Title of the axis.
    axis: &'static str,
    /// Title of the column in the table.
    column: &'static str,
    /// Method by which the intervals are computed: the name of its author.
    method: &'static str,
    /// Factor from the value to the shown value: shares are shown in per cent.
    factor: f64,
    /// Lowest and highest possible value, after multiplication by `factor`.
    range: (f64, f64),
    /// Symbol of the unit on the axis.
    symbol: &'static str,
}

impl Shown {
    fn of(quality: Quality) -> Self {
        let share = |title, axis, column, method| Self {
            title,
            axis,
            column,
            method,
            factor: 100.0,
            range: (0.0, 100.0),
            symbol: "%",
        };
        match quality {
            Quality::Top1 => share("Accuracy against latency", "Top-1 accuracy, %", "accuracy, %", "Wilson"),
            Quality::Map50 => share(
                "Mean average precision against latency",
                "mAP@0.5 of a picture, %",
                "mAP@0.5, %",
                "Student",
            ),
            Quality::MeanIou => {
                share("Mean IoU against latency", "Mean IoU of a picture, %", "mean IoU, %", "Student")
            }
            Quality::Success => {
                share("Success against latency", "Successful episodes, %", "success, %", "Wilson")
            }
            Quality::Return => Self {
                title: "Return against latency",
                axis: "Return of an episode",
                column: "return",
                method: "Student",
                factor: 1.0,
                range: (f64::NEG_INFINITY, f64::INFINITY),
                symbol: "",
            },
        }
    }
}

/// Figure with a numbered point for each configuration, at most [`MAX_SCORES`], and a table below that explains the numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Accuracy {
    /// Quantity of the vertical axis.
    pub quality: Quality,
    /// Unit of the horizontal axis: a latency.
    pub unit: Unit,
    /// Points of the figure. Points without a latency are not drawn.
    pub scores: Vec<Score>,
    /// Notes below the figure, such as what is left out.
    pub notes: Vec<String>,
}

/// Place of a point and its whiskers in the plot. Positions are shares of the plot.
struct Spot {
    at: At,
    /// Vertical position of the lower and of the upper end of the quality's interval.
    interval: (f64, f64),
    /// Horizontal position of the 95th percentile; `None` if the point has no horizontal whisker.
    p95: Option<f64>,
}

impl Accuracy {
    /// Returns the title of the figure.
    pub fn title(&self) -> &'static str {
        Shown::of(self.quality).title
    }

    /// Returns the method by which the intervals are computed: the name of its author.
    pub fn interval_method(&self) -> &'static str {
        Shown::of(self.quality).method
    }

    /// Returns the scores that are drawn, each with its quality as it is shown: lower end of the interval, estimate,
    /// upper end.
    fn shown_scores(&self) -> impl Iterator<Item = (&Score, [f64; 3])> {
        let factor = Shown::of(self.quality).factor;
        let finite = self.scores.iter().filter(|score| score.median.is_finite() && score.median > 0.0);
        finite.map(move |score| {
            let QualityEstimate { value, interval: (low, high), .. } = score.estimate;
            (score, [low, value, high].map(|value| value * factor))
        })
    }

    /// Returns the room that the vertical axis has beyond these ends of the intervals.
    fn margin(&self, (low, high): (f64, f64)) -> f64 {
        if self.quality == Quality::Return {
            (high - low).max(low.abs() * 0.01).max(1e-9) * 0.1
        } else {
            AXIS_MARGIN
        }
    }

    /// Returns the lowest and the highest end of all intervals; `None` if no score is drawn.
    fn interval_range(&self) -> Option<(f64, f64)> {
        self.shown_scores().map(|(_, [low, _, high])| (low, high)).reduce(union)
    }

    /// Returns whether points have horizontal whiskers. If two whiskers would overlap, no point has one.
    fn has_whiskers(&self) -> bool {
        let Some((low, high)) = self.interval_range() else { return false };
        let min_distance = (high - low + 2.0 * self.margin((low, high))) * OVERLAP_DISTANCE;
        let latency_range = |score: &Score| (score.median, score.p95_latency().unwrap_or(score.median));
        // For each point: the ends of its horizontal whisker, and its quality.
        let whiskers: Vec<((f64, f64), f64)> =
            self.shown_scores().map(|(score, [_, share, _])| (latency_range(score), share)).collect();
        let overlap = |((from_a, to_a), share_a): &((f64, f64), f64),
                       ((from_b, to_b), share_b): &((f64, f64), f64)| {
            (share_a - share_b).abs() < min_distance && from_a <= to_b && from_b <= to_a
        };
        let overlaps_no_later =
            |(index, whisker)| whiskers[index + 1..].iter().all(|other| !overlap(whisker, other));
        whiskers.iter().enumerate().all(overlaps_no_later)
            && self.shown_scores().any(|(score, _)| score.p95_latency().is_some())
    }

    fn notes(&self) -> Vec<String> {
        let across = if self.has_whiskers() { " · across: to the 95th percentile" } else { "" };
        let method = self.interval_method();
        let parts = format!("point: median · upright: 95 % interval ({method}){across}");
        std::iter::once(parts).chain(self.notes.iter().cloned()).collect()
    }

    fn axes(&self) -> Option<Plot> {
        let (low, high) = self.interval_range()?;
        let right_end =
            |score: &Score| score.p95_latency().filter(|_| self.has_whiskers()).unwrap_or(score.median);
        let (fast, slow) = self
            .shown_scores()
            .map(|(score, _)| (score.median * self.unit.per_si, right_end(score) * self.unit.per_si))
            .reduce(union)?;
        let shown = Shown::of(self.quality);
        // If shares are near 0 or 100, the axis ends a little beyond, so that points at 0 or 100 are not cut off. It
        // ends before the next mark, which would be an impossible share.
        let rest = (high - low).max(1.0) * 0.04;
        let margin = self.margin((low, high));
        let ends = ((low - margin).max(shown.range.0 - rest), (high + margin).min(shown.range.1 + rest));
        let values = Scale::linear(ends);
        let across = if slow > fast * LOGARITHMIC_RATIO {
            let room = (slow / fast).powf(0.08);
            Scale::logarithmic((fast / room, slow * room))
        } else {
            Scale::from_zero((0.0, slow * 1.04))
        };
        let y_axis = Axis::new(values, shown.axis, shown.symbol);
        Some(Plot::new(self.unit.axis(across).with_grid(), y_axis.with_grid()))
    }

    fn spots(&self, plot: &Plot) -> Vec<Spot> {
        let across = |value: f64| plot.x.scale.at(value * self.unit.per_si);
        let has_whiskers = self.has_whiskers();
        let spot = |(score, [low, share, high]): (&Score, [f64; 3])| Spot {
            at: plot.at(score.median * self.unit.per_si, share),
            interval: (plot.y_share(low), plot.y_share(high)),
            p95: score.p95_latency().filter(|_| has_whiskers).map(across),
        };
        self.shown_scores().map(spot).collect()
    }

    /// Returns the table that explains the numbers of the points.
    fn table(&self) -> Table {
        let has_p95 = self.shown_scores().any(|(score, _)| score.p95_latency().is_some());
        let show = |value: f64| significant(value * self.unit.per_si);
        let cells = |[accuracy, median, p95]: [String; 3]| {
            [accuracy, median].into_iter().chain(has_p95.then_some(p95)).collect::<Vec<_>>()
        };
        let symbol = &self.unit.symbol;
        let titles = cells([
            Shown::of(self.quality).column.to_owned(),
            format!("median, {symbol}"),
            format!("p95, {symbol}"),
        ]);
        let lines = self.shown_scores().map(|(score, _)| {
            let p95 = score.p95_latency().map_or_else(|| "—".to_owned(), show);
            let value = score.estimate.format(self.quality, score.estimate.value);
            (score.label.clone(), cells([value, show(score.median), p95]))
        });
        Table { titles, lines: lines.collect() }
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let mut figure = Figure {
            title: self.title().to_owned(),
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
        let style = Style::line("whisk2", INK.light.tint(0.55), 0.45);
        let (bottom, top) = self.interval;
        let ends = [bottom, top].map(|y| At { y, ..self.at });
        let mut items = Item::whisker(ends, [true; 2], CAP_HALF_WIDTH, &style);
        if let Some(p95) = self.p95 {
            let end = At { x: p95, ..self.at };
            items.push(Item::line(self.at, end, style.clone()));
            let cap = [-CAP_HALF_WIDTH, CAP_HALF_WIDTH].map(|dy| end.offset_by(0.0, dy));
            items.push(Item::line(cap[0], cap[1], style));
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
