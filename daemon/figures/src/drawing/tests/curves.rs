//! Tests of cumulative distributions.

use super::*;
use crate::look::{Style, series};

fn curve(number: usize, values: SortedValues) -> CumulativeCurve {
    let look = series(number);
    let (line, mark): (Style, _) = (look.line(0.9), (look.mark, look.marks()));
    CumulativeCurve { name: format!("configuration {number}"), line, mark, values }
}

fn cumulative(values: Vec<SortedValues>) -> Cumulative {
    Cumulative {
        title: "Total by configuration".to_owned(),
        unit: Unit::milliseconds("Total"),
        curves: values.into_iter().enumerate().map(|(number, values)| curve(number, values)).collect(),
        notes: vec!["n = 9 each".to_owned()],
    }
}

#[test]
fn curve_rises_from_bottom_to_top_of_plot() {
    let figure = cumulative(vec![millis((0..=1000).map(f64::from))]);
    let svg = figure.svg();
    let path = &Elements::of(&svg, "path").with("fill", "none").0[0]["d"];
    let points: Vec<(f64, f64)> = path
        .split(['M', 'L'])
        .filter_map(|point| point.split_once(' '))
        .map(|(x, y)| (x.parse().expect("a number"), y.parse().expect("a number")))
        .collect();
    let area = file::areas(&figure.figure())[0];
    let (first, last) = (points[0], points[points.len() - 1]);
    assert!(
        (first.1 - area.top - area.height).abs() < 0.1 && (last.1 - area.top).abs() < 0.1,
        "{first:?} {last:?}"
    );
    // The curve of evenly spaced values is a straight line.
    let middle = points[points.len() / 2];
    let (x, y) = (f64::midpoint(first.0, last.0), f64::midpoint(first.1, last.1));
    assert!((middle.0 - x).abs() < 1.0 && (middle.1 - y).abs() < 1.0, "{middle:?}");
    assert!(
        has_text(&svg, "Share of iterations, %") && has_text(&svg, "Total by configuration · n = 9 each")
    );
    assert_valid_file(&svg);
}

#[test]
fn values_beyond_axis_are_counted_per_curve() {
    let with_late_value =
        |late_value: f64| millis((0..400).map(|i| 10.0 + f64::from(i % 50)).chain([late_value]));
    // All values but one lie between 10 and 59 ms, so the axis ends between 60 and 70 ms.
    let single = cumulative(vec![with_late_value(9e4)]);
    assert!(
        texts(&single.svg()).iter().any(|text| text.starts_with("1 beyond 6")),
        "{:?}",
        texts(&single.svg())
    );
    let two = cumulative(vec![with_late_value(9e4), with_late_value(8e4)]);
    let note = "beyond the axis: 1 of configuration 0, 1 of configuration 1";
    assert!(two.caption_text().contains(note), "{}", two.caption_text());
}

#[test]
fn values_below_axis_are_counted_per_curve() {
    let with_early_value =
        |early_value: f64| millis((0..400).map(|i| 100.0 + f64::from(i % 50)).chain([early_value, 9e4]));
    // All values but two lie between 100 and 149 ms, so the axis begins at 100 ms.
    let single = cumulative(vec![with_early_value(0.1)]).svg();
    assert!(has_text(&single, "← 1 below 100 ms · 1 beyond 149 ms →"), "{:?}", texts(&single));
    let two = cumulative(vec![with_early_value(0.1), with_early_value(120.0)]);
    let note = "beyond the axis: 2 of configuration 0, 1 of configuration 1";
    assert!(two.caption_text().contains(note), "{}", two.caption_text());
}

#[test]
fn curves_far_apart_have_logarithmic_axis() {
    let far_apart = cumulative(vec![millis([1.0, 1.1, 1.2]), millis([900.0, 910.0])]);
    assert!(has_text(&far_apart.svg(), "Total, ms (log scale)"), "{:?}", texts(&far_apart.svg()));
    assert_valid_file(&far_apart.svg());
}

#[test]
fn unusual_values_give_valid_curves() {
    for values in [vec![], vec![7.0], vec![0.0; 30], vec![-2.0, 1.0], vec![f64::NAN, 3.0, f64::INFINITY]] {
        let figure = cumulative(vec![millis(values.clone()), millis([])]);
        assert_valid_file(&figure.svg());
        assert!(!values.is_empty() || has_text(&figure.svg(), "no values"));
    }
}
