//! Runs for tests: rows with reproducible noise, and the findings of a report on them.

use peernet_statistics::SplitMix64;
use peernet_stream::{Condition, Grade};

use super::Report;
use crate::rows::{Outcome, Row, Rows};

/// Returns a row with a total of `seconds`, of which 99 % are inference.
pub(crate) fn row(iteration: u64, seconds: f64) -> Row {
    let values = [("inference", seconds * 0.99), ("total", seconds), ("unattributed", seconds * 0.01)];
    Row {
        iteration,
        at: iteration as f64,
        episode: 0,
        step: 0,
        warm_up: iteration <= 5,
        outcome: Outcome::Ok,
        reason: None,
        values: values.map(|(name, value)| (name.into(), value)).to_vec(),
        upload: None,
        download: None,
    }
}

/// Returns rows with these totals, seconds.
pub(crate) fn rows(totals: impl IntoIterator<Item = f64>) -> Rows {
    (1..).zip(totals).map(|(iteration, seconds)| row(iteration, seconds)).collect()
}

/// Returns totals of about 10 ms, with a standard deviation of 1 % and without outliers.
pub(crate) fn steady_totals(count: usize) -> Vec<f64> {
    let mut noise = SplitMix64::new(7);
    (0..count).map(|_| 0.010 * (1.0 + 0.01 * noise.normal())).collect()
}

/// Returns a condition of this grade about the CPU governor of the host `robot`.
pub(crate) fn governor(grade: Grade) -> Condition {
    Condition {
        host: "robot".to_owned(),
        about: "CPU governor".to_owned(),
        found: "as it is".to_owned(),
        grade,
        advice: if grade > Grade::Unknown { "change it".to_owned() } else { String::new() },
    }
}

/// Returns the grade and the text of the finding about a subject.
pub(crate) fn about<'a>(report: &'a Report, subject: &str) -> (Grade, &'a str) {
    let mut found = report.findings.iter().filter(|finding| finding.about == subject);
    let finding = found.next().unwrap_or_else(|| panic!("no finding about {subject}: {report:#?}"));
    assert!(found.next().is_none(), "more than one finding about {subject}");
    (finding.grade, &finding.text)
}
