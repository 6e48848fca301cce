//! Tests of the input of a run's judgement.

use peernet_analysis::trust::Report;
use peernet_clock::{Span, WallTime};
use peernet_logger::{HostId, Name, RunId};
use peernet_stream::{Grade, OutcomeCounts, Placement, PlacementKind};

use super::*;
use crate::figures::QuantityStatistics;
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
        nodes_from: 0,
        experiment: None,
    }
}

/// Returns the statistics of a node name.
fn node(name: &str, count: u64, mean: f64) -> StageStatistics {
    let figures =
        QuantityStatistics { count, mean, std: None, min: mean, p50: mean, p95: None, p99: None, max: mean };
    let (stage, unit) = (Name::from(name), "s".to_owned());
    StageStatistics { stage, unit, is_stage: false, figures, share: None, bound: None }
}

fn report(run: &RunDetail, stages: Vec<StageStatistics>) -> Report {
    Report::new(&collect(run, Some(NOW), &RunStatistics { stages, ..RunStatistics::default() }, &[]))
}

/// A run of 300 iterations in 59 s.
fn detail(configuration: &str, reason: &str) -> RunDetail {
    RunDetail { configuration: configuration.to_owned(), ..summary(reason).into() }
}

fn end(run: &RunDetail) -> Option<(Grade, String)> {
    let report = report(run, Vec::new());
    let found = report.findings.into_iter().find(|sentence| sentence.about == "end");
    found.map(|sentence| (sentence.grade, sentence.text))
}

#[test]
fn run_that_ended_before_its_limit_is_reported() {
    let of = |count: u32| format!("name = \"line\"\nmodel = \"m\"\n\n[limit]\niterations = {count}\n");
    let said = |grade, text: &str| Some((grade, text.to_owned()));
    assert_eq!(
        end(&detail(&of(400), "stopped")),
        said(Grade::Doubtful, "The run was interrupted after 300 of 400 iterations.")
    );
    assert_eq!(
        end(&detail(&of(1_000), "the server went")),
        said(Grade::Bad, "The run broke off after 300 of 1,000 iterations: the server went.")
    );
    let seconds = "name = \"line\"\n\n[limit]\nduration_s = 80.0\n";
    assert_eq!(
        end(&detail(seconds, "stopped")),
        said(Grade::Doubtful, "The run was interrupted after 59.0 of 80.0\u{202f}s.")
    );
    for whole in [&of(300), "name = \"line\"\n", "# cannot be written down: why\n", "= not TOML"] {
        assert_eq!(end(&detail(whole, "stopped")), None, "{whole}");
    }
}

#[test]
fn answers_without_score_are_reported() {
    let run = detail("", "finished");
    let ok = run.summary.counts.ok;
    let said = |count| {
        let report = report(&run, vec![node("top-1", count, 0.75)]);
        report.findings.into_iter().find(|sentence| sentence.text.contains("top-1"))
    };
    let text = said(ok - 12).expect("a sentence").text;
    assert!(text.contains("12"), "{text}");
    assert!(said(ok).is_none(), "all were scored");
}

#[test]
fn restarted_process_is_reported() {
    let report = report(&detail("", "finished"), vec![node(&stage::RESTART, 2, 0.5)]);
    let said = report.findings.iter().find(|sentence| sentence.about == "restarts").expect("said");
    assert!(
        said.text.contains("The model's process was restarted in 2 iterations. The wait for it was 1,000"),
        "{said:?}"
    );
}

#[test]
fn replayed_latencies_and_overrun_are_collected() {
    let mut run = detail("", "finished");
    run.facts.push(("Replayed".to_owned(), "inference is drawn from x".to_owned()));
    let statistics = RunStatistics { stages: vec![node("overrun", 300, 0.002)], ..RunStatistics::default() };
    let input = collect(&run, None, &statistics, &[]);
    assert_eq!((input.replayed.as_deref(), input.overrun), (Some("inference is drawn from x"), Some(0.002)));
}

#[test]
fn labels_outside_models_classes_are_reported() {
    let mut run = detail("", "finished");
    run.facts.push(("Classes".to_owned(), "4: good, dented".to_owned()));
    let report = report(&run, vec![node(UNKNOWN_LABEL, 12, 1.0)]);
    let said = report.findings.iter().find(|sentence| sentence.about == "accuracy").expect("said");
    assert!(said.text.starts_with("Not scored: 12 of") && said.text.contains("good, dented"), "{said:?}");
}

#[test]
fn skipped_starts_are_reported_with_ordered_rate() {
    let mut run = detail("name = \"line\"\n\n[load]\nmode = \"rate\"\nhz = 40\n", "finished");
    let mut said = |skipped_starts| {
        run.summary.skipped_starts = skipped_starts;
        let report = report(&run, Vec::new());
        let found = report.findings.into_iter().find(|sentence| sentence.about == "skipped starts");
        found.map(|sentence| (sentence.grade, sentence.text)).expect("said")
    };
    let (grade, text) = said(300);
    let rates = "40.0\u{202f}Hz were configured, 5.07\u{202f}Hz achieved";
    assert!(grade == Grade::Bad && text.starts_with("300 of 600 starts") && text.contains(rates), "{text}");
    assert_eq!(said(0).0, Grade::Good);
}

#[test]
fn unknown_number_of_missing_events_is_not_reported() {
    let mut run = detail("[limit]\niterations = 400\n", "stopped");
    let gap = |count| GapRow { from: NOW, to: NOW + Span::from_seconds(1), count, reason: "full".to_owned() };
    run.gaps = vec![gap(100)];
    assert_eq!(end(&run), None, "measured, though not stored");
    run.gaps = vec![gap(0)];
    assert_eq!(end(&run), None, "an unknown number");
    run.gaps.clear();
    run.summary.ended = None;
    let open = "The run has not ended: the findings cover the iterations so far.";
    assert_eq!(end(&run), Some((Grade::Unknown, open.to_owned())));
}
