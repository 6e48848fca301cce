//! Figure of a quality, such as accuracy or the success of episodes, against latency.

mod numbers;

use peernet_statistics::number::significant;

use crate::look::{Fill, INK, Mark, Style, WHITE};
use crate::plot::{At, Axis, Figure, Item, Plot, Table, Unit};
use crate::render::file;
use crate::scale::{Scale, is_wide};
use peernet_analysis::quality::{Quality, QualityEstimate};

/// Half the width of a whisker's cap, points.
const CAP_HALF_WIDTH: f64 = 1.4;
/// Radius of a point with its rim, points.
const RADIUS: f64 = 2.1;
/// Width of the rim that separates a point from its neighbours, points.
const RIM: f64 = 0.4;
/// Maximum number of points that a reader can distinguish.
pub const MAX_QUALITY_POINTS: usize = 24;
/// Room beyond the intervals at each end of the axis of a quality that is a share, percentage points.
const AXIS_MARGIN: f64 = 2.0;
/// Minimum difference between the qualities of two points whose horizontal whiskers cannot overlap, as a share of the
/// axis.
const MIN_QUALITY_DISTANCE: f64 = 0.03;

/// Quality and latency of one configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct QualityPoint {
    /// Name of the configuration, for the table.
    pub label: String,
    /// Estimate of the quality, with its interval.
    pub estimate: QualityEstimate,
    /// Median latency of all iterations in the statistics, seconds.
    pub median: f64,
    /// 95th percentile of the latencies, seconds; `None` if there are too few values.
    pub p95: Option<f64>,
}

impl QualityPoint {
    /// Returns the 95th percentile of the latencies; `None` if it cannot be drawn.
    fn drawable_p95(&self) -> Option<f64> {
        self.p95.filter(|p95| p95.is_finite())
    }
}

/// Presentation of a quality in the figure: texts and range.
struct Presentation {
    /// Title of the figure.
    title: &'static str,
    /// Title of the axis.
    axis_title: &'static str,
    /// Author after whom the method of the intervals is named, such as `Wilson`.
    interval_author: &'static str,
    /// Factor from a value to the number shown: 100 for shares, which are shown in per cent.
    factor: f64,
    /// Lowest and highest possible value, after multiplication by `factor`.
    range: (f64, f64),
}

impl Presentation {
    fn of(quality: Quality) -> Self {
        let of_share = |title, axis_title, interval_author| Self {
            title,
            axis_title,
            interval_author,
            factor: 100.0,
            range: (0.0, 100.0),
        };
        match quality {
            Quality::Top1 => of_share("Accuracy against latency", "Top-1 accuracy, %", "Wilson"),
            Quality::Map50 => {
                of_share("Mean average precision against latency", "mAP@0.5 of a picture, %", "Student")
            }
            Quality::MeanIou => of_share("Mean IoU against latency", "Mean IoU of a picture, %", "Student"),
            Quality::Success => of_share("Success against latency", "Successful episodes, %", "Wilson"),
            Quality::Return => Self {
                title: "Return against latency",
                axis_title: "Return of an episode",
                interval_author: "Student",
                factor: 1.0,
                range: (f64::NEG_INFINITY, f64::INFINITY),
            },
        }
    }
}

/// Figure with a numbered point for each configuration and a table that explains the numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct QualityAgainstLatency {
    /// Quality that the vertical axis shows.
    pub quality: Quality,
    /// Title and unit of the horizontal axis, which shows a latency.
    pub latency_unit: Unit,
    /// One point for each configuration, at most [`MAX_QUALITY_POINTS`] points. A point without a latency is not drawn.
    pub points: Vec<QualityPoint>,
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

impl QualityAgainstLatency {
    /// Returns the title of the figure.
    pub fn title(&self) -> &'static str {
        Presentation::of(self.quality).title
    }

    /// Returns the author after whom the method of the intervals is named, such as `Wilson`.
    pub fn interval_author(&self) -> &'static str {
        Presentation::of(self.quality).interval_author
    }

    /// Returns the points that are drawn, each with the numbers that are shown: the lower end of the quality's
    /// interval, the estimate, the upper end of the interval.
    fn shown_points(&self) -> impl Iterator<Item = (&QualityPoint, [f64; 3])> {
        let factor = Presentation::of(self.quality).factor;
        // The axis of latencies may be logarithmic, so a latency of zero has no position.
        let drawable = self.points.iter().filter(|point| point.median.is_finite() && point.median > 0.0);
        drawable.map(move |point| {
            let QualityEstimate { value, interval: (low, high), .. } = point.estimate;
            (point, [low, value, high].map(|value| value * factor))
        })
    }

    /// Returns the room of the vertical axis beyond the lowest and the highest end of the intervals.
    fn margin(&self, (low, high): (f64, f64)) -> f64 {
        if self.quality == Quality::Return {
            // The room is a tenth of the range. If the range is empty, 1 % of the value takes its
            // place.
            (high - low).max(low.abs() * 0.01).max(1e-9) * 0.1
        } else {
            AXIS_MARGIN
        }
    }

    /// Returns the lowest and the highest end of all intervals; `None` if no point is drawn.
    fn interval_range(&self) -> Option<(f64, f64)> {
        self.shown_points().map(|(_, [low, _, high])| (low, high)).reduce(union)
    }

    /// Returns whether points have horizontal whiskers. If two whiskers would overlap, no point has one.
    fn has_horizontal_whiskers(&self) -> bool {
        let Some((low, high)) = self.interval_range() else { return false };
        let min_distance = (high - low + 2.0 * self.margin((low, high))) * MIN_QUALITY_DISTANCE;
        let latency_range =
            |point: &QualityPoint| (point.median, point.drawable_p95().unwrap_or(point.median));
        // For each point: the ends of its horizontal whisker, and its quality.
        let whiskers: Vec<((f64, f64), f64)> =
            self.shown_points().map(|(point, [_, quality, _])| (latency_range(point), quality)).collect();
        let overlap = |((from_a, to_a), quality_a): &((f64, f64), f64),
                       ((from_b, to_b), quality_b): &((f64, f64), f64)| {
            (quality_a - quality_b).abs() < min_distance && from_a <= to_b && from_b <= to_a
        };
        let overlaps_no_later_whisker =
            |(index, whisker)| whiskers[index + 1..].iter().all(|other| !overlap(whisker, other));
        whiskers.iter().enumerate().all(overlaps_no_later_whisker)
            && self.shown_points().any(|(point, _)| point.drawable_p95().is_some())
    }

    fn notes(&self) -> Vec<String> {
        let horizontal_note =
            if self.has_horizontal_whiskers() { " · across: to the 95th percentile" } else { "" };
        let author = self.interval_author();
        let explanations = format!("point: median · upright: 95 % interval ({author}){horizontal_note}");
        std::iter::once(explanations).chain(self.notes.iter().cloned()).collect()
    }

    /// Returns an empty plot whose axes contain all points and whiskers; `None` if no point is drawn.
    fn empty_plot(&self) -> Option<Plot> {
        let (low, high) = self.interval_range()?;
        let right_end = |point: &QualityPoint| {
            point.drawable_p95().filter(|_| self.has_horizontal_whiskers()).unwrap_or(point.median)
        };
        let (fastest, slowest) = self
            .shown_points()
            .map(|(point, _)| {
                (point.median * self.latency_unit.per_si, right_end(point) * self.latency_unit.per_si)
            })
            .reduce(union)?;
        let presentation = Presentation::of(self.quality);
        // If shares are near 0 or 100, the axis ends a little beyond 0 or 100, so that points there are not cut off.
        // The axis ends before the next mark, because this mark would be an impossible share.
        let room_for_points = (high - low).max(1.0) * 0.04;
        let margin = self.margin((low, high));
        let ends = (
            (low - margin).max(presentation.range.0 - room_for_points),
            (high + margin).min(presentation.range.1 + room_for_points),
        );
        let y_scale = Scale::linear(ends);
        let x_scale = if is_wide((fastest, slowest)) {
            let room = (slowest / fastest).powf(0.08);
            Scale::logarithmic((fastest / room, slowest * room))
        } else {
            Scale::from_zero((0.0, slowest * 1.04))
        };
        let (_, quality_unit) = self.quality.title();
        let y_axis = Axis::new(y_scale, presentation.axis_title, quality_unit);
        Some(Plot::new(self.latency_unit.axis(x_scale).with_grid(), y_axis.with_grid()))
    }

    fn spots(&self, plot: &Plot) -> Vec<Spot> {
        let x_position = |value: f64| plot.x.scale.at(value * self.latency_unit.per_si);
        let has_horizontal_whiskers = self.has_horizontal_whiskers();
        let spot = |(point, [low, quality, high]): (&QualityPoint, [f64; 3])| Spot {
            at: plot.at(point.median * self.latency_unit.per_si, quality),
            interval: (plot.y_share(low), plot.y_share(high)),
            p95: point.drawable_p95().filter(|_| has_horizontal_whiskers).map(x_position),
        };
        self.shown_points().map(spot).collect()
    }

    /// Returns the table that explains the numbers of the points.
    fn table(&self) -> Table {
        let has_p95 = self.shown_points().any(|(point, _)| point.drawable_p95().is_some());
        let latency_text = |value: f64| significant(value * self.latency_unit.per_si);
        let cells = |[quality, median, p95]: [String; 3]| {
            [quality, median].into_iter().chain(has_p95.then_some(p95)).collect::<Vec<_>>()
        };
        let symbol = &self.latency_unit.symbol;
        let quality_title = match self.quality.title() {
            (title, "") => title.to_owned(),
            (title, unit) => format!("{title}, {unit}"),
        };
        let titles = cells([quality_title, format!("median, {symbol}"), format!("p95, {symbol}")]);
        let lines = self.shown_points().map(|(point, _)| {
            let p95 = point.drawable_p95().map_or_else(|| "—".to_owned(), latency_text);
            let value = point.estimate.format(self.quality, point.estimate.value);
            (point.label.clone(), cells([value, latency_text(point.median), p95]))
        });
        Table { titles, lines: lines.collect() }
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let mut figure = Figure {
            title: self.title().to_owned(),
            notes: self.notes(),
            plots: self.empty_plot().into_iter().collect(),
            table: self.table(),
            ..Figure::default()
        };
        // The places of the numbers are computed for the area that the plot has in a file. Pages show the numbers at
        // the same shares.
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
