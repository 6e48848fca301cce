//! Tests of values against size, and of a quality against latency.

use super::*;
use crate::look::Mark;
use peernet_analysis::quality::Quality;

/// Returns a figure of three values with this line. `bound` is the distance of the bounds from each value, as a share
/// of the value.
fn scaling(line: Option<(f64, f64)>, bound: Option<f64>) -> Scaling {
    let value = |bytes: f64| Value {
        bytes,
        value: bytes * 1e3,
        p5_and_p95: None,
        bounds: bound.map(|share| (bytes * 1e3 * (1.0 - share), Some(bytes * 1e3 * (1.0 + share)))),
    };
    Scaling {
        title: "Throughput against payload".to_owned(),
        unit: Unit { title: "Throughput, bit/s".to_owned(), symbol: "".into(), per_si: 1.0 },
        explanations: Explanations {
            point: "size ÷ median delay",
            whisker: "by clock bounds",
            line: "by slope",
        },
        notes: Vec::new(),
        series: vec![Series {
            name: "upload: 7 MB/s".to_owned(),
            stage: "upload",
            mark: Mark::Disc,
            values: [1e3, 1e4, 1e5].map(value).to_vec(),
            line,
        }],
    }
}

/// Returns the vertical positions of the points of the series' line.
fn line_ys(svg: &str) -> Vec<f64> {
    let lines = Elements::of(svg, "path").with("stroke", "#d55e00");
    let points = |line: &HashMap<String, String>| -> Vec<f64> {
        line["d"].split(['M', 'L']).filter_map(|point| point.split(' ').nth(1)?.parse().ok()).collect()
    };
    lines.0.iter().flat_map(points).collect()
}

#[test]
fn horizontal_line_is_drawn_unless_too_far_from_values() {
    let figure = scaling(Some((1e9, 0.0)), None);
    let svg = figure.svg();
    let discs = Elements::of(&svg, "circle").numbers("cy");
    // The first disc is the swatch in the legend. The other discs are a decade apart, and the line is a decade above
    // the last.
    let decade = discs[2] - discs[3];
    let ys = line_ys(&svg);
    assert!(!ys.is_empty() && ys.iter().all(|y| (discs[3] - y - decade).abs() < 0.5), "{discs:?} {ys:?}");
    assert!(
        figure.caption_text().contains("point: size ÷ median delay · line: by slope"),
        "{}",
        figure.caption_text()
    );
    assert_valid_file(&svg);
    let far_line = scaling(Some((1e11, 0.0)), None);
    assert!(line_ys(&far_line.svg()).is_empty());
    for text in ["point: size ÷ median delay\n", "far beyond the axis and not drawn: the line of upload"] {
        assert!(far_line.caption_text().contains(text), "{text}: {}", far_line.caption_text());
    }
}

#[test]
fn line_ends_at_bottom_of_plot() {
    let svg = scaling(Some((-2e6, 1e3)), None).svg();
    let discs = Elements::of(&svg, "circle").numbers("cy");
    let decade = discs[2] - discs[3];
    // The values span two decades. The axis begins below the smallest value by 0.06 times the length of this span.
    let bottom = discs[1] + 0.06 * 2.0 * decade;
    let lowest = line_ys(&svg).into_iter().fold(0.0, f64::max);
    assert!((lowest - bottom).abs() < 0.1, "{lowest} {bottom}");
}

#[test]
fn whisker_is_explained_only_if_bounds_differ() {
    let has_whisker =
        |share: f64| scaling(None, Some(share)).caption_text().contains("whisker: by clock bounds");
    assert!(
        has_whisker(0.2) && !has_whisker(0.0),
        "equal bounds have no whisker, because one clock stamped departure and arrival"
    );
}

/// Returns the point of a configuration with `right` right answers out of `count`. `median` is in seconds.
fn point(label: &str, right: u64, count: u64, median: f64) -> QualityPoint {
    let statistics = (count, right as f64 / count as f64, None);
    let estimate = Quality::Top1.from_statistics(|_| Some(statistics)).expect("has answers");
    QualityPoint { label: label.to_owned(), estimate, median, p95: (count >= 60).then_some(median * 1.5) }
}

fn quality_figure(points: Vec<QualityPoint>) -> QualityAgainstLatency {
    QualityAgainstLatency {
        quality: Quality::Top1,
        latency_unit: Unit::milliseconds("Total"),
        points,
        notes: vec!["n = 100 each".to_owned()],
    }
}

#[test]
fn each_configuration_is_numbered_point() {
    let points = vec![point("s", 70, 100, 0.02), point("m", 80, 100, 0.04), point("l", 90, 100, 0.041)];
    let figure = quality_figure(points);
    let svg = figure.svg();
    let discs = Elements::of(&svg, "circle").with("fill", "#14181f");
    let (x, y) = (discs.numbers("cx"), discs.numbers("cy"));
    assert_eq!(x.len(), 3, "{svg}");
    assert!(x[0] < x[1] && x[1] < x[2] && y[0] > y[1] && y[1] > y[2], "{x:?} {y:?}");
    assert!(((y[1] - y[2]) - (y[0] - y[1])).abs() < 0.6, "70, 80 and 90 % are not evenly spaced: {y:?}");
    for text in ["s", "m", "l", "Top-1 accuracy, %", "Total, ms", "Accuracy against latency · n = 100 each"]
    {
        assert!(has_text(&svg, text), "{text} in {:?}", texts(&svg));
    }
    // A line of the table has the number, the name, the accuracy, the median and the 95th percentile.
    let texts = texts(&svg);
    assert!(texts.windows(5).any(|line| line == ["2", "m", "80.0", "40.0", "60.0"]), "{texts:?}");
    let count = |number: &str| texts.iter().filter(|text| *text == number).count();
    assert_eq!(
        ["1", "2", "3"].map(count),
        [2, 2, 2],
        "each number is at its point and in the table: {texts:?}"
    );
    assert!(figure.caption_text().contains("across: to the 95th percentile"), "{}", figure.caption_text());
    assert_valid_file(&svg);
}

#[test]
fn overlapping_horizontal_whiskers_are_omitted() {
    let figure = quality_figure(vec![
        point("a", 100, 100, 0.02),
        point("b", 100, 100, 0.025),
        point("c", 99, 100, 0.1),
    ]);
    let svg = figure.svg();
    assert!(!figure.caption_text().contains("across"), "{}", figure.caption_text());
    assert!(
        has_text(&svg, "p95, ms") && has_text(&svg, "37.5"),
        "the table has the percentiles: {:?}",
        texts(&svg)
    );
    let discs = Elements::of(&svg, "circle").with("fill", "#14181f").numbers("cy");
    assert_eq!(discs[0], discs[1], "points of equal accuracy have equal heights");
    let separate = quality_figure(vec![point("a", 100, 100, 0.02), point("b", 100, 100, 0.04)]);
    assert!(separate.caption_text().contains("across"), "{}", separate.caption_text());
}

#[test]
fn numbers_of_coinciding_points_do_not_overlap() {
    let figure = quality_figure((0..9).map(|_| point("x", 100, 100, 0.02)).collect());
    let svg = figure.svg();
    let coordinates = |attribute: &str| {
        let texts = svg.split("<text ").skip(1).filter(|text| {
            let content = text.split('>').nth(1).and_then(|text| text.split('<').next()).unwrap_or_default();
            content.trim().parse::<u32>().is_ok_and(|number| (1..=9).contains(&number))
        });
        let value =
            |text: &str| text.split(&format!("{attribute}=\"")).nth(1)?.split('"').next()?.parse().ok();
        texts.filter_map(value).collect::<Vec<f64>>()
    };
    // The numbers in the plot come first, then the numbers in the table.
    let places: Vec<(f64, f64)> = coordinates("x").into_iter().zip(coordinates("y")).take(9).collect();
    assert_eq!(places.len(), 9, "{svg}");
    for (index, (x, y)) in places.iter().enumerate() {
        let is_separate = |(a, b): &(f64, f64)| (a - x).abs() >= 3.0 || (b - y).abs() >= 6.0;
        assert!(places[index + 1..].iter().all(is_separate), "{places:?}");
    }
}

#[test]
fn extreme_qualities_give_valid_figure() {
    let coinciding_points =
        (0..24).map(|i| point(&format!("configuration {i} with a long name"), 50, 100, 0.02)).collect();
    let cases = [
        vec![],
        vec![point("never", 0, 9, 1e-6)],
        vec![point("always", 9, 9, 3.0), point("slow", 1, 90, 9e3)],
        vec![point("no time", 3, 9, f64::NAN)],
        coinciding_points,
    ];
    for points in cases {
        let figure = quality_figure(points);
        let svg = figure.svg();
        assert_eq!(has_text(&svg, "no values"), figure.points.iter().all(|point| point.median.is_nan()));
        assert_valid_file(&svg);
    }
}
