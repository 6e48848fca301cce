//! A distribution with its median and quantiles.

use askama::Template;
use peernet_statistics::number::{SPACE, count, fixed};
use peernet_store::Histogram;
use serde::Deserialize;

use super::{Axis, Percent, Scale, fit};

/// Two ways to look at a distribution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum DistributionView {
    /// Samples per bin.
    #[default]
    Histogram,
    /// Share of samples up to each bin's end.
    Cumulative,
}

/// Width of a plot on the narrowest of phones, rem: labels are placed so that they do not meet there.
const NARROWEST: f64 = 13.5;

/// A histogram or its running sum, on a linear or logarithmic scale of counts.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/histogram.html")]
pub(crate) struct HistogramPlot {
    look: &'static str,
    label: String,
    unit_above: &'static str,
    unit: String,
    rows: Vec<(Percent, String)>,
    columns: Axis,
    bars: Vec<[Percent; 4]>,
    marks: Vec<Mark>,
    beyond: Option<String>,
    /// `true` if a mark's label stands where this one would.
    beyond_lower: bool,
}

impl askama::filters::HtmlSafe for HistogramPlot {}

#[derive(Clone, Debug, PartialEq)]
struct Mark {
    class: &'static str,
    x: Percent,
    anchor: &'static str,
    row: usize,
    text: String,
}

/// Returns the unit in which a quantity is shown, and the factor from its SI value.
pub(crate) fn shown_in(unit: &str) -> (String, f64) {
    match unit {
        "s" => ("ms".to_owned(), 1e3),
        "bit/s" => ("MB/s".to_owned(), 1.0 / 8e6),
        "B" => ("kB".to_owned(), 1e-3),
        other => (other.to_owned(), 1.0),
    }
}

impl HistogramPlot {
    /// Returns the plot of a distribution; `look` is the class of its colour.
    pub(crate) fn new(histogram: &Histogram, look: &'static str, view: DistributionView, log: bool) -> Self {
        let (unit, factor) = shown_in(&histogram.unit);
        let lo = histogram.edges.first().copied().unwrap_or(0.0) * factor;
        let hi = histogram.edges.last().copied().unwrap_or(1.0) * factor;
        let width = if hi > lo { hi - lo } else { 1.0 };
        let at = |value: f64| Percent(((value - lo) / width * 100.0).clamp(0.0, 100.0));

        let total = (histogram.counts.iter().sum::<u64>() + histogram.beyond).max(1) as f64;
        let heights: Vec<f64> = match view {
            DistributionView::Histogram => histogram.counts.iter().map(|count| *count as f64).collect(),
            DistributionView::Cumulative => {
                let sums = histogram.counts.iter().scan(0, |sum, count| {
                    *sum += count;
                    Some(*sum as f64 / total * 100.0)
                });
                sums.collect()
            }
        };
        let (rows, height) = match view {
            DistributionView::Histogram => vertical(heights.iter().copied().fold(0.0, f64::max), log),
            DistributionView::Cumulative => vertical(100.0, false),
        };
        let bars = histogram.edges.windows(2).zip(&heights).filter(|(_, size)| **size > 0.0);
        let bars = bars.map(|(edges, size)| {
            let (x, end, height) = (at(edges[0] * factor), at(edges[1] * factor), height(*size));
            [x, Percent(end.0 - x.0), Percent(100.0 - height.0), height]
        });

        let figures = &histogram.figures;
        let quantiles =
            [("median", Some(figures.p50)), ("p95", figures.p95), ("p99", figures.p99)].into_iter();
        let mut marks: Vec<Mark> = Vec::new();
        let mut ends: Vec<(usize, f64)> = Vec::new();
        for (name, value) in quantiles.filter_map(|(name, value)| Some((name, value? * factor))) {
            if value > hi {
                continue;
            }
            let x = at(value);
            let text = format!("{name} {}", peernet_statistics::number::figure(value));
            let width = fit::width(&text) / NARROWEST * 100.0;
            let anchor = if name == "median" && x.0 > width || x.0 + width > 100.0 { "end" } else { "start" };
            let from = if anchor == "end" { x.0 - width } else { x.0 };
            // A label that would run into one before it goes to the next line.
            let taken = |row: &usize| ends.iter().any(|(known, end)| known == row && from < *end);
            let row = (0..).find(|row| !taken(row)).unwrap_or_default();
            ends.push((row, from + width));
            marks.push(Mark { class: name, x, anchor, row, text });
        }

        let beyond = (histogram.beyond > 0).then(|| {
            format!(
                "{} beyond {}{SPACE}{unit} →",
                count(histogram.beyond),
                peernet_statistics::number::figure(hi)
            )
        });
        let finding =
            marks.iter().map(|mark| format!("{}{SPACE}{unit}", mark.text)).collect::<Vec<_>>().join(", ");
        Self {
            look,
            label: format!("Distribution of {}: {finding}", histogram.stage),
            unit_above: match view {
                DistributionView::Histogram => "iterations",
                DistributionView::Cumulative => "% of iterations",
            },
            columns: Axis::below(
                ticks(lo, hi).into_iter().map(|(value, label)| (at(value), label)).collect(),
            ),
            unit,
            rows,
            bars: bars.collect(),
            beyond_lower: marks.iter().any(|mark| mark.row == 2),
            marks,
            beyond,
        }
    }
}

type Height = Box<dyn Fn(f64) -> Percent>;

/// Returns rows of the grid with their labels, and the function from a count to a height.
fn vertical(largest: f64, log: bool) -> (Vec<(Percent, String)>, Height) {
    if log && largest > 1.0 {
        let decades = largest.log10().ceil().max(1.0);
        // A single sample is drawn a little above the axis, so that it is visible.
        let height = move |count: f64| {
            Percent(if count < 1.0 { count * 4.0 } else { 4.0 + count.log10() / decades * 96.0 })
        };
        let rows = (0..=decades as i32).map(|decade| {
            let count = 10f64.powi(decade);
            (Percent(100.0 - height(count).0), fixed(count, 0))
        });
        return (rows.collect(), Box::new(height));
    }
    // With at least four samples each step of the scale is a whole number.
    let scale = Scale::fit(largest.max(4.0), 4);
    let rows = scale.grid().into_iter().map(|at| Percent(100.0 - at.0)).zip(scale.labels()).collect();
    (rows, Box::new(move |count| scale.at(count)))
}

/// Returns about six round values between two others, with their labels.
fn ticks(lo: f64, hi: f64) -> Vec<(f64, String)> {
    if hi <= lo {
        return vec![(lo, peernet_statistics::number::figure(lo))];
    }
    let rough = (hi - lo) / 8.0;
    let power = 10f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|factor| factor * power >= rough * 0.999);
    let step = factor.unwrap_or(10.0) * power;
    let decimals = (-step.log10().floor()).clamp(0.0, 6.0) as usize;
    let first = (lo / step).ceil() as i64;
    let last = (hi / step).floor() as i64;
    (first..=last.min(first + 40))
        .map(|tick| tick as f64 * step)
        .map(|value| (value, fixed(value, decimals)))
        .collect()
}

#[cfg(test)]
mod tests {
    use peernet_logger::stage;
    use peernet_store::Figures;

    use super::*;

    fn histogram() -> Histogram {
        Histogram {
            stage: stage::TOTAL,
            unit: "s".into(),
            edges: vec![0.014, 0.016, 0.018, 0.020],
            counts: vec![40, 900, 25],
            beyond: 35,
            figures: Figures {
                count: 1_000,
                mean: 0.0162,
                std: Some(0.001),
                min: 0.014,
                p50: 0.0161,
                p95: Some(0.0176),
                p99: Some(0.0251),
                max: 0.044,
            },
        }
    }

    #[test]
    fn quantiles_are_marked_and_what_lies_beyond_is_counted() {
        let plot = HistogramPlot::new(&histogram(), "total", DistributionView::Histogram, false);
        assert_eq!(
            plot.marks.iter().map(|mark| mark.text.as_str()).collect::<Vec<_>>(),
            ["median 16.1", "p95 17.6"]
        );
        assert_eq!(plot.beyond.as_deref(), Some("35 beyond 20.0\u{202f}ms →"));
        assert_eq!(plot.bars.len(), 3);
        let html = plot.to_string();
        assert!(html.contains("Distribution of total: median 16.1\u{202f}ms, p95 17.6\u{202f}ms"), "{html}");
    }

    #[test]
    fn labels_of_quantiles_do_not_meet_on_a_phone() {
        let rows = |p50, p95, p99| {
            let mut close = histogram();
            close.edges = vec![0.0, 0.5, 1.0, 2.0];
            (close.figures.p50, close.figures.p95, close.figures.p99) = (p50, Some(p95), Some(p99));
            let plot = HistogramPlot::new(&close, "total", DistributionView::Histogram, false);
            plot.marks.iter().map(|mark| (mark.anchor, mark.row)).collect::<Vec<_>>()
        };
        assert_eq!(rows(0.8, 1.030, 1.9), [("end", 0), ("start", 0), ("end", 1)]);
        assert_eq!(rows(0.1, 0.2, 0.3), [("start", 0), ("start", 1), ("start", 2)]);
        assert_eq!(rows(0.1, 0.2, 0.9), [("start", 0), ("start", 1), ("start", 0)]);
    }

    #[test]
    fn few_samples_are_counted_in_whole_steps() {
        let mut few = histogram();
        (few.counts, few.beyond) = (vec![1, 0, 0], 0);
        let plot = HistogramPlot::new(&few, "total", DistributionView::Histogram, false);
        let labels: Vec<&str> = plot.rows.iter().map(|(_, label)| label.as_str()).collect();
        assert_eq!(labels, ["0", "1", "2", "3", "4"]);
    }

    #[test]
    fn a_running_sum_rises_to_what_the_bins_hold() {
        let plot = HistogramPlot::new(&histogram(), "total", DistributionView::Cumulative, false);
        let heights: Vec<f64> = plot.bars.iter().map(|bar| bar[3].0).collect();
        assert!(heights.is_sorted());
        assert!((heights[2] - 96.5).abs() < 1e-9, "{heights:?}");
    }

    #[test]
    fn a_logarithmic_scale_shows_single_samples() {
        let mut one = histogram();
        one.counts = vec![1, 1_000, 0];
        let plot = HistogramPlot::new(&one, "total", DistributionView::Histogram, true);
        assert_eq!(plot.bars[0][3], Percent(4.0));
        assert_eq!(plot.bars[1][3], Percent(100.0));
    }

    #[test]
    fn one_bin_of_no_width_is_drawn_without_panic() {
        let mut flat = histogram();
        flat.edges = vec![0.016, 0.016];
        flat.counts = vec![7];
        assert!(
            !HistogramPlot::new(&flat, "upload", DistributionView::Histogram, true).to_string().is_empty()
        );
    }
}
