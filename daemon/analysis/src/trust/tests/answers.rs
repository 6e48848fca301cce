//! Tests of the findings about superseded answers and about lengths of answers with two modes.

use super::*;
use crate::actuator_results::SUPERSEDED;

#[test]
fn superseded_answers_are_counted_and_graded() {
    for (every, grade) in [(2_000, Grade::Good), (100, Grade::Doubtful), (5, Grade::Bad)] {
        let mut rows = rows(steady_totals(4_005));
        rows.change(|row| {
            if row.iteration % every == 0 {
                row.values.push((SUPERSEDED.into(), 1.0));
            }
        });
        let report = report_on(&rows);
        let (found, text) = about(&report, "superseded");
        assert_eq!(found, grade, "one in {every}: {text}");
        let count = (6..=4_005).filter(|iteration| iteration % every == 0).count();
        assert!(text.starts_with(&format!("{count} of 4,000 answers")), "{text}");
    }
    assert!(
        report_on(&rows(steady_totals(200))).findings.iter().all(|finding| finding.about != "superseded")
    );
}

#[test]
fn two_modes_of_answers_are_a_caveat() {
    let mut noise = SplitMix64::new(11);
    let mut rows = rows(steady_totals(1_005));
    let mut add_answer_length = |row: &mut Row| {
        let middle = if row.iteration.is_multiple_of(4) { 400.0 } else { 30.0 };
        let length = (middle * (0.2 * noise.normal()).exp()).round();
        row.values.push(("inference_completion-tokens".into(), length));
    };
    rows.change(&mut add_answer_length);
    let report = report_on(&rows);
    let (grade, text) = about(&report, "two modes");
    assert!(
        grade == Grade::Doubtful && text.contains("`completion-tokens` have two modes: 75\u{202f}%"),
        "{text}"
    );
    assert_eq!(report.verdict, Publish::WithRemarks, "{}", report.text());
    let one_mode = report_on(&super::testing::rows(steady_totals(1_005)));
    assert!(one_mode.findings.iter().all(|finding| finding.about != "two modes"));
}
