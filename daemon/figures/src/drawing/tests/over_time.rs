//! Tests of latency over time.

use super::*;

fn time_series(total: Vec<(f64, f64)>) -> TimeSeries {
    let half = total.iter().map(|(at, value)| (*at, value / 2.0)).collect();
    TimeSeries {
        title: "Latency over time".to_owned(),
        x_title: "Time since the start, s".to_owned(),
        x_is_iteration: false,
        unit: Unit::milliseconds("Latency"),
        total: Line { name: "total".to_owned(), values: total },
        stages: vec![Line { name: "upload".to_owned(), values: half }],
        warm_up: vec![(0.0, 5.0)],
        episode_starts: vec![40.0, 70.0],
        failure_times: vec![20.0, 55.0, 55.001],
        failed_in_warm_up: 0,
        notes: vec!["n = 9".to_owned()],
    }
}

#[test]
fn warm_up_episodes_and_failures_are_marked() {
    let figure = time_series((0..100).map(|i| (f64::from(i), 0.05 + f64::from(i % 3) * 1e-3)).collect());
    let svg = figure.svg();
    for text in ["total (band: range)", "upload", "warm-up", "failed (3)", "new episode", "Latency, ms"] {
        assert!(has_text(&svg, text), "{text} in {:?}", texts(&svg));
    }
    // Two areas are shaded: the swatch in the legend, and the first five of 99 seconds. The plot is about 228 points
    // wide.
    let shade = Elements::of(&svg, "rect").with("fill", "#e8ebef");
    assert_eq!(shade.0.len(), 2, "{svg}");
    assert!((shade.numbers("width")[1] - 228.0 * 5.0 / 99.0).abs() < 1.5, "{:?}", shade.numbers("width"));
    // There are the swatch in the legend and two crosses for three failed iterations. Two of the iterations are so
    // close that they share a cross.
    assert_eq!(Elements::of(&svg, "path").with("stroke", "#9b1620").0.len(), 3, "{svg}");
    assert_valid_file(&svg);
}

#[test]
fn line_has_at_most_seven_marks() {
    let figure = time_series((0..1_000).map(|i| (f64::from(i), 0.05)).collect()).figure();
    let is_mark = |item: &&crate::plot::Item| matches!(item, crate::plot::Item::Mark { .. });
    assert_eq!(figure.plots[0].items.iter().filter(is_mark).count(), 7);
}

#[test]
fn figure_of_100000_iterations_is_small_file() {
    let latency = |i: u32| if i == 77_777 { 0.5 } else { 0.05 + f64::from(i % 97) * 1e-4 };
    let figure = time_series((0..100_000).map(|i| (f64::from(i) * 1e-2, latency(i))).collect());
    let svg = figure.svg();
    assert!(svg.len() < 100_000, "{}", svg.len());
    // All latencies except the stall of 500 ms are below 60 ms.
    assert!(texts(&svg).iter().any(|text| text.starts_with("1 beyond 6")), "{:?}", texts(&svg));
    assert_valid_file(&svg);
}

#[test]
fn single_stall_does_not_hide_the_run() {
    // Returns the time and the latency of an iteration, seconds. The iteration 300 takes 12 s.
    let time_and_latency = |at: u32, value: f64| (f64::from(at) / 10.0, if at == 300 { 12.0 } else { value });
    let figure = TimeSeries {
        stages: vec![Line {
            name: "inference".to_owned(),
            values: (0..600).map(|at| time_and_latency(at, 5e-3)).collect(),
        }],
        ..time_series((0..600).map(|at| time_and_latency(at, 6e-3 + f64::from(at % 7) * 1e-5)).collect())
    };
    let svg = figure.svg();
    assert!(texts(&svg).iter().any(|text| text.starts_with("1 beyond 6.")), "{:?}", texts(&svg));
}

#[test]
fn band_is_interrupted_where_nothing_was_measured() {
    let with_gap = |i: u32| f64::from(i) + if i < 500 { 0.0 } else { 3000.0 };
    let piece_count = |total: Vec<(f64, f64)>| {
        let figure = TimeSeries {
            stages: Vec::new(),
            episode_starts: Vec::new(),
            failure_times: Vec::new(),
            ..time_series(total)
        };
        Elements::of(&figure.svg(), "path").with("fill-opacity", "0.25").0[0]["d"].matches('Z').count()
    };
    assert_eq!(piece_count((0..1000).map(|i| (f64::from(i), 0.05)).collect()), 1);
    assert_eq!(piece_count((0..1000).map(|i| (with_gap(i), 0.05)).collect()), 2);
    assert_eq!(
        piece_count((0..10).map(|i| (f64::from(i), 0.05)).collect()),
        1,
        "the distances between few values are no gaps"
    );
}

#[test]
fn unusual_values_give_valid_time_series() {
    for values in
        [vec![], vec![(1.0, 0.05)], vec![(1.0, 0.05); 9], vec![(0.0, f64::NAN), (1.0, -0.02), (2.0, 0.0)]]
    {
        let figure = TimeSeries {
            warm_up: Vec::new(),
            episode_starts: Vec::new(),
            failure_times: Vec::new(),
            ..time_series(values.clone())
        };
        let svg = figure.svg();
        assert_eq!(has_text(&svg, "no values"), values.is_empty(), "{values:?}");
        assert_valid_file(&svg);
    }
    let many_episodes = TimeSeries {
        episode_starts: (0..500).map(f64::from).collect(),
        ..time_series(vec![(0.0, 0.1), (500.0, 0.1)])
    };
    assert!(!has_text(&many_episodes.svg(), "new episode"), "500 borders would hide the line");
}
