//! Distributions side by side, and points with their margins.

use super::*;

fn hill(middle: f64, count: u32) -> Ordered {
    millis((0..count).map(|i| middle * (1.0 + 0.4 * ((f64::from(i) + 0.5) / f64::from(count) - 0.5).powi(3))))
}

fn paired(groups: Vec<Vec<Ordered>>) -> Paired {
    let group = |(number, values): (usize, Vec<Ordered>)| Group { name: format!("model-{number}"), values };
    Paired {
        title: "Inference by model".to_owned(),
        unit: Unit::milliseconds("Inference"),
        sides: ["local", "remote"].map(str::to_owned).to_vec(),
        groups: groups.into_iter().enumerate().map(group).collect(),
        notes: vec!["n = 7".to_owned()],
    }
}

#[test]
fn many_values_are_a_shape_and_few_are_points() {
    let figure = paired(vec![vec![hill(50.0, 400), hill(20.0, 400)], vec![hill(90.0, 9), hill(30.0, 0)]]);
    let svg = figure.svg().expect("drawn");
    // Two shapes; triangles are polygons as well: the key's and the second median.
    assert_eq!(Elements::of(&svg, "polygon").0.len(), 2 + 2, "{svg}");
    // Nine points and their median; the key's and the other median.
    assert_eq!(Elements::of(&svg, "circle").0.len(), 9 + 1 + 1 + 1, "{svg}");
    for text in [
        "2.50 ×",
        "model-0",
        "model-1",
        "local",
        "remote",
        "Inference, ms",
        "above a pair: median local ÷ remote",
    ] {
        assert!(has(&svg, text), "{text} in {:?}", texts(&svg));
    }
    assert_on_paper(&figure, &svg);
}

#[test]
fn models_of_very_different_latency_share_a_logarithmic_axis() {
    let figure = paired(vec![vec![hill(0.5, 400), hill(0.2, 9)], vec![hill(9000.0, 400), hill(3000.0, 400)]]);
    let svg = figure.svg().expect("drawn");
    for text in ["Inference, ms (log scale)", "1", "10,000"] {
        assert!(has(&svg, text), "{text} in {:?}", texts(&svg));
    }
    assert_on_paper(&figure, &svg);
    let zero = paired(vec![vec![millis([0.0, 1.0, 2.0]), hill(9000.0, 400)]]);
    assert!(has(&zero.svg().expect("drawn"), "Inference, ms"), "zero has no logarithm");
}

#[test]
fn long_names_of_models_stay_apart() {
    let mut figure = paired(vec![vec![hill(50.0, 9), hill(20.0, 9)]; 6]);
    for (group, size) in figure.groups.iter_mut().zip(["s", "m", "l", "x", "y", "z"]) {
        group.name = format!("efficientnet_v2_{size}_with_a_very_long_suffix_int8");
    }
    let svg = figure.svg().expect("drawn");
    for name in ["…s…", "…m…", "…z…"] {
        assert!(has(&svg, name), "{name} in {:?}", texts(&svg));
    }
}

#[test]
fn a_shape_is_whole_however_narrow_its_hills_are() {
    // A hill of 0.4 ms, another one, and a few values up to far above.
    let hill = |from: f64, n: u32| (0..n).map(move |i| from + 0.4 * (f64::from(i) + 0.5) / f64::from(n));
    let far: Ordered =
        millis(hill(2.0, 150).chain(hill(9.0, 60)).chain([20.0, 30.0, 40.0, 40.1, 40.2, 41.0]));
    let figure = paired(vec![vec![far]]);
    let pixels = figure.pixels().expect("drawn");
    let (width, height) = figure.size();
    let row = width as usize * 3;
    let blue = |row: &[u8]| row.chunks_exact(3).any(|pixel| pixel == [0x00, 0x72, 0xb2]);
    // Below the key, whose sample has the colour as well.
    let rows: Vec<usize> = (380..height as usize).filter(|y| blue(&pixels[y * row..(y + 1) * row])).collect();
    let (first, last) = (rows[0], rows[rows.len() - 1]);
    assert!(last - first > 400, "{first} {last}");
    assert_eq!(rows.len(), last - first + 1, "a row without the shape");
}

#[test]
fn each_distribution_has_its_count() {
    let svg = paired(vec![vec![hill(50.0, 400), hill(20.0, 9)]]).svg().expect("drawn");
    assert!(has(&svg, "n = 400") && has(&svg, "n = 9"), "{:?}", texts(&svg));
    let many = paired(vec![vec![hill(50.0, 400), hill(20.0, 9)]; 12]);
    let svg = many.svg().expect("drawn");
    assert!(has(&svg, "n = 9 to 400 each") && !has(&svg, "n = 9"), "{:?}", texts(&svg));
    assert_on_paper(&many, &svg);
}

#[test]
fn what_leaves_a_shape_is_counted() {
    let late = hill(20.0, 400).values().iter().copied().chain([90.0]).collect();
    let svg = paired(vec![vec![hill(50.0, 400), late]]).svg().expect("drawn");
    assert!(has(&svg, "+1"), "{:?}", texts(&svg));
    assert!(has(&svg, "+ above: so many values are larger than shown"), "{:?}", texts(&svg));
}

/// Height of a text.
fn height(svg: &str, wanted: &str) -> f64 {
    let element = svg.split("<text ").find(|element| element.contains(&format!("\n{wanted}\n")));
    let y = element.and_then(|element| element.split(" y=\"").nth(1)?.split('"').next());
    y.and_then(|y| y.parse().ok()).expect("the text")
}

#[test]
fn points_that_have_room_are_drawn_and_no_count_lies_on_one() {
    let late = |extra: f64| hill(20.0, 30).values().iter().copied().chain([extra / 1e3]).collect::<Ordered>();
    let figure = paired(vec![vec![late(40.0), hill(60.0, 30)], vec![late(90.0), hill(50.0, 30)]]);
    let svg = figure.svg().expect("drawn");
    assert!(has(&svg, "+1") && !has(&svg, "+2"), "the one at 40 ms has room: {:?}", texts(&svg));
    // The key's two marks aside: the points of the first sides and two medians.
    let discs = Elements::of(&svg, "circle").with("fill", "#0072B2").numbers("cy");
    assert_eq!(discs.len(), 31 + 30, "{discs:?}");
    let second = discs[31..].iter().copied().fold(f64::INFINITY, f64::min);
    assert!(height(&svg, "+1") <= second - 12.0, "{} {second}", height(&svg, "+1"));
}

#[test]
fn odd_pairs_are_drawn_too() {
    for values in
        [vec![], vec![5.0], vec![5.0; 300], vec![-2.0, -1.0, 4.0], vec![f64::NAN, 3.0, f64::INFINITY]]
    {
        let figure = paired(vec![vec![millis(values.clone()), millis([])]]);
        let svg = figure.svg().expect("drawn");
        assert_eq!(
            has(&svg, "no values"),
            values.is_empty() || values.iter().any(|v| v.is_infinite()),
            "{values:?}"
        );
        assert_on_paper(&figure, &svg);
    }
}

fn lengths(points: Vec<(f64, f64)>) -> Lengths {
    Lengths {
        title: "Inference against tokens".to_owned(),
        x: Unit { title: "Tokens".to_owned(), symbol: "".into(), per_si: 1.0 },
        y: Unit::milliseconds("Inference"),
        points,
        notes: vec!["n = 3".to_owned()],
    }
}

#[test]
fn points_have_a_distribution_on_both_sides() {
    let figure = lengths((0..100).map(|i| (f64::from(i), f64::from(i) * 2e-3)).collect());
    let svg = figure.svg().expect("drawn");
    let circles = Elements::of(&svg, "circle");
    assert_eq!(circles.0.len(), 100);
    let (x, y) = (circles.numbers("cx"), circles.numbers("cy"));
    assert!((x[50] - f64::midpoint(x[0], x[99])).abs() < 10.0 && y[0] > y[99], "{svg}");
    let bars = Elements::of(&svg, "rect").with("fill", "#14181F");
    assert!(bars.0.len() >= 16, "{svg}");
    assert!(["Tokens", "Inference, ms"].iter().all(|text| has(&svg, text)));
    assert_on_paper(&figure, &svg);
}

#[test]
fn a_hundred_thousand_points_are_a_small_file() {
    let point = |i: u32| (f64::from(i % 977), f64::from(i % 977) * 1e-3 + f64::from(i % 31) * 1e-3);
    let figure = lengths((0..100_000).map(point).collect());
    let svg = figure.svg().expect("drawn");
    assert!(Elements::of(&svg, "circle").0.is_empty() && svg.len() < 400_000, "{}", svg.len());
}

#[test]
fn odd_points_are_drawn_too() {
    for points in
        [vec![], vec![(3.0, 4.0)], vec![(3.0, 4.0); 90], vec![(-3.0, f64::NAN), (1.0, -2.0), (2.0, 1.0)]]
    {
        let figure = lengths(points.clone());
        let svg = figure.svg().expect("drawn");
        assert_eq!(has(&svg, "no values"), points.is_empty(), "{points:?}");
        assert_on_paper(&figure, &svg);
    }
    let far = (0..300).map(|i| (f64::from(i % 50), 0.1)).chain([(1e6, 0.1)]).collect();
    assert!(has(&lengths(far).svg().expect("drawn"), "1 beyond the axes"));
}
