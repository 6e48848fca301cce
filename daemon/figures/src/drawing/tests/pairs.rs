//! Tests of distributions side by side, and of points with distributions at the sides.

use super::*;
use crate::look::series;

/// Returns values that are dense around `middle`, which is in milliseconds.
fn hill(middle: f64, count: u32) -> SortedValues {
    millis((0..count).map(|i| middle * (1.0 + 0.4 * ((f64::from(i) + 0.5) / f64::from(count) - 0.5).powi(3))))
}

fn paired(groups: Vec<Vec<SortedValues>>) -> Paired {
    let group =
        |(number, values): (usize, Vec<SortedValues>)| Group { name: format!("model-{number}"), values };
    Paired {
        title: "Inference by model".to_owned(),
        unit: Unit::milliseconds("Inference"),
        placements: ["local", "remote"].map(str::to_owned).to_vec(),
        groups: groups.into_iter().enumerate().map(group).collect(),
        notes: vec!["n = 7".to_owned()],
    }
}

#[test]
fn many_values_are_a_shape_and_few_values_are_points() {
    let figure = paired(vec![vec![hill(50.0, 400), hill(20.0, 400)], vec![hill(90.0, 9), hill(30.0, 0)]]);
    let svg = figure.svg();
    // The two shapes have hundreds of corners.
    let shapes = Elements::of(&svg, "path").0.into_iter().filter(|path| path["d"].len() > 300);
    assert_eq!(shapes.count(), 2, "{svg}");
    // There are nine points, a swatch in the legend, and two medians, each with a rim.
    assert_eq!(Elements::of(&svg, "circle").0.len(), 9 + 1 + 2 * 2, "{svg}");
    for text in ["2.50 ×", "model-0", "model-1", "local", "remote", "Inference, ms"] {
        assert!(has_text(&svg, text), "{text} in {:?}", texts(&svg));
    }
    assert!(
        figure.caption_text().contains("above a pair: median local ÷ remote"),
        "{}",
        figure.caption_text()
    );
    // Without this note, a reader who counts the marks would find one value too many.
    assert!(
        figure.caption_text().contains("the black mark among the points is the median"),
        "{}",
        figure.caption_text()
    );
    assert!(!paired(vec![vec![hill(50.0, 400), hill(20.0, 400)]]).caption_text().contains("black mark"));
    assert_valid_file(&svg);
}

#[test]
fn very_different_models_share_logarithmic_axis() {
    let figure = paired(vec![vec![hill(0.5, 400), hill(0.2, 9)], vec![hill(9000.0, 400), hill(3000.0, 400)]]);
    let svg = figure.svg();
    for text in ["Inference, ms (log scale)", "1", "10,000"] {
        assert!(has_text(&svg, text), "{text} in {:?}", texts(&svg));
    }
    assert_valid_file(&svg);
    let zero = paired(vec![vec![millis([0.0, 1.0, 2.0]), hill(9000.0, 400)]]);
    assert!(has_text(&zero.svg(), "Inference, ms"), "an axis with zero must be linear");
}

#[test]
fn long_model_names_remain_distinct() {
    let mut figure = paired(vec![vec![hill(50.0, 9), hill(20.0, 9)]; 6]);
    for (group, size) in figure.groups.iter_mut().zip(["s", "m", "l", "x", "y", "z"]) {
        group.name = format!("efficientnet_v2_{size}_with_a_very_long_suffix_int8");
    }
    let svg = figure.svg();
    for name in ["…s…", "…m…", "…z…"] {
        assert!(has_text(&svg, name), "{name} in {:?}", texts(&svg));
    }
}

#[test]
fn shape_with_narrow_peaks_is_complete() {
    // The values are two peaks of a width of 0.4 ms and a few values far above.
    let peak = |from: f64, n: u32| (0..n).map(move |i| from + 0.4 * (f64::from(i) + 0.5) / f64::from(n));
    let values: SortedValues =
        millis(peak(2.0, 150).chain(peak(9.0, 60)).chain([20.0, 30.0, 40.0, 40.1, 40.2, 41.0]));
    let figure = paired(vec![vec![values]]);
    let picture = export::ParsedFigure::of(&figure.svg()).and_then(|parsed| parsed.pixels()).expect("drawn");
    let row_bytes = picture.width as usize * 3;
    // Twenty pixels on each side of the vertical middle line of the shape are examined. A pixel has
    // three bytes.
    let area = file::areas(&figure.figure())[0];
    let middle = (area.left + area.width / 2.0) / file::WIDTH;
    let from = (middle * f64::from(picture.width)) as usize * 3;
    // The fill of the shape (#b4b8be) is dark in this sense. The grid is not.
    let is_dark = |row: &[u8]| {
        row[from - 60..from + 60].chunks_exact(3).any(|pixel| pixel.iter().all(|channel| *channel < 0xc8))
    };
    // The examined rows lie in the plot: below the title of its vertical axis and above its
    // horizontal axis.
    let rows: Vec<usize> = (250..picture.height as usize - 170)
        .filter(|y| is_dark(&picture.rgb[y * row_bytes..(y + 1) * row_bytes]))
        .collect();
    let (first, last) = (rows[0], rows[rows.len() - 1]);
    assert!(last - first > 400, "{first} {last}");
    assert_eq!(rows.len(), last - first + 1, "a row of pixels is missing in the shape");
}

#[test]
fn counts_are_below_distributions_or_in_notes() {
    let svg = paired(vec![vec![hill(50.0, 400), hill(20.0, 9)]]).svg();
    assert!(has_text(&svg, "n = 400") && has_text(&svg, "n = 9"), "{:?}", texts(&svg));
    let many = paired(vec![vec![hill(50.0, 400), hill(20.0, 9)]; 12]);
    let svg = many.svg();
    assert!(
        many.caption_text().contains("n = 9 to 400 each") && !has_text(&svg, "n = 9"),
        "{:?}",
        texts(&svg)
    );
    assert_valid_file(&svg);
}

#[test]
fn values_above_the_shape_are_counted() {
    let with_late_value = hill(20.0, 400).values().iter().copied().chain([90.0]).collect();
    let figure = paired(vec![vec![hill(50.0, 400), with_late_value]]);
    assert!(has_text(&figure.svg(), "+1"), "{:?}", texts(&figure.svg()));
    assert!(
        figure.caption_text().contains("+ and a number: number of higher values that are not drawn"),
        "{}",
        figure.caption_text()
    );
}

/// Returns the vertical position of a text, points from the top.
fn text_y(svg: &str, wanted: &str) -> f64 {
    let element = svg.split("<text ").find(|element| element.contains(&format!(">{wanted}<")));
    let y = element.and_then(|element| element.split(" y=\"").nth(1)?.split('"').next());
    y.and_then(|y| y.parse().ok()).expect("the text")
}

#[test]
fn count_of_values_above_does_not_touch_highest_point() {
    let with_late_value = |late_value: f64| {
        hill(20.0, 30).values().iter().copied().chain([late_value / 1e3]).collect::<SortedValues>()
    };
    let figure = paired(vec![
        vec![with_late_value(40.0), hill(60.0, 30)],
        vec![with_late_value(90.0), hill(50.0, 30)],
    ]);
    let svg = figure.svg();
    assert!(
        has_text(&svg, "+1") && !has_text(&svg, "+2"),
        "the value at 40 ms must be drawn: {:?}",
        texts(&svg)
    );
    // The first placement has 31 points in the first group and, without the value at 90 ms, 30
    // points in the second.
    let discs = Elements::of(&svg, "circle").with("fill", &series(0).fill.to_string()).numbers("cy");
    assert_eq!(discs.len(), 31 + 30, "{discs:?}");
    let highest_of_second = discs[31..].iter().copied().fold(f64::INFINITY, f64::min);
    // The radius of a point is 1.8.
    assert!(text_y(&svg, "+1") <= highest_of_second - 1.8, "{} {highest_of_second}", text_y(&svg, "+1"));
}

#[test]
fn unusual_values_give_valid_pairs() {
    for values in
        [vec![], vec![5.0], vec![5.0; 300], vec![-2.0, -1.0, 4.0], vec![f64::NAN, 3.0, f64::INFINITY]]
    {
        let figure = paired(vec![vec![millis(values.clone()), millis([])]]);
        let svg = figure.svg();
        assert_eq!(
            has_text(&svg, "no values"),
            values.is_empty() || values.iter().any(|v| v.is_infinite()),
            "{values:?}"
        );
        assert_valid_file(&svg);
    }
}

fn lengths(points: Vec<(f64, f64)>) -> Lengths {
    Lengths {
        title: "Inference against tokens".to_owned(),
        x: Unit { title: "Tokens".to_owned(), symbol: "".into(), per_si: 1.0 },
        y: Unit::milliseconds("Inference"),
        stage: "inference".to_owned(),
        points,
        line: None,
        notes: vec!["n = 3".to_owned()],
    }
}

#[test]
fn points_have_distributions_of_both_quantities() {
    let figure = lengths((0..100).map(|i| (f64::from(i), f64::from(i) * 2e-3)).collect());
    let svg = figure.svg();
    let dots = Elements::of(&svg, "path").with("stroke-width", "2.4");
    let places: Vec<(f64, f64)> = dots.0[0]["d"]
        .split('M')
        .skip(1)
        .filter_map(|dot| dot.split('L').next()?.split_once(' '))
        .map(|(x, y)| (x.parse().expect("a number"), y.parse().expect("a number")))
        .collect();
    assert_eq!(places.len(), 100);
    assert!((places[50].0 - f64::midpoint(places[0].0, places[99].0)).abs() < 1.5, "{svg}");
    assert!(places[0].1 > places[99].1, "{svg}");
    let bars = Elements::of(&svg, "rect").with("fill", "#8a94a3");
    assert!(bars.0.len() >= 16, "{svg}");
    assert!(["Tokens", "Inference, ms"].iter().all(|text| has_text(&svg, text)));
    assert_valid_file(&svg);
}

#[test]
fn figure_of_100000_points_is_small_file() {
    let point = |i: u32| (f64::from(i % 977), f64::from(i % 977) * 1e-3 + f64::from(i % 31) * 1e-3);
    let figure = lengths((0..100_000).map(point).collect());
    let svg = figure.svg();
    assert!(svg.len() < 200_000, "{}", svg.len());
}

#[test]
fn unusual_points_give_valid_figure() {
    for points in
        [vec![], vec![(3.0, 4.0)], vec![(3.0, 4.0); 90], vec![(-3.0, f64::NAN), (1.0, -2.0), (2.0, 1.0)]]
    {
        let figure = lengths(points.clone());
        let svg = figure.svg();
        assert_eq!(has_text(&svg, "no values"), points.is_empty(), "{points:?}");
        assert_valid_file(&svg);
    }
    let with_far_point = (0..300).map(|i| (f64::from(i % 50), 0.1)).chain([(1e6, 0.1)]).collect();
    assert!(has_text(&lengths(with_far_point).svg(), "1 beyond the axes"));
}
