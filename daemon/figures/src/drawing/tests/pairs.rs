//! Distributions side by side, and points with their margins.

use super::*;
use crate::look::series;

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
fn many_values_are_shape_few_are_points() {
    let figure = paired(vec![vec![hill(50.0, 400), hill(20.0, 400)], vec![hill(90.0, 9), hill(30.0, 0)]]);
    let svg = figure.svg();
    // The two shapes have hundreds of corners.
    let shapes = Elements::of(&svg, "path").0.into_iter().filter(|path| path["d"].len() > 300);
    assert_eq!(shapes.count(), 2, "{svg}");
    // Nine points, the legend's, and two medians with their rims.
    assert_eq!(Elements::of(&svg, "circle").0.len(), 9 + 1 + 2 * 2, "{svg}");
    for text in ["2.50 ×", "model-0", "model-1", "local", "remote", "Inference, ms"] {
        assert!(has(&svg, text), "{text} in {:?}", texts(&svg));
    }
    assert!(
        figure.caption_text().contains("above a pair: median local ÷ remote"),
        "{}",
        figure.caption_text()
    );
    // A reader who counts the marks finds one more than there are values.
    assert!(
        figure.caption_text().contains("the black mark among them is the median"),
        "{}",
        figure.caption_text()
    );
    assert!(!paired(vec![vec![hill(50.0, 400), hill(20.0, 400)]]).caption_text().contains("black mark"));
    assert_within_paper(&svg);
}

#[test]
fn very_different_models_share_logarithmic_axis() {
    let figure = paired(vec![vec![hill(0.5, 400), hill(0.2, 9)], vec![hill(9000.0, 400), hill(3000.0, 400)]]);
    let svg = figure.svg();
    for text in ["Inference, ms (log scale)", "1", "10,000"] {
        assert!(has(&svg, text), "{text} in {:?}", texts(&svg));
    }
    assert_within_paper(&svg);
    let zero = paired(vec![vec![millis([0.0, 1.0, 2.0]), hill(9000.0, 400)]]);
    assert!(has(&zero.svg(), "Inference, ms"), "zero has no logarithm");
}

#[test]
fn long_model_names_remain_distinct() {
    let mut figure = paired(vec![vec![hill(50.0, 9), hill(20.0, 9)]; 6]);
    for (group, size) in figure.groups.iter_mut().zip(["s", "m", "l", "x", "y", "z"]) {
        group.name = format!("efficientnet_v2_{size}_with_a_very_long_suffix_int8");
    }
    let svg = figure.svg();
    for name in ["…s…", "…m…", "…z…"] {
        assert!(has(&svg, name), "{name} in {:?}", texts(&svg));
    }
}

#[test]
fn shape_with_narrow_peaks_is_complete() {
    // The values are a peak of 0.4 ms, a second one, and a few values far above.
    let hill = |from: f64, n: u32| (0..n).map(move |i| from + 0.4 * (f64::from(i) + 0.5) / f64::from(n));
    let far: SortedValues =
        millis(hill(2.0, 150).chain(hill(9.0, 60)).chain([20.0, 30.0, 40.0, 40.1, 40.2, 41.0]));
    let figure = paired(vec![vec![far]]);
    let picture =
        export::ParsedFigure::of(&figure.svg()).and_then(|exported| exported.pixels()).expect("drawn");
    let row = picture.width as usize * 3;
    // About the middle line of the shape.
    let area = file::areas(&figure.figure())[0];
    let middle = (area.left + area.width / 2.0) / file::WIDTH;
    let from = (middle * f64::from(picture.width)) as usize * 3;
    let is_dark = |row: &[u8]| {
        row[from - 60..from + 60].chunks_exact(3).any(|pixel| pixel.iter().all(|part| *part < 0xc8))
    };
    // The rows begin below the caption.
    let rows: Vec<usize> = (250..picture.height as usize - 170)
        .filter(|y| is_dark(&picture.rgb[y * row..(y + 1) * row]))
        .collect();
    let (first, last) = (rows[0], rows[rows.len() - 1]);
    assert!(last - first > 400, "{first} {last}");
    assert_eq!(rows.len(), last - first + 1, "a row without the shape");
}

#[test]
fn each_distribution_has_its_count() {
    let svg = paired(vec![vec![hill(50.0, 400), hill(20.0, 9)]]).svg();
    assert!(has(&svg, "n = 400") && has(&svg, "n = 9"), "{:?}", texts(&svg));
    let many = paired(vec![vec![hill(50.0, 400), hill(20.0, 9)]; 12]);
    let svg = many.svg();
    assert!(many.caption_text().contains("n = 9 to 400 each") && !has(&svg, "n = 9"), "{:?}", texts(&svg));
    assert_within_paper(&svg);
}

#[test]
fn values_beyond_the_shape_are_counted() {
    let late = hill(20.0, 400).values().iter().copied().chain([90.0]).collect();
    let figure = paired(vec![vec![hill(50.0, 400), late]]);
    assert!(has(&figure.svg(), "+1"), "{:?}", texts(&figure.svg()));
    assert!(
        figure.caption_text().contains("+ and a number: number of values above the axis"),
        "{}",
        figure.caption_text()
    );
}

/// Returns the height of a text.
fn height(svg: &str, wanted: &str) -> f64 {
    let element = svg.split("<text ").find(|element| element.contains(&format!(">{wanted}<")));
    let y = element.and_then(|element| element.split(" y=\"").nth(1)?.split('"').next());
    y.and_then(|y| y.parse().ok()).expect("the text")
}

#[test]
fn spaced_points_are_drawn_without_overlapping_counts() {
    let late =
        |extra: f64| hill(20.0, 30).values().iter().copied().chain([extra / 1e3]).collect::<SortedValues>();
    let figure = paired(vec![vec![late(40.0), hill(60.0, 30)], vec![late(90.0), hill(50.0, 30)]]);
    let svg = figure.svg();
    assert!(has(&svg, "+1") && !has(&svg, "+2"), "the one at 40 ms has room: {:?}", texts(&svg));
    let discs = Elements::of(&svg, "circle").with("fill", &series(0).fill.to_string()).numbers("cy");
    assert_eq!(discs.len(), 31 + 30, "{discs:?}");
    let second = discs[31..].iter().copied().fold(f64::INFINITY, f64::min);
    assert!(height(&svg, "+1") <= second - 1.8, "{} {second}", height(&svg, "+1"));
}

#[test]
fn unusual_pairs_give_valid_figure() {
    for values in
        [vec![], vec![5.0], vec![5.0; 300], vec![-2.0, -1.0, 4.0], vec![f64::NAN, 3.0, f64::INFINITY]]
    {
        let figure = paired(vec![vec![millis(values.clone()), millis([])]]);
        let svg = figure.svg();
        assert_eq!(
            has(&svg, "no values"),
            values.is_empty() || values.iter().any(|v| v.is_infinite()),
            "{values:?}"
        );
        assert_within_paper(&svg);
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
fn points_have_a_distribution_on_both_sides() {
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
    assert!(["Tokens", "Inference, ms"].iter().all(|text| has(&svg, text)));
    assert_within_paper(&svg);
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
        assert_eq!(has(&svg, "no values"), points.is_empty(), "{points:?}");
        assert_within_paper(&svg);
    }
    let far = (0..300).map(|i| (f64::from(i % 50), 0.1)).chain([(1e6, 0.1)]).collect();
    assert!(has(&lengths(far).svg(), "1 beyond the axes"));
}
