//! Tests of the view of a stored run.

use peernet_analysis::rows::{Outcome, Row, Rows};
use peernet_analysis::summary::Summary;
use peernet_analysis::trust::StartTimes;
use peernet_clock::Span;
use peernet_logger::Name;
use peernet_store::{QuantityStatistics, SeriesPoint, StageSeries};
use peernet_stream::PlacementKind;

use super::*;
use crate::view::compare::tests::run;

/// Returns a run of 895 iterations in an hour, with points at its first and last second.
fn run_of_an_hour() -> (RunDetail, Series) {
    let mut summary = run(1, PlacementKind::Remote);
    let after = |seconds: i64| summary.started + Span::from_seconds(seconds);
    let point = |seconds: i64| SeriesPoint { at: after(seconds), count: 1, mean: 0.1, p50: 0.1, p95: None };
    let points = [0, 3_600].map(point).to_vec();
    let stages = vec![StageSeries { stage: stage::TOTAL, unit: "s".to_owned(), points }];
    (summary.ended, summary.last_iteration) = (Some(after(3_601)), Some(after(3_601)));
    (summary.counts, summary.warm_up) = (Default::default(), 0);
    summary.counts.ok = 895;
    (RunDetail::from(summary), Series { bucket_s: 1, stages, gaps: Vec::new() })
}

#[test]
fn run_with_standstill_has_no_rate() {
    let run = RunDetail::from(run(1, PlacementKind::Remote));
    let (first, last) = (run.summary.started, run.summary.started + Span::from_seconds(56));
    let rate_and_remark = |standstill_s: Option<f64>| {
        let times = StartTimes { first: Some(first), last: Some(last), standstill_s };
        let stored = StoredRun {
            run: &run,
            statistics: &RunStatistics::default(),
            series: &Series { bucket_s: 1, stages: Vec::new(), gaps: Vec::new() },
            slowest: &[],
            failed: &[],
            episodes: &Episodes::default(),
            starts: Starts { started: 15, missing: Some(0), times, ..Starts::default() },
        };
        (stored.rate(), stored.time_remarks().iter().any(|text| text.starts_with("no start for ")))
    };
    assert_eq!(rate_and_remark(Some(3_600.0)), (None, true));
    // 15 starts are 14 periods in 56 s.
    assert_eq!(rate_and_remark(None), (Some(0.25), false));
}

#[test]
fn page_and_summary_show_equal_numbers() {
    let row = |iteration: u64| Row {
        iteration,
        at: iteration as f64,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: Outcome::Ok,
        reason: None,
        values: vec![
            ("download-bytes".into(), 44.0),
            ("episode-success".into(), 1.0),
            ("episode-return".into(), 2.5),
            ("grip-force".into(), 0.00123),
        ],
        upload: None,
        download: None,
    };
    let summary = Summary::from_rows(&Rows::from_iter((1..=10).map(row)));
    let statistics_of = |column: &str| {
        let quantity = summary.quantity(column).expect("was measured");
        QuantityStatistics {
            count: quantity.count,
            mean: quantity.mean,
            std: quantity.std,
            min: quantity.mean,
            p50: quantity.median,
            p95: None,
            p99: None,
            max: quantity.max,
        }
    };
    let stage = |name: &'static str, unit: &str| StageStatistics {
        stage: peernet_logger::Name::from_static(name),
        unit: unit.to_owned(),
        is_stage: false,
        statistics: statistics_of(name),
        bound: None,
        share: None,
    };
    let names = ["episode-success", "episode-return", "grip-force"];
    let stages = [stage("download-bytes", "B")].into_iter().chain(names.map(|name| stage(name, "")));
    let stages = stages.collect();
    let statistics = RunStatistics { stages, ..RunStatistics::default() };
    let (run, series) = run_of_an_hour();
    let stored = StoredRun {
        run: &run,
        statistics: &statistics,
        series: &series,
        slowest: &[],
        failed: &[],
        episodes: &Episodes::default(),
        starts: Starts::default(),
    };
    let table = peernet_results::summary::markdown(&summary);
    let other_statistics = stored.other_statistics();
    // The rows after these are the speed and the traffic of the download.
    let names: Vec<&str> = other_statistics.iter().take(3).map(|other| other.name.as_str()).collect();
    assert_eq!(names, ["download-bytes", "episode-return", "grip-force"]);
    for (other, (name, expected)) in other_statistics.iter().zip([
        ("Download Size", ["44", "B"]),
        ("episode-return", ["2.50", ""]),
        ("grip-force", ["0.00123", ""]),
    ]) {
        assert_eq!([other.p50.as_str(), other.unit.as_str()], expected);
        let line = table.lines().find(|line| line.contains(name)).expect("a row of the summary");
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        for number in [&other.mean, &other.p50, &other.max] {
            assert!(cells.iter().any(|cell| cell.split(' ').next() == Some(number)), "{number} in {line}");
        }
        assert!(cells.contains(&other.unit.as_str()), "{line}");
    }
}

fn stage_statistics(stage: Name, mean: f64, count: u64) -> StageStatistics {
    StageStatistics {
        stage,
        unit: "s".to_owned(),
        is_stage: false,
        statistics: crate::tests::samples::figures(mean, count),
        bound: None,
        share: None,
    }
}

#[test]
fn stage_that_some_iterations_lack_has_count() {
    let stages = [
        stage_statistics(stage::SENSING, 0.001, 1_895),
        stage_statistics(stage::ACTUATION, 0.002, 50),
        stage_statistics(stage::TOTAL, 0.01, 1_895),
    ];
    let rows = crate::view::stages::StageRow::of_run(&stages, &[]);
    let occurrences = rows.iter().map(|row| (row.name.as_str(), row.occurrence.as_deref()));
    let expected = [("sensing", None), ("actuation", Some("50 of 1,895")), ("total", None)];
    assert_eq!(occurrences.collect::<Vec<_>>(), expected);
}

#[test]
fn tables_and_header_of_fast_run_have_equal_digits() {
    let (mut run, mut series) = run_of_an_hour();
    let total = 18.31e-6;
    run.summary.total = Some(crate::tests::samples::figures(total, 895));
    series.stages[0].points.iter_mut().for_each(|point| point.p50 = total);
    let slow = IterationRow { total: Some(total), ..crate::tests::samples::iteration().row };
    let statistics = RunStatistics::default();
    let stored = StoredRun {
        run: &run,
        statistics: &statistics,
        series: &series,
        slowest: std::slice::from_ref(&slow),
        failed: &[],
        episodes: &Episodes::default(),
        starts: Starts::default(),
    };
    let header = peernet_statistics::number::milliseconds(total);
    let zone = Zone::default();
    assert_eq!(header, "0.0183");
    assert_eq!((&stored.buckets(zone)[0].p50, &stored.slow_rows(zone)[0].total), (&header, &header));
    let total_stage = stage_statistics(stage::TOTAL, total, 895);
    assert_eq!(crate::view::stages::StageRow::of_run(&[total_stage], &[])[0].mean, header);
    let tooltip = serde_json::to_string(&RoundedNumber(Some(total * 1e3))).expect("serialises");
    assert_eq!(tooltip, "0.01831");
}
