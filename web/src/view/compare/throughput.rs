//! Throughput against payload: bytes over delay, and the throughput by the slope of the delays.

use peernet_analysis::fit::{MIN_SIZES, distinct_sizes, rate};
use peernet_analysis::transfer::{Transfer, speed_between};
use peernet_clock::Direction;
use peernet_figures::drawing::{Scatter, ScatterLine, ScatterPoint, ScatterSeries};
use peernet_figures::look;
use peernet_figures::plot::Axis;
use peernet_figures::scale::Scale;
use peernet_logger::{Name, stage};
use peernet_statistics::number::{
    SPACE, bytes, stage_ms, throughput as megabytes, throughput_between, throughput_with,
};
use peernet_store::DelayAccuracy;

use super::payload::{Group, group_name, groups, line, name_in};
use super::{Comparison, Configuration};
use crate::picture::Picture;

/// Factor from bit/s to MB/s.
const MEGABYTES_PER_BIT: f64 = 1.0 / 8e6;
/// Directions, each with the name of its delay.
static DIRECTIONS: [(Direction, Name); 2] =
    [(Direction::Up, stage::UPLOAD), (Direction::Down, stage::DOWNLOAD)];

/// Plot of the throughput, its numbers, and the results of lines through the delays.
pub(crate) struct Throughput {
    pub plot: Picture,
    pub rows: Vec<ThroughputRow>,
    pub sentences: Vec<String>,
}

/// One configuration, one direction.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ThroughputRow {
    pub name: String,
    pub way: String,
    /// Mean size of a message with the measurements that travel with it.
    pub size: String,
    /// Mean delay, ms.
    pub delay: String,
    /// Throughput in MB/s, and its interval by the clock bounds.
    pub throughput: (String, Option<String>),
}

/// Throughput of one configuration in one direction, bit/s.
struct ThroughputPoint<'a> {
    one: &'a Configuration,
    bytes: f64,
    delay: f64,
    value: f64,
    /// Interval by the clock bounds. It has no upper end if the delay may be zero.
    ends: Option<(f64, Option<f64>)>,
}

impl<'a> ThroughputPoint<'a> {
    fn of(one: &'a Configuration, direction: Direction, way: &Name) -> Option<Self> {
        let mean_of = |name: &Name| one.figures(name).map(|figures| (figures.count, figures.mean));
        let value = Transfer::from_statistics(direction, mean_of)?.speed()?;
        let delay = one.figures(way)?.mean;
        let bound = one.bounds.iter().find(|bound| bound.stage == *way);
        let half_width = bound.and_then(DelayAccuracy::median_half_width);
        let ends = half_width.map(|half_width| speed_between(value, delay, half_width));
        Some(Self { one, bytes: value * delay / 8.0, delay, value, ends })
    }

    fn row(&self, way: &Name) -> ThroughputRow {
        ThroughputRow {
            name: self.one.name.clone(),
            way: way.to_string(),
            size: bytes(self.bytes).to_string(),
            delay: stage_ms(self.delay),
            throughput: (megabytes(self.value), self.ends.map(throughput_between)),
        }
    }

    /// Returns the point in MB/s over kB. An error bar without an upper end extends to `top`, which lies beyond the plot.
    fn point(&self, top: f64, name: String) -> ScatterPoint {
        ScatterPoint {
            x: self.bytes / 1e3,
            y: self.value * MEGABYTES_PER_BIT,
            ends: self.ends.map(|(low, high)| {
                (low * MEGABYTES_PER_BIT, high.map_or(top, |high| high * MEGABYTES_PER_BIT).min(top))
            }),
            name,
        }
    }
}

/// Returns the throughput of each direction whose payloads have at least three sizes.
pub(crate) fn throughput(comparison: &Comparison) -> Option<Throughput> {
    let measured = DIRECTIONS.iter().filter_map(|(direction, way)| {
        let points = comparison.configurations.iter();
        let points: Vec<ThroughputPoint<'_>> =
            points.filter_map(|one| ThroughputPoint::of(one, *direction, way)).collect();
        let sizes = distinct_sizes(points.iter().map(|point| point.bytes));
        (sizes >= MIN_SIZES).then_some((way, points))
    });
    let measured: Vec<(&Name, Vec<ThroughputPoint<'_>>)> = measured.collect();
    let all = || measured.iter().flat_map(|(_, points)| points);
    measured.first()?;
    // An upper end that is far above all values would compress the points at the bottom.
    let highest = all().map(|point| point.value).fold(0.0, f64::max) * MEGABYTES_PER_BIT;
    let reach =
        all().filter_map(|point| point.ends?.1).map(|high| (high * MEGABYTES_PER_BIT).min(2.0 * highest));
    let up = Scale::up_to(reach.fold(highest, f64::max), 5);
    let x = Axis::new(Scale::of_sizes(all().map(|point| point.bytes / 1e3)), "", "kB");
    let mut sentences = Vec::new();
    let series = measured.iter().map(|(way, points)| {
        let sized: Group<'_> = points.iter().map(|point| (point.one, point.bytes)).collect();
        let groups = groups(comparison, &sized);
        let lines = groups
            .iter()
            .filter_map(|group| horizontal_line(comparison, way, group, &mut sentences))
            .collect();
        let name = |point: &ThroughputPoint<'_>| name_in(comparison, &groups, point.one);
        let scatter_points =
            points.iter().map(|point| point.point(up.ends().1 * 1.02, name(point))).collect();
        ScatterSeries { stage: look::stage(way), name: way.to_string(), points: scatter_points, lines }
    });
    let series: Vec<ScatterSeries> = series.collect();
    let rows: Vec<ThroughputRow> =
        measured.iter().flat_map(|(way, points)| points.iter().map(|point| point.row(way))).collect();
    let label = format!("Throughput against payload. {}", sentences.join(" "));
    let scatter = Scatter { x, y: Axis::new(up, "", "MB/s"), series };
    Some(Throughput { plot: Picture::of_scatter(&scatter, &label), rows, sentences })
}

/// Returns a horizontal line at the throughput of large messages. This throughput follows from the delay of each further byte.
fn horizontal_line(
    comparison: &Comparison,
    way: &Name,
    group: &Group<'_>,
    sentences: &mut Vec<String>,
) -> Option<ScatterLine> {
    let (fit, ends) = line(group, way)?;
    let group_text = group_name(comparison, group).map_or_else(String::new, |name| format!(" ({name})"));
    let Some((value, margin)) = rate(fit.slope) else {
        sentences.push(format!("{way}{group_text}: too fast to tell from these sizes."));
        return None;
    };
    sentences.push(format!(
        "{way}{group_text}: {}{SPACE}MB/s (95{SPACE}%) by the slope of a line through {} mean delays.",
        throughput_with(value, margin),
        fit.points
    ));
    let intercept = value * MEGABYTES_PER_BIT;
    Some(ScatterLine { intercept, slope: 0.0, from: ends.0 / 1e3, to: ends.1 / 1e3 })
}
