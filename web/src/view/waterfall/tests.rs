//! Tests of the rows of an iteration's page.

use peernet_analysis::slowness::{Cause, IterationTimes};
use peernet_clock::{DelaySource, OneWayDelay, Span, WallTime};
use peernet_logger::{Measure, Name, NodeId, Transit, stage};

use super::*;
use crate::tests::samples;

/// Returns an answered iteration of 1.2 s whose two directions were judged `stepped`.
fn stepped_iteration() -> IterationDetail {
    let mut detail = samples::iteration();
    let at = |seconds: i64| WallTime::from_unix_nanos(seconds * 1_000_000_000);
    let sensing = Measure::Timer(Some(Span::from_micros(2_200)));
    detail.tree.add(NodeId::ROOT, stage::SENSING, Span::ZERO, sensing);
    for (name, start) in [(stage::UPLOAD, 3), (stage::DOWNLOAD, 600)] {
        let delay = OneWayDelay::stepped(Span::from_seconds(-2), DelaySource::None);
        let transit = Transit { sent: at(9), received: Some(at(7)), delay: Some(delay), raw_stamps: None };
        let transit = Measure::Transit(Box::new(transit));
        detail.tree.add(NodeId::ROOT, name.clone(), Span::from_millis(start), transit);
        detail.row.delays.push(peernet_store::DelayRow {
            stage: name,
            value: None,
            bounds: None,
            raw: -2.0,
            source: DelaySource::None,
            verdict: peernet_clock::Verdict::Stepped,
            assumptions: None,
        });
    }
    let row = &mut detail.row;
    row.total = Some(1.2);
    row.stages = vec![(stage::SENSING, 0.0022)];
    (row.unattributed, row.both_ways) = (Some(0.0118), Some(1.186));
    detail
}

/// Returns name and value of each row of the page.
fn names_and_values(detail: &IterationDetail) -> Vec<(String, String)> {
    let timeline = Timeline::of(detail);
    let rows = rows(detail, &timeline, &["cam-1".to_owned()], &Scale::up_to(1_200.0, 6));
    rows.into_iter().map(|row| (row.name, row.value)).collect()
}

#[test]
fn table_of_stepped_iteration_has_sum_of_directions() {
    let rows = names_and_values(&stepped_iteration());
    let value_of =
        |stage_name: &str| rows.iter().find(|(name, _)| name == stage_name).map(|(_, value)| value.as_str());
    assert_eq!((value_of("upload"), value_of("download")), (Some("—"), Some("—")));
    assert_eq!((value_of("upload + download"), value_of("unattributed")), (Some("1,186.00"), Some("11.80")));
}

#[test]
fn waterfall_and_bar_have_one_order() {
    let mut detail = stepped_iteration();
    let inference = Measure::Timer(Some(Span::from_micros(200)));
    detail.tree.add(NodeId::ROOT, stage::INFERENCE, Span::from_millis(500), inference);
    detail.row.stages.push((stage::INFERENCE, 0.0002));
    detail.row.unattributed = Some(0.0116);
    let parts = stack::Stack::of_iteration(&detail.row).parts;
    let parts: Vec<String> = parts.into_iter().map(|part| part.name).collect();
    assert_eq!(parts, ["sensing", look::NETWORK, "inference", "unattributed"]);
    let names = names_and_values(&detail).into_iter().map(|(name, _)| name);
    assert_eq!(names.filter(|name| parts.contains(name)).collect::<Vec<_>>(), parts);
}

#[test]
fn network_and_unattributed_time_may_share_a_row() {
    let mut detail = stepped_iteration();
    (detail.row.unattributed, detail.row.both_ways) = (None, None);
    let rows = names_and_values(&detail);
    assert!(rows.contains(&(NETWORK_AND_REST.to_owned(), "1,197.80".to_owned())), "{rows:?}");
    assert!(rows.iter().all(|(name, _)| name != "unattributed"), "{rows:?}");
}

#[test]
fn lateness_row_follows_unattributed_time() {
    let mut detail = samples::iteration();
    detail.row.unattributed = detail.row.total;
    let late = Measure::Timer(Some(Span::from_micros(500)));
    detail.tree.add(NodeId::ROOT, Name::from(look::LATENESS), Span::ZERO, late);
    let timeline = Timeline::of(&detail);
    let rows = rows(&detail, &timeline, &["cam-1".to_owned()], &Scale::up_to(100.0, 6));
    let end: Vec<(&str, u8)> =
        rows[rows.len() - 3..].iter().map(|row| (row.name.as_str(), row.depth)).collect();
    assert_eq!(end, [("unattributed", 0), ("lateness", 1), ("total", 0)]);
    assert_eq!(rows.iter().filter(|row| row.name == look::LATENESS).count(), 1);
}

#[test]
fn cause_and_row_of_one_name_agree() {
    let mut detail = samples::iteration();
    let medians = [
        (stage::TOTAL, 0.010),
        (stage::INFERENCE, 0.0099),
        (stage::UNATTRIBUTED, 0.0002),
        (stage::LATENESS, 0.0001),
    ];
    detail.run_figures = medians.map(|(name, median)| (name, samples::figures(median, 100))).to_vec();
    let late = Measure::Timer(Some(Span::from_micros(3_100)));
    detail.tree.add(NodeId::ROOT, stage::LATENESS, Span::ZERO, late);
    (detail.row.total, detail.row.unattributed) = (Some(0.016), Some(0.0061));
    detail.row.stages = vec![(stage::INFERENCE, 0.0099)];
    let times = IterationTimes {
        total: detail.row.total,
        stages: &detail.row.stages,
        lateness: Some(0.0031),
        unattributed: detail.row.unattributed,
        both_ways: None,
    };
    detail.row.causes = detail.medians().causes(&times);
    let timeline = Timeline::of(&detail);
    let format = timeline.duration_format();
    let rows = rows(&detail, &timeline, &["cam-1".to_owned()], &Scale::up_to(100.0, 6));
    for cause in &detail.row.causes {
        for row in rows.iter().filter(|row| row.name == cause.name.as_str()) {
            assert_eq!(row.difference, format.difference(cause.excess()), "{}", row.name);
        }
    }
    let causes: Vec<(&str, &str)> = rows
        .iter()
        .filter(|row| row.is_cause)
        .map(|row| (row.name.as_str(), row.difference.as_str()))
        .collect();
    assert_eq!(causes, [("unattributed", "+5.90"), ("lateness", "+3.00")]);
}

#[test]
fn only_nodes_that_statistics_count_are_compared() {
    let mut detail = samples::iteration();
    let tree = &mut detail.tree;
    let mut add = |parent, name: Name, millis| {
        tree.add(parent, name, Span::ZERO, Measure::Timer(Some(Span::from_millis(millis))))
    };
    let inference = add(NodeId::ROOT, stage::INFERENCE, 40);
    let inner = add(inference, Name::from_static("inner-model"), 12);
    add(inner, stage::INFERENCE, 10);
    add(NodeId::ROOT, stage::SEND_QUEUE, 3);
    add(NodeId::ROOT, stage::SEND_QUEUE, 2);
    // In a run whose iterations are all like this one, each median is the value in `data.csv`.
    let iteration = peernet_stream::Iteration {
        run: peernet_logger::RunId::random(),
        number: 1,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: peernet_stream::Outcome::Ok,
        tree: detail.tree.clone(),
    };
    let file_row = peernet_analysis::rows::Row::from_iteration(&iteration);
    let median_in_file = |name: &Name| file_row.value(name.as_str()).expect("a column");
    assert_eq!([stage::INFERENCE, stage::SEND_QUEUE].map(|name| median_in_file(&name)), [0.04, 0.005]);
    detail.run_figures.retain(|(name, _)| *name != stage::INFERENCE && *name != stage::SEND_QUEUE);
    for name in [stage::INFERENCE, stage::SEND_QUEUE] {
        let median = samples::figures(median_in_file(&name), 100);
        detail.run_figures.push((name, median));
    }
    detail.row.causes = vec![Cause { name: stage::INFERENCE, value: 0.04, median: 0.03 }];
    let timeline = Timeline::of(&detail);
    let rows = rows(&detail, &timeline, &["cam-1".to_owned()], &Scale::up_to(100.0, 6));
    let compared = |name: &str| {
        let rows = rows.iter().filter(|row| row.name == name);
        rows.map(|row| (row.value.clone(), row.median.clone(), row.is_cause)).collect::<Vec<_>>()
    };
    let row = |value: &str, median: &str, is_cause| (value.to_owned(), median.to_owned(), is_cause);
    assert_eq!(compared("inference"), [row("40.00", "40.00", true), row("10.00", NONE, false)]);
    assert_eq!(compared("send-queue"), [row("3.00", NONE, false), row("2.00", NONE, false)]);
}

#[test]
fn delay_has_digits_of_its_bounds() {
    let mut detail = samples::iteration();
    let micros = Span::from_micros;
    let delay = OneWayDelay {
        raw: micros(1_204_043),
        value: Some(micros(43)),
        bounds: Some(peernet_clock::Interval { lo: micros(39), hi: micros(48) }),
        source: DelaySource::InBand,
        verdict: peernet_clock::Verdict::Ok,
    };
    let at = WallTime::from_unix_nanos(0);
    let transit = Transit { sent: at, received: Some(at + delay.raw), delay: Some(delay), raw_stamps: None };
    detail.tree.add(NodeId::ROOT, stage::UPLOAD, Span::ZERO, Measure::Transit(Box::new(transit)));
    detail.row.delays = vec![peernet_store::DelayRow {
        stage: stage::UPLOAD,
        value: Some(43e-6),
        bounds: Some((39e-6, 48e-6)),
        raw: 1.204_043,
        source: DelaySource::Chrony,
        verdict: peernet_clock::Verdict::Ok,
        assumptions: Some(peernet_store::DelayAssumptions {
            clocks: peernet_clock::RelatedClocks::Raw,
            max_drift_ppm: Some(200.0),
            max_drift_change_ppm_per_s: None,
            claims_trusted: Some(true),
            probes_authenticated: Some(false),
        }),
    }];
    let row = &delays(&Timeline::of(&detail), &detail.row.delays)[0];
    let basis = format!("by free-running clocks, ρ 200{SPACE}ppm, probes not authenticated");
    // The source comes from the tree. Only the assumptions come from the row of the database.
    assert_eq!((row.source, row.basis.as_str()), ("in-band", basis.as_str()));
    let texts = [&row.raw, &row.offset, &row.value, &row.lo, &row.hi].map(String::as_str);
    assert_eq!(texts, ["1,204.043", "+1,204.000", "0.043", "0.039", "0.048"]);
    assert_eq!(delay.clock_offset(), Some(Span::from_millis(1_204)), "offset as in run.json");
}
