//! Each quality of the configurations, such as the accuracy of answers or the success of episodes, against latency.

use peernet_analysis::quality::{Quality, QualityEstimate};
use peernet_figures::drawing::{MAX_QUALITY_POINTS, QualityAgainstLatency, QualityPoint, Unit};
use peernet_statistics::number::{SPACE, duration, join_ends};

use super::{Comparison, Configuration};
use crate::picture::Picture;

/// Plot of one quality with the table that explains its numbers.
pub(crate) struct QualityPlot {
    pub title: String,
    /// Author after whom the method of the intervals is named, such as `Wilson`.
    pub interval_author: &'static str,
    pub plot: Picture,
    /// Titles of the columns of the table.
    pub columns: Vec<String>,
    /// Rows of the table: the name of a configuration with the texts of its columns. Each point of the plot has a
    /// number; row `n` explains the point with the number `n`.
    pub rows: Vec<(String, Vec<String>)>,
    /// Number of all configurations with the quality; `None` if all of them are drawn.
    pub all: Option<usize>,
}

/// Returns the estimate of a quality of a configuration; `None` if it was not measured.
pub(super) fn estimate(configuration: &Configuration, quality: Quality) -> Option<QualityEstimate> {
    quality.from_statistics(|name| {
        configuration.statistics(name).map(|values| (values.count, values.mean, values.std))
    })
}

/// Formats an estimate and its interval; shares are in percent.
pub(super) fn texts(quality: Quality, estimate: &QualityEstimate) -> (String, Option<String>) {
    let form = |value: f64| estimate.format(quality, value);
    let interval = |(low, high): (f64, f64)| join_ends([form(low), form(high)]);
    (form(estimate.value), estimate.known_interval().map(interval))
}

/// Returns a plot of each quality that at least two configurations have.
pub(crate) fn qualities(comparison: &Comparison) -> Vec<QualityPlot> {
    Quality::ALL.into_iter().filter_map(|quality| plot(comparison, quality)).collect()
}

fn plot(comparison: &Comparison, quality: Quality) -> Option<QualityPlot> {
    let point = |configuration: &Configuration| {
        let estimate = estimate(configuration, quality)?;
        let total = configuration.statistics(comparison.total_column.name())?;
        Some(QualityPoint { label: configuration.name.clone(), estimate, median: total.p50, p95: total.p95 })
    };
    let mut points: Vec<QualityPoint> = comparison.configurations.iter().filter_map(point).collect();
    let all = points.len();
    (all >= 2).then_some(())?;
    points.truncate(MAX_QUALITY_POINTS);
    let point_text = |point: &QualityPoint| {
        let ((value, _), unit) = (texts(quality, &point.estimate), quality.title().1);
        let unit = if unit.is_empty() { String::new() } else { format!("{SPACE}{unit}") };
        format!("{} {value}{unit} at {}", point.label, duration(point.median))
    };
    let point_texts: Vec<String> = points.iter().map(point_text).collect();
    let latency_unit = Unit::milliseconds(comparison.total_column.title());
    let plot = QualityAgainstLatency { quality, latency_unit, points, notes: Vec::new() };
    let figure = plot.figure();
    let label = format!("{}: {}", figure.title, point_texts.join(", "));
    Some(QualityPlot {
        interval_author: plot.interval_author(),
        plot: Picture::of_plot(figure.plots.first()?, "plot-with-axes", &label),
        title: figure.title,
        columns: figure.table.titles,
        rows: figure.table.lines,
        all: (all > MAX_QUALITY_POINTS).then_some(all),
    })
}
