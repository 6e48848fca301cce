//! Histograms and stacked bars.

use super::*;

pub(super) fn histogram(values: SortedValues) -> Histogram {
    Histogram {
        title: "Upload time · robot".to_owned(),
        unit: Unit::milliseconds("Upload time"),
        stage: "upload".to_owned(),
        notes: vec![format!("n = {}", values.len())],
        values,
    }
}

#[test]
fn bars_are_as_high_as_bin_counts() {
    // 30, 60 and 10 values, so far apart that they lie in three bins.
    let values = [(10.0, 30), (20.0, 60), (90.0, 10)];
    let values = millis(values.iter().flat_map(|(value, count)| std::iter::repeat_n(*value, *count)));
    let figure = histogram(values);
    let svg = figure.svg();
    let bars = Elements::of(&svg, "rect").with("fill", &fill_colour("upload"));
    let heights = bars.numbers("height");
    assert_eq!(heights.len(), 3, "{svg}");
    assert!((heights[1] / heights[0] - 2.0).abs() < 0.02 && (heights[0] / heights[2] - 3.0).abs() < 0.05);
    for text in
        ["Upload time, ms", "Iterations", "median 20.0 ms", "p95 90.0 ms", "Upload time · robot · n = 100"]
    {
        assert!(has_text(&svg, text), "{text} in {:?}", texts(&svg));
    }
    assert_valid_file(&svg);
}

#[test]
fn median_line_is_at_the_median() {
    let figure = histogram(millis((0..=1000).map(f64::from)));
    let svg = figure.svg();
    let bars = Elements::of(&svg, "rect").with("fill", &fill_colour("upload"));
    let (left, last) = (bars.numbers("x")[0], bars.0.len() - 1);
    let right = bars.numbers("x")[last] + bars.numbers("width")[last];
    let xs = Elements::of(&svg, "line").with("stroke", "#14181f").with("stroke-width", "0.9").numbers("x1");
    assert!(xs.iter().any(|x| (x - f64::midpoint(left, right)).abs() < 0.6), "{xs:?} {left} {right}");
}

#[test]
fn long_tail_is_counted_instead_of_drawn() {
    let figure = histogram(millis((0..1000).map(|i| f64::from(i) / 100.0 + 10.0).chain([9e5, 1e6])));
    let svg = figure.svg();
    assert!(texts(&svg).iter().any(|text| text == "2 beyond 20.0 ms →"), "{:?}", texts(&svg));
    assert_valid_file(&svg);
}

#[test]
fn unusual_values_give_valid_figure() {
    let cases: [Vec<f64>; 6] = [
        vec![],
        vec![17.5],
        vec![0.0; 80],
        vec![-3.0, -2.0, -1.5, 0.2],
        vec![f64::NAN, 1.0, f64::INFINITY, 2.0],
        vec![1e-9, 1e12],
    ];
    for values in cases {
        let figure = histogram(millis(values.clone()));
        let svg = figure.svg();
        assert_eq!(has_text(&svg, "no values"), values.is_empty(), "{values:?}");
        assert!(texts(&svg).iter().all(|text| text.chars().count() < 40), "{:?}", texts(&svg));
        assert!(!has_text(&svg, "1.5"), "a number of iterations is not whole: {:?}", texts(&svg));
        assert_valid_file(&svg);
    }
}

#[test]
fn equal_values_have_a_wide_bar_even_at_zero() {
    let fill = fill_colour("upload");
    let widths = [0.0, 3.0].map(|value| {
        let svg = histogram(millis([value; 30])).svg();
        Elements::of(&svg, "rect").with("fill", &fill).numbers("width").into_iter().fold(0.0, f64::max)
    });
    assert!(widths[0] > 15.0 && (widths[0] - widths[1]).abs() < 1.2, "{widths:?}");
}

fn stacked(bars: Vec<(&str, [f64; 3], Option<f64>)>) -> Stacked {
    let bar = |(label, means, std): (&str, [f64; 3], Option<f64>)| Bar {
        label: label.to_owned(),
        means: means.map(|mean| mean / 1e3).to_vec(),
        total: means.iter().sum::<f64>() / 1e3,
        std: std.map(|std| std / 1e3),
    };
    Stacked {
        title: "Latency".to_owned(),
        unit: Unit::milliseconds("Latency"),
        stages: ["sensing", "upload", "inference"].map(str::to_owned).to_vec(),
        bars: bars.into_iter().map(bar).collect(),
        notes: vec!["configurations: network".to_owned()],
    }
}

/// Returns the areas of a stage in the plot, without the swatch in the legend.
fn areas(svg: &str, stage: &str) -> Elements {
    let mut areas = Elements::of(svg, "rect").with("fill", &fill_colour(stage));
    areas.0.remove(0);
    areas
}

#[test]
fn sum_of_bar_has_rim_against_grid() {
    let long = "a long label that does not fit below an upright bar";
    for label in ["a", long] {
        let svg = stacked(vec![(label, [10.0, 40.0, 50.0], Some(5.0))]).svg();
        let sum = svg.split("<text ").find(|text| text.contains("±")).expect("a sum");
        assert!(
            sum.contains("stroke=\"#ffffff\"") && sum.contains("paint-order=\"stroke\""),
            "the sum has no rim: {sum}"
        );
    }
}

#[test]
fn parts_are_consecutive_and_proportional() {
    let long = "a long label that does not fit below an upright bar";
    let figure = stacked(vec![(long, [10.0, 40.0, 50.0], Some(5.0)), ("b", [10.0, 0.0, 20.0], None)]);
    let svg = figure.svg();
    let (sensing, upload, inference) =
        (areas(&svg, "sensing"), areas(&svg, "upload"), areas(&svg, "inference"));
    assert_eq!(
        (sensing.0.len(), upload.0.len(), inference.0.len()),
        (2, 1, 2),
        "a stage that took no time has no area"
    );
    let width = |areas: &Elements| areas.numbers("width")[0];
    assert!((width(&upload) / width(&sensing) - 4.0).abs() < 0.1, "{svg}");
    assert!((sensing.numbers("x")[0] + width(&sensing) - upload.numbers("x")[0]).abs() < 0.2);
    for text in ["100.0 ± 5.0", "30.0", "sensing", "upload", "inference", "Latency, ms", "b"] {
        assert!(has_text(&svg, text), "{text} in {:?}", texts(&svg));
    }
    assert!(figure.caption_text().contains("configurations: network"), "{}", figure.caption_text());
    assert_valid_file(&svg);
}

#[test]
fn few_bars_with_short_labels_are_upright() {
    let figure =
        stacked(vec![("LAN, no", [10.0, 40.0, 50.0], Some(5.0)), ("CAN, yes", [10.0, 0.0, 20.0], Some(1.0))]);
    let svg = figure.svg();
    let (sensing, upload) = (areas(&svg, "sensing"), areas(&svg, "upload"));
    assert!((upload.numbers("height")[0] / sensing.numbers("height")[0] - 4.0).abs() < 0.1);
    assert_eq!(sensing.numbers("width")[0], upload.numbers("width")[0]);
    assert!(["LAN", "no", "CAN", "yes"].iter().all(|text| has_text(&svg, text)), "{:?}", texts(&svg));
    assert_valid_file(&svg);
}

#[test]
fn sixty_configurations_have_a_bar_each() {
    let labels: Vec<String> = (0..60)
        .map(|number| format!("a label of many words that is too long for its row, configuration {number}"))
        .collect();
    let bars = labels.iter().map(|label| (label.as_str(), [1.0, 2.0, 3.0], Some(0.5))).collect();
    let figure = stacked(bars);
    let svg = figure.svg();
    assert_eq!(areas(&svg, "upload").0.len(), 60);
    let shown = |number: usize| {
        texts(&svg).iter().any(|text| text.contains('…') && text.ends_with(&format!(" {number}")))
    };
    assert!((0..60).all(shown), "the shortened labels differ: {:?}", texts(&svg));
    assert!((600.0..680.0).contains(&picture_size(&svg).1), "{:?}", picture_size(&svg));
    assert_valid_file(&svg);
}

#[test]
fn negative_parts_extend_below_zero() {
    let figure = stacked(vec![(
        "clocks that are not related and a label that does not fit below an upright bar of this figure",
        [10.0, -4.0, 20.0],
        Some(900.0),
    )]);
    let svg = figure.svg();
    let (sensing, upload) = (areas(&svg, "sensing"), areas(&svg, "upload"));
    assert!(
        (upload.numbers("x")[0] + upload.numbers("width")[0] - sensing.numbers("x")[0]).abs() <= 0.6,
        "{svg}"
    );
    assert_valid_file(&svg);
}

#[test]
fn figure_without_bars_says_no_values() {
    assert!(has_text(&stacked(Vec::new()).svg(), "no values"));
}
