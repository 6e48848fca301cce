//! Tests of distributions that pages draw from sketches.

use peernet_statistics::Summary;
use peernet_statistics::histogram::{Binning, MAX_BINS};

use super::super::{BinnedAxis, CountNoun, Distribution, Joint, Quartiles, View};
use crate::look::stage;
use crate::plot::{Anchor, Item, Plot, Unit};
use crate::render::page;
use crate::scale::Scale;

fn summary(values: impl IntoIterator<Item = f64>) -> Summary {
    let mut summary = Summary::default();
    values.into_iter().for_each(|value| summary.record(value));
    summary
}

/// Returns the summary of values that are given in milliseconds.
fn seconds(milliseconds: impl IntoIterator<Item = f64>) -> Summary {
    summary(milliseconds.into_iter().map(|value| value / 1e3))
}

/// Returns an axis in ms for all these distributions.
fn axis_in_ms<'a>(all: impl IntoIterator<Item = &'a Summary>) -> Option<BinnedAxis> {
    BinnedAxis::around(all.into_iter(), Unit::symbol("ms", 1e3))
}

/// Returns the left end, top, right end and bottom of each rectangle of a class.
fn rects(items: &[Item], class: &str) -> Vec<[f64; 4]> {
    let rect = |item: &Item| match item {
        Item::Rect { from, to, style, .. } if style.class == class => Some([from.x, from.y, to.x, to.y]),
        _ => None,
    };
    items.iter().filter_map(rect).collect()
}

#[test]
fn box_and_whiskers_end_at_percentiles() {
    let quartiles = Quartiles::of(&seconds((1..=101).map(f64::from))).expect("samples");
    let html = page::picture(&quartiles.items("total", &Scale::up_to(100.0, 5)), "stages", "");
    // Returns the percentage after `attribute` in the first element that contains `element`.
    let number = |element: &str, attribute: &str| -> f64 {
        let rest = html.split(element).nth(1).and_then(|rest| rest.split(attribute).nth(1)).expect("a value");
        rest.split('%').next().and_then(|number| number.parse().ok()).expect("a number")
    };
    let (box_start, box_width) = (number("<rect", " x=\""), number("<rect", " width=\""));
    let [low, high] = [" x1=\"", " x2=\""].map(|end| number("class=\"whisk2\"", end));
    let median = number("class=\"halo\"", " x1=\"");
    let positions =
        [(low, 6.0), (box_start, 26.0), (median, 51.0), (box_start + box_width, 76.0), (high, 96.0)];
    for (position, expected) in positions {
        assert!((position - expected).abs() < 0.011 * expected, "{position} {expected} {html}");
    }
    assert!((number("<circle", " cx=\"") - 51.0).abs() < 1e-9, "{html}");
    assert!(quartiles.description().starts_with("median 5"), "{}", quartiles.description());
}

#[test]
fn few_samples_have_box_without_whiskers() {
    let few = Quartiles::of(&seconds((1..=59).map(f64::from))).expect("samples");
    assert_eq!((few.tails, few.count), (None, 59));
    assert!(Quartiles::of(&seconds((1..=60).map(f64::from))).expect("samples").tails.is_some());
    assert_eq!(Quartiles::of(&Summary::default()), None);
}

#[test]
fn histograms_share_axis_and_fill_their_height() {
    let all = [seconds((0..200).map(|n| 10.0 + f64::from(n) / 200.0)), seconds([14.0; 50])];
    let axis = axis_in_ms(&all).expect("samples");
    let bars =
        all.each_ref().map(|values| rects(&axis.histogram(values, &stage("total"), None), "bin f-total"));
    let last_bar_left = |bars: &[[f64; 4]]| bars.last().map_or(0.0, |bar| bar[0]);
    assert!(last_bar_left(&bars[0]) < 0.3 && last_bar_left(&bars[1]) > 0.9, "{bars:?}");
    assert!(bars.iter().all(|bars| bars.iter().any(|bar| bar[1].abs() < 1e-9)), "{bars:?}");
}

#[test]
fn outlier_is_counted_and_does_not_extend_axis() {
    let summary = seconds((0..1_000).map(|n| if n == 0 { 1_000.0 } else { 10.0 + f64::from(n) / 100.0 }));
    let axis = axis_in_ms([&summary]).expect("samples");
    assert!(!axis.scale.is_logarithmic() && (1..=3).contains(&axis.beyond(&summary).1), "{axis:?}");
    assert_eq!(axis_in_ms([&Summary::default()]), None);
    let equal = seconds([14.0; 10]);
    let axis = axis_in_ms([&equal]).expect("samples");
    assert_eq!((axis.beyond(&equal), axis.bars(&equal).len()), ((0, 0), 1), "{axis:?}");
}

#[test]
fn axis_has_range_and_bins_of_histogram() {
    // Uploads of 5 to 6 ms, one of 0.02 ms and one of 300 ms.
    let upload_ms =
        |n: u32| [0.02, 300.0].get(n as usize).copied().unwrap_or(5.0 + f64::from(n * 37 % 1_000) / 1e3);
    let uploads = seconds((0..10_000).map(upload_ms));
    let binning = Binning::of(&uploads, MAX_BINS).expect("values");
    let outside = uploads.count_in(&binning.edges(), binning.range);
    assert_eq!((outside.below, outside.above), (1, 1));
    let single = axis_in_ms([&uploads]).expect("values");
    assert!(!single.scale.is_logarithmic() && single.bars(&uploads).len() <= binning.count, "{single:?}");
    for axis in [&single, &axis_in_ms([&uploads, &uploads]).expect("values")] {
        assert_eq!(axis.beyond(&uploads), (1, 1), "{axis:?}");
        let (lo, hi) = axis.range();
        assert!((lo - binning.range.0).abs() < 1e-9 && (hi - binning.range.1).abs() < 1e-9, "{axis:?}");
        assert!((axis.at(0.02e-3), axis.at(0.3)) == (None, None) && axis.at(5.5e-3).is_some());
    }
}

#[test]
fn runs_a_decade_apart_have_logarithmic_axis() {
    let all = [seconds((1..100).map(f64::from)), seconds((500..600).map(f64::from))];
    let axis = axis_in_ms(&all).expect("samples");
    assert!(axis.scale.is_logarithmic() && axis.axis().page_title() == "ms, logarithmic", "{axis:?}");
}

#[test]
fn interval_of_median_is_drawn_as_band() {
    let rates = summary((80..120).map(|n| f64::from(n) * 1e6));
    let axis = BinnedAxis::around([&rates].into_iter(), Unit::symbol("MB/s", 1.0 / 8e6)).expect("samples");
    assert_eq!((axis.axis().page_title().as_str(), axis.scale.ticks(5)[0].text.as_str()), ("MB/s", "10"));
    let items = axis.histogram(&rates, &stage("upload"), Some((90e6, f64::INFINITY)));
    let band = rects(&items, "band")[0];
    assert!(
        band[0] > 0.1 && band[2] == 1.0,
        "a band without an upper end must reach the end of the axis: {band:?}"
    );
    assert!(!rects(&items, "bin f-upload").is_empty());
}

/// Returns the number of tokens and the latency in seconds of answers of a language model.
fn answer_lengths(count: u32) -> Vec<(f64, f64)> {
    (0..count).map(|n| (f64::from(50 + n % 300), 1e-3 * f64::from(100 + n % 300))).collect()
}

/// Returns the plot of these points, whether cells replace the points, and the number of latencies above the axis.
fn joint(points: &[(f64, f64)], line: Option<(f64, f64)>) -> (Plot, bool, u64) {
    let [x, y] = [summary(points.iter().map(|point| point.0)), summary(points.iter().map(|point| point.1))];
    let x_axis = BinnedAxis::from_zero([&x].into_iter(), Unit::symbol("tokens", 1.0)).expect("values");
    let y_axis = BinnedAxis::from_zero([&y].into_iter(), Unit::symbol("ms", 1e3)).expect("values");
    let joint = Joint { stage: stage("inference"), points, x: (&x_axis, &x), y: (&y_axis, &y), line };
    (joint.plot(), joint.has_cells(), y_axis.beyond(&y).1)
}

#[test]
fn joint_plot_has_points_and_both_distributions() {
    let (plot, has_cells, _) = joint(&answer_lengths(300), Some((0.05, 1e-3)));
    let html = page::plot(&plot, "joint", "A");
    let dots = html.split("class=\"dots d-inference\" d=\"").nth(1).and_then(|rest| rest.split('"').next());
    let dots = dots.expect("dots");
    // The first point has 50 tokens on an axis that ends at 400, and 100 ms on an axis that ends at 500. The `viewBox`
    // is 1,000 wide and high, and positions are measured from the top.
    assert!(dots.starts_with("M125 800L") && dots.matches('M').count() == 300 && !has_cells, "{dots}");
    assert!(html.contains("<path class=\"fit\"") && !html.contains("class=\"halo\""), "{html}");
    for strip in [plot.top_strip, plot.right_strip] {
        let bars = rects(&strip.expect("a strip").items, "bin f-total");
        assert!(bars.len() > 40 && bars.iter().all(|bar| bar[3] <= 1.0), "{bars:?}");
    }
}

#[test]
fn line_ends_where_it_leaves_the_plot() {
    // The longest answer has 349 tokens and took 399 ms. The line is at 748 ms there, above the end of the axis.
    let (plot, ..) = joint(&answer_lengths(300), Some((0.05, 2e-3)));
    let html = page::plot(&plot, "joint", "A");
    let line = html.split("<path class=\"fit\" d=\"").nth(1).and_then(|rest| rest.split('"').next());
    let pieces = line.expect("a line").matches('L').count();
    assert!((30..50).contains(&pieces), "{pieces} in {html}");
}

#[test]
fn cells_replace_many_points_and_outliers_are_counted() {
    let (plot, has_cells, _) = joint(&answer_lengths(500), Some((0.05, 1e-3)));
    let html = page::plot(&plot, "joint", "A");
    assert!(has_cells && html.contains("fill-opacity") && html.contains("class=\"halo\""), "{html}");
    let mut points = answer_lengths(300);
    points.push((60.0, 30.0));
    let (plot, _, beyond) = joint(&points, None);
    let html = page::plot(&plot, "joint", "A");
    let dots = html.split("class=\"dots").nth(1).and_then(|rest| rest.split("/>").next()).expect("dots");
    assert_eq!((dots.matches('M').count(), beyond), (300, 1));
    assert_eq!(joint(&points[..300], None).2, 0);
}

#[test]
fn negative_values_have_different_positions() {
    let points: Vec<_> = (0..45).map(|n| (f64::from(n % 9) * -5.0, 0.1 + f64::from(n) * 1e-3)).collect();
    let (plot, ..) = joint(&points, None);
    let ends: Vec<f64> = [-40.0, -20.0, 0.0].map(|value| plot.x.scale.at(value)).to_vec();
    assert_eq!(ends, [0.0, 0.5, 1.0]);
    assert!(page::plot(&plot, "joint", "").contains("\u{2212}40"));
    let all = summary([-40.0, -10.0]);
    let axis = BinnedAxis::from_zero([&all].into_iter(), Unit::symbol("tokens", 1.0)).expect("values");
    assert_eq!((axis.beyond(&all), axis.at(-40.0), axis.at(-10.0)), ((0, 0), Some(0.0), Some(0.75)));
}

#[test]
fn axis_begins_at_zero_unless_values_are_close() {
    let first_tick_and_title = |values: &[f64]| {
        let axis =
            BinnedAxis::from_zero([&summary(values.iter().copied())].into_iter(), Unit::symbol("B", 1.0));
        axis.map(|axis| (axis.scale.ticks(5)[0].text.clone(), axis.axis().page_title())).expect("values")
    };
    assert_eq!(first_tick_and_title(&[100.0, 200.0]), ("0".to_owned(), "B".to_owned()));
    assert_eq!(
        first_tick_and_title(&[1e-320, 3.0, 2.0]),
        ("0".to_owned(), "B".to_owned()),
        "an almost zero value counts as zero"
    );
    assert!(
        first_tick_and_title(&[900.0, 1_000.0]).0 != "0" && first_tick_and_title(&[900.0, 1_000.0]).1 == "B"
    );
    assert_eq!(
        first_tick_and_title(&[10.0, 2_000.0]),
        ("0".to_owned(), "B".to_owned()),
        "the axis is linear over any range"
    );
    assert!(BinnedAxis::from_zero([&Summary::default()].into_iter(), Unit::symbol("B", 1.0)).is_none());
    assert!(BinnedAxis::from_zero([&summary([7.0, 7.0])].into_iter(), Unit::symbol("B", 1.0)).is_some());
}

fn distribution() -> Distribution {
    Distribution {
        edges: vec![0.0, 0.5, 1.0, 2.0],
        counts: vec![40, 900, 25],
        count_noun: CountNoun::Iterations,
        beyond: (0, 35),
        quantiles: vec![("median", 0.8), ("p95", 1.03), ("p99", 2.5)],
        unit: Unit::symbol("ms", 1e3),
        stage: stage("total"),
        view: View::Counts,
        is_logarithmic: false,
        min_width_em: 19.6,
    }
}

/// Returns the heights of the bars, as shares of the plot.
fn heights(distribution: &Distribution) -> Vec<f64> {
    rects(&distribution.plot().items, "bin f-total").into_iter().map(|bar| 1.0 - bar[3]).collect()
}

#[test]
fn quantile_labels_do_not_overlap_in_narrow_plot() {
    // Returns the anchor of each label and its row above the plot. The lowest row is 0.4 above the
    // plot, and the distance between two rows is 1.3, both as multiples of the type size.
    let places = |p50, p95, p99| {
        let distribution =
            Distribution { quantiles: vec![("median", p50), ("p95", p95), ("p99", p99)], ..distribution() };
        let label = |item| if let Item::Text(label) = item { Some(label) } else { None };
        let labels = distribution.plot().items.into_iter().filter_map(label);
        labels.map(|label| (label.anchor, ((-label.shift.1 - 0.4) / 1.3).round())).collect::<Vec<_>>()
    };
    use Anchor::{End, Start};
    assert_eq!(places(0.9, 1.030, 1.9), [(End, 0.0), (Start, 0.0), (End, 1.0)]);
    assert_eq!(places(0.1, 0.2, 0.3), [(Start, 0.0), (Start, 1.0), (Start, 2.0)]);
    assert_eq!(places(0.1, 0.2, 0.9)[..2], [(Start, 0.0), (Start, 1.0)]);
    assert_eq!(places(0.9, 1.03, 2.5).len(), 2, "a quantile beyond the axis has no line");
}

#[test]
fn vertical_axis_counts_whole_values() {
    let few = Distribution { counts: vec![1, 0, 0], beyond: (0, 0), ..distribution() };
    let labels: Vec<String> = few.plot().y.ticks(9).into_iter().map(|tick| tick.text).collect();
    assert_eq!(labels, ["0", "1"]);
    let titles = [CountNoun::Iterations, CountNoun::Values].map(|count_noun| {
        [View::Counts, View::Cumulative]
            .map(|view| Distribution { count_noun, view, ..distribution() }.plot().y.title)
    });
    assert_eq!(titles[0], ["Iterations", "Iterations up to here, %"]);
    assert_eq!(titles[1], ["Values", "Values up to here, %"]);
}

#[test]
fn cumulative_bars_end_at_share_within_bins() {
    let cumulative = heights(&Distribution { view: View::Cumulative, ..distribution() });
    assert!(cumulative.is_sorted() && (cumulative[2] - 0.965).abs() < 1e-9, "{cumulative:?}");
}

#[test]
fn logarithmic_axis_shows_bin_of_one_sample() {
    let logarithmic = Distribution { counts: vec![1, 1_000, 0], is_logarithmic: true, ..distribution() };
    assert!(
        heights(&logarithmic)[0] > 0.05 && heights(&logarithmic)[1] == 1.0,
        "a bin of one sample must be visible: {:?}",
        heights(&logarithmic)
    );
}
