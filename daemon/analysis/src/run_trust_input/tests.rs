//! Tests of the trust input that the record of a run adds to the input from its rows.

use peernet_stream::Grade;

use super::*;
use crate::rows::Outcome;
use crate::trust::testing::{about, governor, rows, steady_totals};
use crate::trust::{Publish, Report};

#[test]
fn skipped_starts_are_reported_and_graded() {
    let grade_and_text = |load: serde_json::Value, skipped: u64| {
        let record = RunRecord { pipeline: serde_json::json!({ "load": load }), ..RunRecord::default() };
        let mut rows = rows(steady_totals(1005));
        // Starts were skipped in the warm-up, before an answered iteration and before a lost one.
        rows.change(|row| match row.iteration {
            3 => row.values.push(("skipped-starts".into(), 70.0)),
            10 => row.values.push(("skipped-starts".into(), skipped as f64 - 1.0)),
            20 => {
                row.outcome = Outcome::Lost;
                row.values.push(("skipped-starts".into(), 1.0));
            }
            _ => {}
        });
        let report = Report::new(&TrustInput::from_run(&record, &rows));
        let found = report.findings.iter().find(|finding| finding.about == "skipped starts");
        found.map(|finding| (finding.grade, finding.text.clone()))
    };
    let rate = serde_json::json!({ "mode": "rate", "hz": 40 });
    let poisson = serde_json::json!({ "mode": "poisson", "hz": 40.0, "seed": 7 });
    for load in [&rate, &poisson] {
        let text = "1,041 of 2,041 starts (51\u{202f}%) were skipped because the pipeline could not keep up: \
                    40.0\u{202f}Hz were configured, 1.00\u{202f}Hz achieved. The pipeline worked at its limit, which shows in the latency.";
        assert_eq!(grade_and_text(load.clone(), 1041), Some((Grade::Bad, text.to_owned())));
    }
    let (grade, text) = grade_and_text(rate.clone(), 20).expect("a finding");
    assert!(grade == Grade::Doubtful && text.starts_with("20 of 1,020 starts (2.0\u{202f}%)"), "{text}");
    let (grade, text) = grade_and_text(rate.clone(), 1).expect("a finding");
    assert!(grade == Grade::Good && text.starts_with("1 of 1,001 starts (0.10\u{202f}%) was"), "{text}");
    let (_, text) = grade_and_text(serde_json::json!(null), 1041).expect("a finding");
    assert!(text.contains("could not keep up. The pipeline worked at its limit"), "{text}");
    let record = RunRecord { pipeline: serde_json::json!({ "load": rate }), ..RunRecord::default() };
    let report = Report::new(&TrustInput::from_run(&record, &rows(steady_totals(205))));
    let text = "No start was skipped: 40.0\u{202f}Hz were configured and achieved.";
    assert_eq!(about(&report, "skipped starts"), (Grade::Good, text));
}

#[test]
fn record_adds_findings_to_those_of_rows() {
    let mut record = RunRecord { reason: "the model crashed".into(), ..RunRecord::default() };
    record.edge.conditions = vec![governor(Grade::Doubtful)];
    record.counts.unseen = 3;
    // `Rehearsal` is the name of a clock fault in earlier versions.
    record.facts = vec![("Rehearsal of cloud".to_owned(), "+137 ms".to_owned())];
    let report = Report::new(&TrustInput::from_run(&record, &rows(steady_totals(1005))));
    assert_eq!(report.verdict, Publish::No);
    let grades: Vec<Grade> = report.findings.iter().map(|finding| finding.grade).collect();
    assert_eq!(report.findings[0].about, "end", "the finding on the end of the run comes first");
    assert!(grades[1..].is_sorted_by(|a, b| a >= b), "the other findings are sorted by severity: {grades:?}");
    assert_eq!(about(&report, "clock fault").0, Grade::Bad);
    assert_eq!(about(&report, "missing events").0, Grade::Doubtful);
    assert_eq!(about(&report, "end").1, "The run broke off: the model crashed.");
    assert_eq!(about(&report, "CPU governor").1, "On robot, CPU governor: as it is.");
    assert!(report.text().contains("\n    → change it"), "{}", report.text());
}

#[test]
fn interrupted_run_of_episodes_is_reported() {
    let findings = |reason: &str| {
        let pipeline = serde_json::json!({ "limit": { "episodes": 6 } });
        let record = RunRecord { reason: reason.into(), pipeline, ..RunRecord::default() };
        let mut rows = rows(steady_totals(205));
        rows.change(|row| row.episode = (row.iteration / 50) as u32);
        Report::new(&TrustInput::from_run(&record, &rows)).findings
    };
    assert_eq!(findings("stopped")[0].text, "The run was interrupted after 4 of 6 episodes.");
    assert!(findings("finished").iter().all(|finding| finding.about != "end"));
}

#[test]
fn incomplete_run_is_reported_first() {
    let verdict_and_text = |limit: serde_json::Value, reason: &str| {
        let record = RunRecord {
            reason: reason.into(),
            pipeline: serde_json::json!({ "limit": limit }),
            ..RunRecord::default()
        };
        // The run has 5 iterations of warm-up and 200 measured iterations, one iteration per second.
        let report = Report::new(&TrustInput::from_run(&record, &rows(steady_totals(205))));
        (report.verdict, report.findings[0].text.clone())
    };
    let iterations = |count: u32| serde_json::json!({ "iterations": count });
    let total = serde_json::json!({ "total": 205 });
    for (limit, reason) in [(iterations(200), "finished"), (total, "stopped"), (iterations(150), "stopped")] {
        let (_, text) = verdict_and_text(limit, reason);
        assert!(!text.starts_with("The run"), "{text}");
    }
    // A run that reached less than half of its limit is too short.
    let cases = [
        (400, "stopped", Publish::WithRemarks, "The run was interrupted after 200 of 400 iterations."),
        (401, "stopped", Publish::No, "The run was interrupted after 200 of 401 iterations."),
        (
            210,
            "the server went",
            Publish::WithRemarks,
            "The run broke off after 200 of 210 iterations: the server went.",
        ),
        (
            1000,
            "the server went",
            Publish::No,
            "The run broke off after 200 of 1,000 iterations: the server went.",
        ),
        (
            250,
            "finished",
            Publish::WithRemarks,
            "The run finished after 200 of 250 iterations: there was nothing more to measure.",
        ),
    ];
    for (limit, reason, verdict, text) in cases {
        assert_eq!(verdict_and_text(iterations(limit), reason), (verdict, text.to_owned()));
    }
    let ten_minutes = serde_json::json!({ "duration_s": 600.0 });
    let (verdict, text) = verdict_and_text(ten_minutes.clone(), "stopped");
    assert_eq!(
        (verdict, text.as_str()),
        (Publish::No, "The run was interrupted after 199.0 of 600\u{202f}s.")
    );
    assert!(
        !verdict_and_text(ten_minutes, "finished").1.starts_with("The run"),
        "a finished run with a time limit is complete"
    );
}
