//! Tests of the values from which a run's trust findings are computed.

use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::{LATENESS, Outcome, Row, RowRef, Rows};
use peernet_analysis::trust::Report;
use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict, WallTime};
use peernet_logger::{HostId, Name, RunId};
use peernet_statistics::Summary;
use peernet_stream::{Grade, OutcomeCounts, Placement, PlacementKind};

use super::*;
use crate::quantity_statistics::QuantityStatistics;
use crate::types::{GapRow, StageStatistics};

const NOW: WallTime = WallTime::from_unix_nanos(1_800_000_000_000_000_000);

fn summary(reason: &str) -> RunSummary {
    RunSummary {
        number: 1,
        id: RunId::random(),
        host: HostId::random(),
        host_name: "edge".parse().expect("a name"),
        pipeline: "line".parse().expect("a name"),
        placement: Placement {
            kind: PlacementKind::Remote,
            peer: Some("cloud".parse().expect("a name")),
            network: None,
            address: None,
            model: "m".parse().expect("a name"),
            device: None,
        },
        started: NOW,
        ended: Some(NOW + Span::from_seconds(60)),
        reason: Some(reason.into()),
        last_iteration: Some(NOW + Span::from_seconds(59)),
        counts: OutcomeCounts { ok: 300, ..OutcomeCounts::default() },
        warm_up: 5,
        skipped_starts: 0,
        deadline_s: None,
        misses: None,
        actuator: Default::default(),
        total: None,
        has_clock_fault: false,
        pinned: false,
        last_deleted_iteration: 0,
        experiment: None,
    }
}

/// Returns the statistics of a node name.
fn node(name: &str, count: u64, mean: f64) -> StageStatistics {
    let statistics =
        QuantityStatistics { count, mean, std: None, min: mean, p50: mean, p95: None, p99: None, max: mean };
    let (stage, unit) = (Name::from(name), "s".to_owned());
    StageStatistics { stage, unit, is_stage: false, statistics, share: None, bound: None }
}

/// Returns the times of a run without warm-up.
fn times(run: &RunDetail) -> StartTimes {
    StartTimes { first: Some(NOW), last: run.summary.last_iteration, standstill_s: None }
}

fn report(run: &RunDetail, stages: Vec<StageStatistics>) -> Report {
    Report::new(&collect_input(
        run,
        times(run),
        Some(9),
        &RunStatistics { stages, ..RunStatistics::default() },
        &[],
    ))
}

/// Returns a run of 300 iterations in 59 s, with a configuration and the reason of its end.
fn detail(configuration: &str, reason: &str) -> RunDetail {
    RunDetail { configuration: configuration.to_owned(), ..summary(reason).into() }
}

/// Returns the grade and the text of the finding about the run's end.
fn end_finding(run: &RunDetail) -> Option<(Grade, String)> {
    let report = report(run, Vec::new());
    let found = report.findings.into_iter().find(|finding| finding.about == "end");
    found.map(|finding| (finding.grade, finding.text))
}

#[test]
fn run_that_ended_before_its_limit_is_reported() {
    let configuration =
        |count: u32| format!("name = \"line\"\nmodel = \"m\"\n\n[limit]\niterations = {count}\n");
    let finding = |grade, text: &str| Some((grade, text.to_owned()));
    assert_eq!(
        end_finding(&detail(&configuration(400), "stopped")),
        finding(Grade::Doubtful, "The run was interrupted after 300 of 400 iterations.")
    );
    assert_eq!(
        end_finding(&detail(&configuration(1_000), "the server went")),
        finding(Grade::Bad, "The run broke off after 300 of 1,000 iterations: the server went.")
    );
    let with_duration = "name = \"line\"\n\n[limit]\nduration_s = 80.0\n";
    assert_eq!(
        end_finding(&detail(with_duration, "stopped")),
        finding(Grade::Doubtful, "The run was interrupted after 59.0 of 80.0\u{202f}s.")
    );
    let with_episodes = "name = \"line\"\n\n[limit]\nepisodes = 12\n";
    assert_eq!(
        end_finding(&detail(with_episodes, "stopped")),
        finding(Grade::Doubtful, "The run was interrupted after 9 of 12 episodes.")
    );
    for without_finding in
        [&configuration(300), "name = \"line\"\n", "# cannot be written down: why\n", "= not TOML"]
    {
        assert_eq!(end_finding(&detail(without_finding, "stopped")), None, "{without_finding}");
    }
}

#[test]
fn answers_without_score_are_reported() {
    let run = detail("", "finished");
    let ok = run.summary.counts.ok;
    let score_finding = |count| {
        let report = report(&run, vec![node("top-1", count, 0.75)]);
        report.findings.into_iter().find(|finding| finding.text.contains("top-1"))
    };
    let text = score_finding(ok - 12).expect("a finding").text;
    assert!(text.contains("12"), "{text}");
    assert!(score_finding(ok).is_none(), "all answers have a score");
}

#[test]
fn restarted_process_is_reported() {
    let report = report(&detail("", "finished"), vec![node(&stage::RESTART, 2, 0.5)]);
    let finding = report.findings.iter().find(|finding| finding.about == "restarts").expect("a finding");
    assert!(
        finding.text.contains(
            "The model's process was restarted in 2 iterations. The waits for the restarts took 1,000"
        ),
        "{finding:?}"
    );
}

#[test]
fn drawn_latencies_and_overrun_are_collected() {
    let mut run = detail("", "finished");
    run.facts.push(("Replayed".to_owned(), "inference is drawn from x".to_owned()));
    let stages = vec![node("drawn-latency", 300, 0.01), node("overrun", 300, 0.002)];
    let statistics = RunStatistics { stages, ..RunStatistics::default() };
    let input = collect_input(&run, StartTimes::default(), None, &statistics, &[]);
    assert_eq!((input.replayed.as_deref(), input.overrun), (Some("inference is drawn from x"), Some(0.002)));
    assert_eq!(input.drawn, Some(0.01));
}

#[test]
fn labels_outside_models_classes_are_reported() {
    let mut run = detail("", "finished");
    run.facts.push(("Classes".to_owned(), "4: good, dented".to_owned()));
    let report = report(&run, vec![node("unknown-label", 12, 1.0)]);
    let finding = report.findings.iter().find(|finding| finding.about == "accuracy").expect("a finding");
    assert!(
        finding.text.starts_with("Not scored: 12 of") && finding.text.contains("good, dented"),
        "{finding:?}"
    );
}

#[test]
fn skipped_starts_are_reported_with_configured_rate() {
    let mut run = detail("name = \"line\"\n\n[load]\nmode = \"rate\"\nhz = 40\n", "finished");
    let mut skip_finding = |skipped_starts| {
        run.summary.skipped_starts = skipped_starts;
        let report = report(&run, Vec::new());
        let found = report.findings.into_iter().find(|finding| finding.about == "skipped starts");
        found.map(|finding| (finding.grade, finding.text)).expect("a finding")
    };
    let (grade, text) = skip_finding(300);
    let rates = "40.0\u{202f}Hz were configured, 5.07\u{202f}Hz achieved";
    assert!(grade == Grade::Bad && text.starts_with("300 of 600 starts") && text.contains(rates), "{text}");
    assert_eq!(skip_finding(0).0, Grade::Good);
}

#[test]
fn missing_events_count_in_rate_as_in_result_files() {
    let rows: Rows = (1..=300).map(row).collect();
    let record =
        |unseen| RunRecord { counts: Counts { unseen, ..Counts::default() }, ..RunRecord::default() };
    for missing in [0, 60] {
        let mut run = detail("", "finished");
        let (first, last) = (NOW, NOW + Span::from_seconds(299));
        run.summary.last_iteration = Some(last);
        if missing > 0 {
            run.gaps.push(GapRow {
                from: first,
                to: last,
                count: missing,
                reason: "full".to_owned(),
                gaps: 1,
            });
        }
        let stored = collect_input(&run, times(&run), None, &RunStatistics::default(), &[]).starts;
        let of_files = TrustInput::from_run(&record(missing), &rows).starts;
        assert_eq!(stored.actual_hz(), of_files.actual_hz());
        assert_eq!(of_files.actual_hz(), Some((299 + missing) as f64 / 299.0));
    }
}

#[test]
fn run_with_missing_events_is_not_reported_as_ended_early() {
    let mut run = detail("[limit]\niterations = 400\n", "stopped");
    let gap = |count| GapRow {
        from: NOW,
        to: NOW + Span::from_seconds(1),
        count,
        reason: "full".to_owned(),
        gaps: 1,
    };
    run.gaps = vec![gap(100)];
    assert_eq!(
        end_finding(&run),
        None,
        "the 100 missing events were measured: 300 + 100 iterations reach the limit"
    );
    run.gaps = vec![gap(0)];
    assert_eq!(end_finding(&run), None, "the number of missing events is unknown");
    run.gaps.clear();
    run.summary.ended = None;
    let open =
        "The run has no recorded end (in progress or killed): the findings cover the iterations so far.";
    assert_eq!(end_finding(&run), Some((Grade::Unknown, open.to_owned())));
}

/// Returns the row of an iteration of a run in an open loop. The delays of every fifth iteration are unknown.
fn row(iteration: u64) -> Row {
    let milliseconds = |value: f64| value / 1e3;
    let noise = (iteration % 7) as f64 / 10.0;
    let delay = |value: f64| {
        let [lo, value, hi] =
            [value - 0.2, value, value + 0.2].map(|value| Span::from_seconds_f64(milliseconds(value)));
        let is_known = !iteration.is_multiple_of(5);
        OneWayDelay {
            raw: value,
            value: is_known.then_some(value),
            bounds: is_known.then_some(Interval { lo, hi }),
            source: DelaySource::InBand,
            verdict: if is_known { Verdict::Ok } else { Verdict::Unsynchronised },
        }
    };
    let (up, down) = (delay(6.0 + noise), delay(2.0 + noise));
    let delays = [("upload", up), ("download", down)].map(|(name, delay)| (name, delay.known_seconds()));
    let others = [
        ("sensing", Some(milliseconds(3.0))),
        ("inference", Some(milliseconds(9.0))),
        ("total", Some(milliseconds(22.0 + 3.0 * noise))),
        ("unattributed", up.known_seconds().map(|_| milliseconds(2.0 + noise))),
        (LATENESS, Some(milliseconds(1.0 + noise))),
        ("restart", (iteration == 33).then_some(0.05)),
        ("inference_overrun", Some(milliseconds(noise))),
        ("upload-bytes", Some(1_000.0)),
        ("upload-logger-bytes", Some(100.0)),
        ("download-bytes", Some(1_000.0)),
        ("download-logger-bytes", Some(100.0)),
    ];
    let values = delays.into_iter().chain(others);
    Row {
        iteration,
        at: iteration as f64,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: Outcome::Ok,
        reason: None,
        values: values.filter_map(|(name, value)| Some((name.into(), value?))).collect(),
        upload: Some(up),
        download: Some(down),
    }
}

#[test]
fn rows_of_files_and_roll_ups_give_same_trust_input() {
    let rows: Rows = (1..=300).map(row).collect();
    let input = TrustInput::from_rows(&rows, &[]);
    // These are the same values in the form in which the store has them.
    let of_values = |name: &str, values: &mut dyn Iterator<Item = f64>| {
        let mut summary = Summary::default();
        values.for_each(|value| summary.record(value));
        let statistics = QuantityStatistics::from_summary(&summary)?;
        Some(StageStatistics { statistics, ..node(name, 0, 0.0) })
    };
    let names = ["sensing", "upload", "inference", "download", "total", "unattributed", LATENESS, "restart"];
    let stages = names.into_iter().filter_map(|name| of_values(name, &mut rows.values_in_statistics(name)));
    let overrun = of_values("overrun", &mut rows.values_in_statistics("inference_overrun"));
    type ReadDelay = fn(&RowRef<'_>) -> Option<OneWayDelay>;
    let directions: [(Name, ReadDelay); 2] =
        [(stage::UPLOAD, |row| row.upload()), (stage::DOWNLOAD, |row| row.download())];
    let bounds = directions.map(|(stage, delay)| {
        let delays = || rows.iter().filter_map(|row| delay(&row));
        let verdicts = [Verdict::Ok, Verdict::Unsynchronised]
            .map(|verdict| (verdict, delays().filter(|delay| delay.verdict == verdict).count() as u64));
        let mut half_widths =
            delays().filter_map(|delay| delay.known_bounds()).map(|(lo, hi)| (hi - lo) / 2.0);
        let half_width = of_values(&stage, &mut half_widths).map(|row| row.statistics);
        let bounds = || delays().filter_map(|delay| delay.known_bounds());
        let statistics_of_ends =
            |values: &mut dyn Iterator<Item = f64>| of_values(&stage, values).map(|row| row.statistics);
        let ends = statistics_of_ends(&mut bounds().map(|(lo, _)| lo))
            .zip(statistics_of_ends(&mut bounds().map(|(_, hi)| hi)));
        let ends = ends.map(|(lower, upper)| [lower, upper]);
        DelayAccuracy { half_width, ends, verdicts: verdicts.to_vec(), stage }
    });
    let statistics = RunStatistics {
        stages: stages.chain(overrun).collect(),
        bounds: bounds.to_vec(),
        ..RunStatistics::default()
    };
    let stored = collect_input(&detail("", "finished"), StartTimes::default(), None, &statistics, &[]);
    let near = |a: Option<f64>, b: Option<f64>| a.zip(b).is_some_and(|(a, b)| (a - b).abs() < 1e-9);
    assert!(
        near(input.split.unexplained(), stored.split.unexplained()),
        "{:?} {:?}",
        input.split,
        stored.split
    );
    assert!(near(input.split.lateness, stored.split.lateness) && near(input.overrun, stored.overrun));
    let restarts = |input: &TrustInput| {
        input.restarts.iter().map(|restarts| (restarts.owner, restarts.count)).collect::<Vec<_>>()
    };
    assert_eq!(restarts(&input), restarts(&stored));
    for (of_rows, of_store) in input.clocks.iter().zip(&stored.clocks) {
        assert_eq!((&of_rows.stage, &of_rows.verdicts), (&of_store.stage, &of_store.verdicts));
        // The store has sketches, whose quantiles have an error of up to 1 %.
        let within =
            |a: Option<f64>, b: Option<f64>| a.zip(b).is_some_and(|(a, b)| (a / b - 1.0).abs() < 0.011);
        let [interval, stored_interval] =
            [of_rows, of_store].map(|clocks| clocks.interval.expect("some delays have bounds"));
        assert!(
            within(of_rows.delay, of_store.delay)
                && within(Some(interval.lo), Some(stored_interval.lo))
                && within(Some(interval.hi), Some(stored_interval.hi))
                && interval.method == stored_interval.method,
            "{of_rows:?} {of_store:?}"
        );
    }
    assert_eq!((input.clocks.len(), stored.clocks.len()), (2, 2));
}
