//! Values against size, and accuracy against latency.

use super::*;
use crate::look::Mark;
use peernet_analysis::quality::Quality;

fn scaling(line: Option<(f64, f64)>, whisker: Option<f64>) -> Scaling {
    let value = |bytes: f64| Value {
        bytes,
        value: bytes * 1e3,
        p5_and_p95: None,
        bounds: whisker.map(|share| (bytes * 1e3 * (1.0 - share), Some(bytes * 1e3 * (1.0 + share)))),
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

/// Returns the heights of the series' level lines.
fn levels(svg: &str) -> Vec<f64> {
    let lines = Elements::of(svg, "path").with("stroke", "#d55e00");
    let points = |line: &HashMap<String, String>| -> Vec<f64> {
        line["d"].split(['M', 'L']).filter_map(|point| point.split(' ').nth(1)?.parse().ok()).collect()
    };
    lines.0.iter().flat_map(points).collect()
}

#[test]
fn level_line_is_drawn_at_height_or_omitted() {
    let figure = scaling(Some((1e9, 0.0)), None);
    let svg = figure.svg();
    let discs = Elements::of(&svg, "circle").numbers("cy");
    // The key's disc, then a decade each; the line is a decade above the last.
    let decade = discs[2] - discs[3];
    let line = levels(&svg);
    assert!(
        !line.is_empty() && line.iter().all(|y| (discs[3] - y - decade).abs() < 0.5),
        "{discs:?} {line:?}"
    );
    assert!(
        figure.caption_text().contains("point: size ÷ median delay · line: by slope"),
        "{}",
        figure.caption_text()
    );
    assert_within_paper(&svg);
    let far = scaling(Some((1e11, 0.0)), None);
    assert!(levels(&far.svg()).is_empty());
    for text in ["point: size ÷ median delay\n", "far beyond the axis and not drawn: the line of upload"] {
        assert!(far.caption_text().contains(text), "{text}: {}", far.caption_text());
    }
}

#[test]
fn falling_line_ends_at_edge_of_plot() {
    let svg = scaling(Some((-2e6, 1e3)), None).svg();
    let discs = Elements::of(&svg, "circle").numbers("cy");
    let decade = discs[2] - discs[3];
    // The axis begins below the smallest value by this power of its range of two decades.
    let bottom = discs[1] + 0.06 * 2.0 * decade;
    let lowest = levels(&svg).into_iter().fold(0.0, f64::max);
    assert!((lowest - bottom).abs() < 0.1, "{lowest} {bottom}");
}

#[test]
fn legend_omits_whisker_without_clock_bounds() {
    let has_whisker =
        |share: f64| scaling(None, Some(share)).caption_text().contains("whisker: by clock bounds");
    assert!(has_whisker(0.2) && !has_whisker(0.0), "there are no bounds if both ends read the same clock");
}

fn score(label: &str, right: u64, count: u64, median: f64) -> Score {
    let statistics = (count, right as f64 / count as f64, None);
    let estimate = Quality::Top1.from_statistics(|_| Some(statistics)).expect("has answers");
    Score { label: label.to_owned(), estimate, median, p95: (count >= 60).then_some(median * 1.5) }
}

fn accuracy(scores: Vec<Score>) -> Accuracy {
    Accuracy {
        quality: Quality::Top1,
        unit: Unit::milliseconds("Total"),
        scores,
        notes: vec!["n = 100 each".to_owned()],
    }
}

#[test]
fn each_configuration_is_numbered_point() {
    let scores = vec![score("s", 70, 100, 0.02), score("m", 80, 100, 0.04), score("l", 90, 100, 0.041)];
    let figure = accuracy(scores);
    let svg = figure.svg();
    let discs = Elements::of(&svg, "circle").with("fill", "#14181f");
    let (x, y) = (discs.numbers("cx"), discs.numbers("cy"));
    assert_eq!(x.len(), 3, "{svg}");
    assert!(x[0] < x[1] && x[1] < x[2] && y[0] > y[1] && y[1] > y[2], "{x:?} {y:?}");
    assert!(((y[1] - y[2]) - (y[0] - y[1])).abs() < 0.6, "evenly: {y:?}");
    for text in ["s", "m", "l", "Top-1 accuracy, %", "Total, ms", "Accuracy against latency · n = 100 each"]
    {
        assert!(has(&svg, text), "{text} in {:?}", texts(&svg));
    }
    // Name, accuracy, median, 95th percentile.
    let texts = texts(&svg);
    assert!(texts.windows(5).any(|line| line == ["2", "m", "80.0", "40.0", "60.0"]), "{texts:?}");
    let count = |number: &str| texts.iter().filter(|text| *text == number).count();
    assert_eq!(["1", "2", "3"].map(count), [2, 2, 2], "at the point and in the key: {texts:?}");
    assert!(figure.caption_text().contains("across: to the 95th percentile"), "{}", figure.caption_text());
    assert_within_paper(&svg);
}

#[test]
fn overlapping_whiskers_are_omitted() {
    let figure =
        accuracy(vec![score("a", 100, 100, 0.02), score("b", 100, 100, 0.025), score("c", 99, 100, 0.1)]);
    let svg = figure.svg();
    assert!(!figure.caption_text().contains("across"), "{}", figure.caption_text());
    assert!(has(&svg, "p95, ms") && has(&svg, "37.5"), "the key has them: {:?}", texts(&svg));
    let discs = Elements::of(&svg, "circle").with("fill", "#14181f").numbers("cy");
    assert_eq!(discs[0], discs[1], "points stay where they are");
    let apart = accuracy(vec![score("a", 100, 100, 0.02), score("b", 100, 100, 0.04)]);
    assert!(apart.caption_text().contains("across"), "{}", apart.caption_text());
}

#[test]
fn numbers_of_coinciding_points_do_not_overlap() {
    let figure = accuracy((0..9).map(|_| score("x", 100, 100, 0.02)).collect());
    let svg = figure.svg();
    let coordinates = |attribute: &str| {
        let texts = svg.split("<text ").skip(1).filter(|text| {
            let words = text.split('>').nth(1).and_then(|text| text.split('<').next()).unwrap_or_default();
            words.trim().parse::<u32>().is_ok_and(|number| (1..=9).contains(&number))
        });
        let value =
            |text: &str| text.split(&format!("{attribute}=\"")).nth(1)?.split('"').next()?.parse().ok();
        texts.filter_map(value).collect::<Vec<f64>>()
    };
    let places: Vec<(f64, f64)> = coordinates("x").into_iter().zip(coordinates("y")).take(9).collect();
    assert_eq!(places.len(), 9, "{svg}");
    for (number, (x, y)) in places.iter().enumerate() {
        let far = |(a, b): &(f64, f64)| (a - x).abs() >= 3.0 || (b - y).abs() >= 6.0;
        assert!(places[number + 1..].iter().all(far), "{places:?}");
    }
}

#[test]
fn extreme_scores_give_a_valid_figure() {
    let crowd =
        (0..24).map(|i| score(&format!("configuration {i} with a long name"), 50, 100, 0.02)).collect();
    let cases = [
        vec![],
        vec![score("never", 0, 9, 1e-6)],
        vec![score("always", 9, 9, 3.0), score("slow", 1, 90, 9e3)],
        vec![score("no time", 3, 9, f64::NAN)],
        crowd,
    ];
    for scores in cases {
        let figure = accuracy(scores);
        let svg = figure.svg();
        assert_eq!(has(&svg, "no values"), figure.scores.iter().all(|score| score.median.is_nan()));
        assert_within_paper(&svg);
    }
}
