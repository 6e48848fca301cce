//! Tests of the findings about runs with known properties.

mod answers;

use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict};
use peernet_statistics::SplitMix64;

use super::testing::{about, governor, rows, steady_totals};
use super::*;
use crate::outcomes::Counts;
use crate::rows::{Outcome, Row, Rows};

// Indices of the values of a row of `testing::row`.
const INFERENCE: usize = 0;
const TOTAL: usize = 1;
const UNATTRIBUTED: usize = 2;

fn report_on(rows: &Rows) -> Report {
    Report::new(&TrustInput::from_rows(rows, &[governor(Grade::Good)]))
}

#[test]
fn steady_run_can_be_published() {
    let report = report_on(&rows(steady_totals(1005)));
    assert_eq!(report.verdict, Publish::Yes, "{}", report.text());
    assert!(report.text().starts_with("Can this run be published? Yes: no check"), "{}", report.text());
    assert!(about(&report, "amount").1.contains("1,000 iterations succeeded; 5 iterations of warm-up"));
}

#[test]
fn replayed_latencies_are_a_caveat() {
    let input = TrustInput::from_rows(&rows(steady_totals(1005)), &[governor(Grade::Good)]);
    let distribution = "inference is drawn from a log-normal distribution, seed 3";
    let replayed = [("Replayed".to_owned(), distribution.to_owned())];
    let report = Report::new(&input.with_facts(&replayed));
    assert_eq!(report.verdict, Publish::WithRemarks);
    let (grade, text) = about(&report, "replayed");
    assert!(
        grade == Grade::Doubtful && text.contains("not measured") && text.contains(distribution),
        "{text}"
    );
}

#[test]
fn inference_slower_than_replayed_latencies_is_reported() {
    for (overrun, expected) in [(0.0, None), (0.0003, Some(Grade::Doubtful)), (0.002, Some(Grade::Bad))] {
        let mut rows = rows(steady_totals(1005));
        rows.change(|row| {
            let drawn = ("inference_drawn-latency".into(), 0.01);
            row.values.extend([drawn, ("inference_overrun".into(), overrun)]);
        });
        let input = TrustInput::from_rows(&rows, &[governor(Grade::Good)]);
        let replayed = [("Replayed".to_owned(), "inference is drawn from x".to_owned())];
        let report = Report::new(&input.clone().with_facts(&replayed));
        let found = report.findings.iter().find(|finding| finding.about == "overrun");
        assert_eq!(found.map(|finding| finding.grade), expected, "{found:?}");
        let (_, text) = about(&report, "replayed");
        let stated = "inference is drawn from x; inference took 2.00 ms longer than drawn on average";
        // The text states an overrun above 5 % of the drawn latency, which is 10 ms.
        assert_eq!(text.contains(stated), overrun > 0.0005, "{text}");
        let measured = Report::new(&input);
        assert!(
            measured.findings.iter().all(|finding| finding.about != "overrun"),
            "custom code may log a node `overrun`, too"
        );
    }
}

#[test]
fn drift_is_reported_with_size_and_stage() {
    for (rise, grade) in [(0.02, Grade::Good), (0.2, Grade::Doubtful), (0.6, Grade::Bad)] {
        let totals = steady_totals(1005)
            .into_iter()
            .enumerate()
            .map(|(at, total)| total * (1.0 + rise * at as f64 / 1005.0));
        let report = report_on(&rows(totals));
        let (found, text) = about(&report, "stationarity");
        assert_eq!(found, grade, "{rise}: {text}");
        assert_eq!(text.contains("`inference` changed most"), grade > Grade::Good, "{text}");
        assert!(text.contains("higher"), "{text}");
    }
    // A step down in the middle is a trend as well.
    let totals = steady_totals(1005)
        .into_iter()
        .enumerate()
        .map(|(at, total)| if at < 500 { total * 1.5 } else { total });
    let (verdict, text) = {
        let report = report_on(&rows(totals));
        (report.verdict, about(&report, "stationarity").1.to_owned())
    };
    assert!(verdict == Publish::No && text.contains("33\u{202f}% lower"), "{text}");
}

/// The latency varies slowly about its mean, as with other traffic on a link. The halves differ by chance, but the mean
/// does not drift.
#[test]
fn autocorrelation_is_not_reported_as_drift() {
    let mut noise = SplitMix64::new(11);
    let false_findings = (0..60)
        .filter(|_| {
            let mut level = 0.0;
            let totals: Vec<f64> = (0..1000)
                .map(|_| {
                    level = 0.98 * level + noise.normal();
                    0.010 * (1.0 + 0.02 * level)
                })
                .collect();
            about(&report_on(&rows(totals)), "stationarity").0 > Grade::Good
        })
        .count();
    // A test that ignores the correlation would report a trend in nearly all of these runs.
    assert!(false_findings <= 9, "more than 15 % of 60: {false_findings}");
}

#[test]
fn short_run_has_unknown_stationarity() {
    let report = report_on(&rows(steady_totals(45)));
    assert_eq!((report.verdict, about(&report, "amount").0), (Publish::WithRemarks, Grade::Doubtful));
    for subject in ["stationarity", "warm-up"] {
        assert_eq!(about(&report, subject).0, Grade::Unknown);
    }
    let without_iterations = Report::new(&TrustInput::default());
    assert_eq!(without_iterations.verdict, Publish::No, "{}", without_iterations.text());
}

/// The clock was set during the run, so a dashboard gets the iterations in two buckets of one
/// second each, which lie months apart.
#[test]
fn run_in_two_buckets_has_unknown_stationarity() {
    let totals = steady_totals(894);
    let bucket = |values: &[f64]| {
        let mut summary = peernet_statistics::Summary::default();
        values.iter().for_each(|value| summary.record(*value));
        summary
    };
    let total = TimeSeries::from_summaries(&[bucket(&totals[..400]), bucket(&totals[400..])]);
    let counts = Counts { ok: 894, ..Counts::default() };
    let report = Report::new(&TrustInput { total, counts, ..TrustInput::default() });
    for subject in ["stationarity", "warm-up"] {
        let (grade, text) = about(&report, subject);
        assert!(grade == Grade::Unknown && !text.contains("too short"), "{text}");
        assert!(
            text.contains("the run's 894 iterations lie in too few time buckets")
                && text.contains("clock was set"),
            "{text}"
        );
    }
}

#[test]
fn cold_beginning_is_distinguished_from_noise() {
    let cold = steady_totals(1005)
        .into_iter()
        .enumerate()
        .map(|(at, total)| if at < 30 { total * 1.6 } else { total });
    let report = report_on(&rows(cold));
    let (grade, text) = about(&report, "warm-up");
    assert!(grade == Grade::Doubtful && text.contains("The first 20 measured iterations"), "{text}");
    assert_eq!(about(&report_on(&rows(steady_totals(1005))), "warm-up").0, Grade::Good);
    // In this run, every third block is as slow as the first one.
    let with_slow_blocks = (0..1005).map(|at| if (at / 20) % 3 == 0 { 0.016 } else { 0.010 });
    let report = report_on(&rows(with_slow_blocks));
    let (grade, text) = about(&report, "warm-up");
    assert!(
        grade == Grade::Good && text.contains("later groups of 20 iterations, 1"),
        "the text has the number of later blocks that are as slow: {text}"
    );
    assert!(text.contains("not more than chance"), "{text}");
}

#[test]
fn outliers_are_graded_by_share_of_mean() {
    let with_outliers = |every: usize, slow: f64| {
        let totals = steady_totals(1005).into_iter().enumerate();
        report_on(&rows(totals.map(|(at, total)| if at % every == 50 { slow } else { total })))
    };
    let few = with_outliers(400, 0.050);
    let (grade, text) = about(&few, "outliers");
    assert!(grade == Grade::Good && text.contains("0.30\u{202f}%"), "{text}");
    let (grade, text) = {
        let many = with_outliers(60, 0.110);
        (about(&many, "outliers").0, about(&many, "outliers").1.to_owned())
    };
    assert!(
        grade == Grade::Doubtful && text.contains("the slowest took 110\u{202f}ms, 11.0 times"),
        "{text}"
    );
}

#[test]
fn failed_iterations_are_counted_and_graded() {
    for (every, grade) in [(1_500, Grade::Good), (200, Grade::Doubtful), (5, Grade::Bad)] {
        let mut rows = rows(steady_totals(3005));
        rows.change(|row| {
            if row.iteration % every == 100 % every && row.iteration > 5 {
                row.outcome = Outcome::Timeout;
            }
        });
        assert_eq!(about(&report_on(&rows), "losses").0, grade, "one in {every}");
    }
    let text_after = |outcomes: &[Outcome]| {
        let mut rows = rows(steady_totals(105));
        rows.change(|row| {
            let failure = row.iteration.checked_sub(10).and_then(|index| outcomes.get(index as usize));
            row.outcome = failure.copied().unwrap_or(row.outcome);
        });
        about(&report_on(&rows), "losses").1.to_owned()
    };
    assert_eq!(text_after(&[]), "No iteration failed.");
    // The text does not say that these iterations have no answer: if only the actuator failed, there is an answer.
    assert_eq!(
        text_after(&[Outcome::Failed, Outcome::Lost, Outcome::Timeout]),
        "3 of 100 iterations failed (3.0\u{202f}%): 1 with an error of sensor, model or actuator, 1 lost, 1 timed out."
    );
}

#[test]
fn unattributed_time_is_graded_by_share_and_length() {
    for (seconds, share, grade) in [
        (0.010, 0.04, Grade::Good),
        (0.010, 0.1, Grade::Doubtful),
        (0.010, 0.4, Grade::Bad),
        (0.000_2, 0.4, Grade::Good),
    ] {
        let mut rows = rows((0..200).map(|_| seconds));
        rows.change(|row| {
            row.values[INFERENCE].1 = seconds * (1.0 - share);
            row.values[UNATTRIBUTED].1 = seconds * share;
        });
        let report = report_on(&rows);
        assert_eq!(about(&report, "unattributed").0, grade, "{}", report.text());
    }
}

#[test]
fn iterations_that_waited_for_restart_are_listed() {
    let report_on = |column: &str, every: u64, seconds: f64| {
        let mut rows = rows(steady_totals(1005));
        rows.change(|row| {
            if row.iteration % every == 9 {
                row.values.push((column.to_owned().into(), seconds));
                row.values[TOTAL].1 += seconds;
            }
        });
        report_on(&rows)
    };
    let slow = report_on("restart", 2_000, 2.0);
    let text = "The model's process was restarted in 1 iteration (number 9). The waits for the restarts took 2,000\u{202f}ms in all, \
                17\u{202f}% of the time of all iterations.";
    assert_eq!(about(&slow, "restarts"), (Grade::Doubtful, text));
    let quick = report_on("capture_capture-restart", 100, 0.001);
    let (grade, text) = about(&quick, "restarts");
    assert!(
        grade == Grade::Good && text.contains("sensor's") && text.contains("109, 209, 309, 409, …)"),
        "{text}"
    );
    assert!(
        about(&report_on("actuation_actuation-restart", 900, 0.1), "restarts").1.contains("The actuator's")
    );
    let none = report_on("ipc", 2, 0.001);
    assert!(none.findings.iter().all(|finding| finding.about != "restarts"));
}

#[test]
fn lateness_is_separated_from_unattributed_time() {
    for (lateness, grade) in [(0.085, Grade::Good), (0.070, Grade::Doubtful), (0.020, Grade::Bad)] {
        let mut rows = rows((0..200).map(|_| 0.2));
        rows.change(|row| {
            row.values[INFERENCE].1 = 0.2 - 0.086;
            row.values[UNATTRIBUTED].1 = 0.086;
            row.values.push(("lateness".into(), lateness));
        });
        let report = report_on(&rows);
        assert_eq!(about(&report, "unattributed").0, grade, "{}", report.text());
        assert_eq!(about(&report, "late start").0, Grade::Good);
        if grade == Grade::Good {
            let text = "0.50\u{202f}% of the total belongs to no stage, late starts excluded (1.00\u{202f}ms on average).";
            assert_eq!(about(&report, "unattributed").1, text);
            let text = "Iterations began 85.0\u{202f}ms after their intended start on average: this late start is 43\u{202f}% of the total.";
            assert_eq!(about(&report, "late start").1, text);
        }
    }
    assert!(
        report_on(&rows(steady_totals(200))).findings.iter().all(|finding| finding.about != "late start")
    );
}

#[test]
fn model_restart_is_not_reported_as_unattributed_time() {
    let mut rows = rows(steady_totals(200));
    rows.change(|row| {
        if row.iteration == 21 {
            row.values[TOTAL].1 += 2.0;
            row.values[UNATTRIBUTED].1 += 2.0;
            row.values.push(("restart".into(), 2.0));
        }
    });
    let report = report_on(&rows);
    assert_eq!(about(&report, "restarts").0, Grade::Doubtful);
    let (grade, text) = about(&report, "unattributed");
    assert!(grade == Grade::Good && text.contains("restarts excluded"), "{text}");
}

/// Adds an upload with a delay of 6 ms to a row.
fn add_upload(row: &mut Row, verdict: Verdict) {
    let value = Span::from_millis(6);
    let half = Span::from_micros(650);
    let known = verdict != Verdict::Unsynchronised;
    let delay = OneWayDelay {
        raw: value,
        value: known.then_some(value),
        bounds: known.then(|| Interval { lo: value - half, hi: value + half }),
        source: DelaySource::InBand,
        verdict,
    };
    row.upload = Some(delay);
    let upload = known.then(|| ("upload".into(), value.seconds()));
    let sizes = [("upload-bytes".into(), 150_000.0), ("upload-logger-bytes".into(), 300.0)];
    row.values.extend(upload.into_iter().chain(sizes));
}

#[test]
fn delay_verdicts_are_graded_per_direction() {
    for (verdict, every, grade) in [
        (Verdict::Stale, 1, Grade::Doubtful),
        (Verdict::Limited, 1, Grade::Doubtful),
        (Verdict::Limited, 10, Grade::Doubtful),
        (Verdict::Limited, 25, Grade::Good),
        (Verdict::Stale, 25, Grade::Good),
        (Verdict::Stepped, 10, Grade::Doubtful),
        (Verdict::Unsynchronised, 1, Grade::Bad),
    ] {
        let mut rows = rows(steady_totals(300));
        rows.change(|row| add_upload(row, if row.iteration % every == 0 { verdict } else { Verdict::Ok }));
        let report = report_on(&rows);
        assert_eq!(about(&report, "clocks, upload").0, grade, "{}", report.text());
    }
    let mut rows = rows(steady_totals(300));
    rows.change(|row| add_upload(row, Verdict::Ok));
    let report = report_on(&rows);
    let text = "Of the delays of `upload`, ok 100\u{202f}%; the median of 6.00\u{202f}ms lies between 5.35 and 6.65\u{202f}ms.";
    assert_eq!(about(&report, "clocks, upload"), (Grade::Good, text));
}

#[test]
fn report_is_read_back_unchanged() {
    let report = report_on(&rows(steady_totals(205)));
    let json = serde_json::to_string(&report).expect("JSON");
    assert!(json.starts_with(r#"{"verdict":"yes","sentences":[{"about":"#), "{json}");
    assert_eq!(serde_json::from_str::<Report>(&json).expect("read back"), report);
}
