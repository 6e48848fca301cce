//! Throughput against payload: bytes over delay, and the throughput by the slope of the delays.

use peernet_analysis::fit::{MIN_SIZES, distinct_sizes, rate};
use peernet_analysis::transfer::speed_between;
use peernet_figures::drawing::{Scatter, ScatterLine, ScatterPoint, ScatterSeries};
use peernet_figures::look;
use peernet_figures::plot::Axis;
use peernet_figures::scale::Scale;
use peernet_logger::{Name, stage};
use peernet_statistics::number::{
    SPACE, bytes, stage_ms, throughput as megabytes, throughput_between, throughput_with,
};

use super::payload::{Group, group_name, groups, line, name_in};
use super::{Comparison, Configuration};
use crate::picture::Picture;

/// bit/s to MB/s.
const MEGABYTES: f64 = 1.0 / 8e6;
/// Directions, each with the sizes that make up the bytes sent in it.
static WAYS: [(Name, [Name; 2]); 2] = [
    (stage::UPLOAD, [stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES]),
    (stage::DOWNLOAD, [stage::DOWNLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES]),
];

/// Plot of the throughput, its numbers, and the results of lines through the delays.
pub(crate) struct Throughput {
    pub plot: Picture,
    pub rows: Vec<ThroughputRow>,
    pub said: Vec<String>,
}

/// One configuration, one direction.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ThroughputRow {
    pub name: String,
    pub way: String,
    /// Mean size of a message with its log.
    pub size: String,
    /// Mean delay, ms.
    pub delay: String,
    /// Throughput in MB/s, and its interval by the clock bounds.
    pub throughput: (String, Option<String>),
}

/// One point, bit/s.
struct ThroughputPoint<'a> {
    one: &'a Configuration,
    bytes: f64,
    delay: f64,
    value: f64,
    /// Interval by the clock bounds; without an upper end where the delay may be zero.
    ends: Option<(f64, Option<f64>)>,
}

impl<'a> ThroughputPoint<'a> {
    fn of(one: &'a Configuration, way: &Name, sizes: &[Name; 2]) -> Option<Self> {
        let size = one.figures(&sizes[0])?.mean;
        let bytes = size + one.figures(&sizes[1]).map_or(0.0, |figures| figures.mean);
        let delay = one.figures(way).map(|figures| figures.mean).filter(|delay| *delay > 0.0)?;
        let half = one.bounds.iter().find(|bound| bound.stage == *way).and_then(|bound| bound.half_width);
        let value = 8.0 * bytes / delay;
        let ends = half.map(|half| speed_between(value, delay, half.mean));
        (bytes > 0.0).then_some(Self { one, bytes, delay, value, ends })
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

    /// MB/s over kB; an error bar without an upper end leaves the plot at `top`.
    fn point(&self, top: f64, name: String) -> ScatterPoint {
        ScatterPoint {
            x: self.bytes / 1e3,
            y: self.value * MEGABYTES,
            ends: self
                .ends
                .map(|(low, high)| (low * MEGABYTES, high.map_or(top, |high| high * MEGABYTES).min(top))),
            name,
        }
    }
}

/// Returns the throughput of each direction whose payloads have at least three sizes.
pub(crate) fn throughput(comparison: &Comparison) -> Option<Throughput> {
    let ways = WAYS.iter().filter_map(|(way, sizes)| {
        let known: Vec<ThroughputPoint<'_>> =
            comparison.configurations.iter().filter_map(|one| ThroughputPoint::of(one, way, sizes)).collect();
        let sizes = distinct_sizes(known.iter().map(|it| it.bytes));
        (sizes >= MIN_SIZES).then_some((way, known))
    });
    let ways: Vec<(&Name, Vec<ThroughputPoint<'_>>)> = ways.collect();
    let all = || ways.iter().flat_map(|(_, known)| known);
    ways.first()?;
    // An upper end that is far above all values would compress the points at the bottom.
    let highest = all().map(|it| it.value).fold(0.0, f64::max) * MEGABYTES;
    let reach = all().filter_map(|it| it.ends?.1).map(|high| (high * MEGABYTES).min(2.0 * highest));
    let up = Scale::up_to(reach.fold(highest, f64::max), 5);
    let x = Axis::new(Scale::of_sizes(all().map(|it| it.bytes / 1e3)), "", "kB");
    let mut said = Vec::new();
    let series = ways.iter().map(|(way, known)| {
        let sized: Group<'_> = known.iter().map(|it| (it.one, it.bytes)).collect();
        let groups = groups(comparison, &sized);
        let lines = groups.iter().filter_map(|group| level(comparison, way, group, &mut said)).collect();
        let name = |it: &ThroughputPoint<'_>| name_in(comparison, &groups, it.one);
        let points = known.iter().map(|it| it.point(up.ends().1 * 1.02, name(it))).collect();
        ScatterSeries { stage: look::stage(way), name: way.to_string(), points, lines }
    });
    let series: Vec<ScatterSeries> = series.collect();
    let rows: Vec<ThroughputRow> =
        ways.iter().flat_map(|(way, known)| known.iter().map(|it| it.row(way))).collect();
    let label = format!("Throughput against payload. {}", said.join(" "));
    let scatter = Scatter { x, y: Axis::new(up, "", "MB/s"), series };
    Some(Throughput { plot: Picture::of_scatter(&scatter, &label), rows, said })
}

/// Returns a level line at the throughput of large messages, by the delay of each further byte.
fn level(
    comparison: &Comparison,
    way: &Name,
    group: &Group<'_>,
    said: &mut Vec<String>,
) -> Option<ScatterLine> {
    let (fit, ends) = line(group, way)?;
    let of = group_name(comparison, group).map_or_else(String::new, |name| format!(" ({name})"));
    let Some((value, margin)) = rate(fit.slope) else {
        said.push(format!("{way}{of}: too fast to tell from these sizes."));
        return None;
    };
    said.push(format!(
        "{way}{of}: {}{SPACE}MB/s (95{SPACE}%) by the slope of a line through {} mean delays.",
        throughput_with(value, margin),
        fit.points
    ));
    let intercept = value * MEGABYTES;
    Some(ScatterLine { intercept, slope: 0.0, from: ends.0 / 1e3, to: ends.1 / 1e3 })
}
