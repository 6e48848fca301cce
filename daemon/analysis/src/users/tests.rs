//! Tests of edges that were measured at the same time.

use peernet_stream::ExperimentPosition;

use super::*;
use crate::compare::Comparison;
use crate::record::{HostRecord, RunRecord};
use crate::rows::{Outcome, Row};
use crate::trust::{StartTimes, Starts};

#[test]
fn jain_index_ranges_from_one_nth_to_one() {
    assert_eq!(jain_index(&[5.0, 5.0, 5.0]), Some(1.0));
    assert_eq!(jain_index(&[0.0, 7.0, 0.0, 0.0]), Some(0.25));
    // Four of five users get the same, the fifth gets nothing: (1 + 1 + 1 + 1 + 0)² / (5 · 4).
    assert_eq!(jain_index(&[1.0, 1.0, 1.0, 1.0, 0.0]), Some(0.8));
    assert_eq!((jain_index(&[]), jain_index(&[0.0])), (None, None));
}

/// Returns an edge that makes `count` requests from `from` on, one every `period` seconds. Each total is `total`
/// seconds.
fn edge(labels: &[(&str, &str)], (name, from): (&str, f64), period: f64, count: u32, total: f64) -> Loaded {
    let row = |index: u32| Row {
        iteration: u64::from(index) + 1,
        at: from + f64::from(index) * period,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: Outcome::Ok,
        reason: None,
        values: vec![("total".into(), total)],
        upload: None,
        download: None,
    };
    let configuration = labels.iter().map(|(axis, label)| ((*axis).to_owned(), (*label).to_owned()));
    let position = ExperimentPosition {
        name: "e".to_owned(),
        id: "1".to_owned(),
        configuration: configuration.collect(),
        repeat: 0,
        ..ExperimentPosition::default()
    };
    let host = HostRecord { name: name.to_owned(), ..HostRecord::default() };
    let record = RunRecord { experiment: Some(position), edge: host, ..RunRecord::default() };
    Loaded { folder: "x".into(), record, rows: (0..count).map(row).collect() }
}

#[test]
fn rates_cover_only_common_time() {
    let alone_run = edge(&[("N", "1")], ("a", 0.0), 0.5, 21, 0.25);
    // The second edge begins 2 s late and ends with the first; it gets half as many answers.
    let [first, second] =
        [edge(&[("N", "2")], ("a", 0.0), 0.5, 21, 0.5), edge(&[("N", "2")], ("b", 2.0), 1.0, 9, 1.0)];
    let users = Users::from_runs(&[first.clone(), alone_run.clone(), second]).expect("several edges");
    assert_eq!((users.axes.as_slice(), users.lines.len()), (["N".to_owned()].as_slice(), 2));
    let [both, alone] = users.lines.as_slice() else { panic!("two lines") };
    assert_eq!((alone.edges, alone.rate, alone.fairness), (1, Some(2.0), Some(1.0)));
    assert_eq!((both.edges, both.rate, both.rate_range()), (2, Some(3.0), Some((1.0, 2.0))));
    assert_eq!(both.fairness, Some(0.9));
    assert_eq!(alone.totals.count, 21, "all totals of a single edge count, as in the comparison");
    // 16 answers of the first edge and 8 of the second.
    assert_eq!((both.totals.count, both.totals.median), (24, Some(0.5)));
    assert_eq!(
        both.edge_performances.iter().map(|edge| edge.median).collect::<Vec<_>>(),
        [Some(0.5), Some(1.0)]
    );
    assert!(users.text().contains("0.900"), "{}", users.text());
    assert!(users.csv().starts_with("N,edges,rate,"), "{}", users.csv());
    assert_eq!(Users::from_runs(std::slice::from_ref(&alone_run)), None);
    assert_eq!(
        Users::from_runs(&[first.clone(), first]),
        None,
        "a copy of the results is not a further edge"
    );
}

#[test]
fn empty_label_is_empty_cell_of_csv() {
    let runs = [("", "a"), ("", "b"), ("x", "a"), ("x", "b")]
        .map(|(load, name)| edge(&[("N", "2"), ("Load", load)], (name, 0.0), 0.5, 21, 0.25));
    for csv in [Users::from_runs(&runs).expect("several edges").csv(), Comparison::new(&runs).csv()] {
        let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
        let column = rows[0].iter().position(|title| *title == "Load").expect("an axis");
        assert_eq!([rows[1][column], rows[2][column]], ["", "x"], "{csv}");
    }
}

#[test]
fn users_at_different_times_have_no_rates() {
    let users = Users::from_runs(&[edge(&[], ("a", 0.0), 0.5, 5, 0.1), edge(&[], ("b", 100.0), 0.5, 5, 0.1)]);
    let users = users.expect("several edges");
    assert_eq!((users.lines[0].edges, users.lines[0].rate, users.lines[0].fairness), (2, None, None));
    assert!(users.text().contains('—'), "{}", users.text());
}

#[test]
fn repeats_are_averaged() {
    let repeat = |starts: [u64; 2]| {
        let edge = |starts| EdgeMeasurements { starts, totals: SortedValues::default() };
        Repeat { common_seconds: Some(2.0), edges: starts.map(edge).to_vec() }
    };
    let line = UsersLine::new(Vec::new(), 2, &[repeat([2, 2]), repeat([8, 0])], SortedValues::default);
    assert_eq!((line.rate, line.fairness, line.rate_range()), (Some(3.0), Some(0.75), Some((0.0, 4.0))));
}

#[test]
fn common_time_is_that_of_all_edges() {
    assert_eq!(common_time([Some((0, 9)), Some((2, 12)), Some((1, 8))]), Some((2, 8)));
    assert_eq!(common_time([Some((0, 9)), Some((9, 12))]), None);
    assert_eq!((common_time([Some((0, 9)), None]), common_time::<i32>([])), (None, None));
}

/// Returns the curves of configurations: name and numbers of edges.
fn curves(axes: &[&str], lines: &[(&[&str], usize)]) -> Vec<(String, Vec<usize>)> {
    let owned = |all: &[&str]| all.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>();
    let line = |(labels, edges): &(&[&str], usize)| {
        UsersLine::new::<SortedValues>(owned(labels), *edges, &[], SortedValues::default)
    };
    let users = Users { axes: owned(axes), lines: lines.iter().map(line).collect() };
    let points = |curve: &Curve<'_>| curve.points.iter().map(|line| line.edges).collect();
    Curve::from_users(&users).iter().map(|curve| (curve.name.clone(), points(curve))).collect()
}

#[test]
fn configurations_differing_in_edges_form_one_curve() {
    let lines: [(&[&str], usize); 5] = [
        (&["s", "cpu", "8"], 8),
        (&["s", "cpu", "1"], 1),
        (&["m", "cpu", "1"], 1),
        (&["s", "cpu", "2"], 2),
        (&["m", "cpu", "8"], 8),
    ];
    let found = curves(&["model", "device", "edges"], &lines);
    assert_eq!(found, [("s".to_owned(), vec![1, 2, 8]), ("m".to_owned(), vec![1, 8])]);
    let number_in_text: [(&[&str], usize); 2] = [(&["4 robots"], 4), (&["16 robots"], 16)];
    assert_eq!(curves(&["load"], &number_in_text), [(String::new(), vec![4, 16])]);
    let without_labels: [(&[&str], usize); 2] = [(&[], 1), (&[], 2)];
    assert_eq!(curves(&[], &without_labels), [(String::new(), vec![1, 2])]);
}

#[test]
fn different_models_are_separate_curves() {
    let lines: [(&[&str], usize); 2] = [(&["v2-s"], 1), (&["v2-m"], 2)];
    let found = curves(&["model"], &lines);
    assert_eq!(found, [("v2-s".to_owned(), vec![1]), ("v2-m".to_owned(), vec![2])]);
    // The label `on` is shown as the name of the axis.
    let batches: [(&[&str], usize); 3] = [(&["off"], 1), (&["on"], 2), (&["none"], 3)];
    let names = curves(&["Batches"], &batches).into_iter().map(|(name, _)| name).collect::<Vec<_>>();
    assert_eq!(names, ["Batches off", "Batches", "Batches none"]);
}

#[test]
fn repeats_without_all_edges_are_excluded() {
    let at = |repeat: u32, name: &str| {
        let mut edge = edge(&[("N", "2")], (name, 0.0), 0.5, 21, 0.5);
        edge.record.experiment.as_mut().expect("an experiment").repeat = repeat;
        edge
    };
    let users = Users::from_runs(&[at(0, "a"), at(0, "b"), at(1, "a"), at(2, "a"), at(2, "b")]);
    let [line] = &users.expect("several edges").lines[..] else { panic!("one configuration") };
    assert_eq!((line.edges, line.edge_performances.len(), line.rate), (2, 4, Some(4.0)));
}

#[test]
fn executions_have_separate_lines_as_in_comparison() {
    let execution = |id: &str, period: f64, total: f64| {
        ["a", "b"].map(|name| {
            let mut edge = edge(&[("N", "2")], (name, 0.0), period, 21, total);
            edge.record.experiment.as_mut().expect("an experiment").id = id.to_owned();
            edge
        })
    };
    let runs = [execution("1", 0.5, 0.25), execution("2", 0.25, 0.125)].concat();
    let (users, comparison) = (Users::from_runs(&runs).expect("several edges"), Comparison::new(&runs));
    assert_eq!((&users.axes, users.lines.len()), (&comparison.axes, comparison.lines.len()));
    for (line, compared) in users.lines.iter().zip(&comparison.lines) {
        assert_eq!((&line.labels, line.edges), (&compared.labels, compared.edges));
        assert_eq!(line.totals.mean, compared.latency("total").map(|total| total.mean));
    }
    let rates = users.lines.iter().map(|line| line.rate).collect::<Vec<_>>();
    assert_eq!(rates, [Some(4.0), Some(8.0)], "runs that are not declared as repeats are never pooled");
}

#[test]
fn rates_of_answers_exclude_lost_iterations() {
    // Each edge starts 8 iterations per second and loses every eighth.
    let lossy = |name: &str| {
        let mut edge = edge(&[("N", "2")], (name, 1.0), 0.125, 161, 0.05);
        edge.rows.change(|row| {
            if row.iteration.is_multiple_of(8) {
                row.outcome = Outcome::Lost;
            }
        });
        edge
    };
    let runs = [lossy("a"), lossy("b")];
    let users = Users::from_runs(&runs).expect("several edges");
    let times = StartTimes::from_run(&runs[0].record, &runs[0].rows);
    let starts = Starts { times, ..Starts::from_rows(&runs[0].rows) };
    assert_eq!((starts.actual_hz(), users.lines[0].rate_range()), (Some(8.0), Some((7.0, 7.0))));
    let text = users.text();
    let header: Vec<&str> = text.lines().next().expect("a header").split("  ").map(str::trim).collect();
    assert!(header.contains(&"answers/s") && header.contains(&"answers/s per edge"), "{text}");
    // The text contains neither `Iterations` nor `iterations`.
    assert!(text.contains("Answers are counted only while") && !text.contains("terations"), "{text}");
}
