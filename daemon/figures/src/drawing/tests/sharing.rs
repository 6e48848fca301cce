//! Tests of latency against the number of edges.

use std::collections::BTreeSet;

use super::*;

fn point(edges: usize, median: f64, fairness: Option<f64>) -> SharingPoint {
    let edge_medians = vec![median * 0.9, median * 1.1];
    SharingPoint { edges, median, p95: Some(median * 1.5), edge_medians, fairness }
}

fn sharing(curves: Vec<(&str, Vec<SharingPoint>)>) -> Sharing {
    let curve = |(name, points): (&str, _)| SharingCurve { name: name.to_owned(), points };
    Sharing {
        title: "Latency against the number of edges".to_owned(),
        unit: Unit::milliseconds("Total"),
        curves: curves.into_iter().map(curve).collect(),
        notes: Vec::new(),
    }
}

#[test]
fn axis_ticks_are_measured_edge_counts() {
    let points = [1, 2, 4, 8].map(|edges| point(edges, 0.01 + 0.01 * edges as f64, Some(1.0 / edges as f64)));
    let figure = sharing(vec![("", points.to_vec())]);
    let svg = figure.svg();
    for text in ["1", "2", "4", "8", "Edges at once (log scale)", "Total, ms", "0", "0.5", "1.0"] {
        assert!(has_text(&svg, text), "{text} in {:?}", texts(&svg));
    }
    assert!(texts(&svg).iter().any(|text| text.contains("Jain")), "{:?}", texts(&svg));
    let (x, y) = (Elements::of(&svg, "circle").numbers("cx"), Elements::of(&svg, "circle").numbers("cy"));
    assert_eq!((x.len(), &x[..4]), (8, &x[4..]), "the points of both plots are not below each other");
    // Doublings of the number of edges are equally far apart on the logarithmic axis. Latencies rise by 10, 20 and 40
    // ms.
    assert!(
        (x[1] - x[0] - (x[2] - x[1])).abs() <= 0.1 && (x[2] - x[1] - (x[3] - x[2])).abs() <= 0.1,
        "{x:?}"
    );
    assert!(((y[0] - y[3]) - 7.0 * (y[0] - y[1])).abs() < 0.3, "{y:?}");
    // The fairness falls with the number of edges, and the plot of fairness is below the plot of latency.
    assert!(y[4] < y[5] && y[5] < y[6] && y[6] < y[7] && y[4] > y[0], "{y:?}");
    assert_valid_file(&svg);
}

#[test]
fn curves_differ_by_dash_pattern() {
    let curve = |factor: f64| [1, 2, 3].map(|edges| point(edges, factor * edges as f64, Some(0.9))).to_vec();
    let figure =
        sharing(vec![("s", curve(0.01)), ("m", curve(0.02)), ("l", curve(0.03)), ("xl", curve(0.04))]);
    let svg = figure.svg();
    assert!(["s", "m", "l", "xl"].iter().all(|name| has_text(&svg, name)), "{:?}", texts(&svg));
    let dashes: BTreeSet<String> = Elements::of(&svg, "path")
        .with("fill", "none")
        .0
        .iter()
        .map(|line| line.get("stroke-dasharray").cloned().unwrap_or_default())
        .collect();
    assert_eq!(dashes.len(), 4, "{svg}");
    assert_valid_file(&svg);
}

#[test]
fn missing_and_extreme_points_give_valid_figure() {
    let without_fairness =
        |edges, median| SharingPoint { p95: None, edge_medians: vec![median], ..point(edges, median, None) };
    let cases = [
        vec![],
        vec![("", vec![])],
        vec![("", vec![without_fairness(3, 0.0)])],
        vec![("", vec![without_fairness(1, f64::NAN), without_fairness(2, 1e-6), without_fairness(64, 1e4)])],
        vec![(
            "a configuration with a long name, cuda:0, zmq-tcp, 1280x720",
            vec![point(1, 0.1, Some(0.0)), point(1000, 9.0, Some(1.0))],
        )],
    ];
    for curves in cases {
        let figure = sharing(curves);
        let svg = figure.svg();
        let has_points =
            figure.curves.iter().flat_map(|curve| &curve.points).any(|point| point.median.is_finite());
        assert_eq!(has_text(&svg, "no values"), !has_points, "{:?}", texts(&svg));
        let has_fairness =
            figure.curves.iter().flat_map(|curve| &curve.points).any(|point| point.fairness.is_some());
        assert_eq!(texts(&svg).iter().any(|text| text.contains("Jain")), has_fairness);
        assert_valid_file(&svg);
    }
}
