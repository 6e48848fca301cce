//! Judgements of a run, one file for each subject. Each judgement returns findings and does not depend on other
//! judgements.

mod accuracy;
mod clocks;
mod conditions;
mod losses;
mod modes;
mod replayed;
mod restarts;
mod time_series;

pub use losses::NOTABLE_SHARE;
use peernet_statistics::number::{self, significant};
use peernet_stream::Grade;

use super::{Finding, TrustInput};

/// Subject of the finding about the end of a run.
pub(super) const END: &str = "end";

/// Returns all findings, in the order of the judgements.
pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    let mut findings = Vec::new();
    findings.extend(losses::findings(input));
    findings.extend(time_series::findings(input));
    findings.extend(modes::findings(input));
    findings.extend(restarts::findings(input));
    findings.extend(replayed::findings(input));
    findings.extend(clocks::findings(input));
    findings.extend(accuracy::findings(input));
    findings.extend(conditions::findings(&input.conditions));
    findings
}

/// Returns a finding without advice.
fn finding(about: &str, grade: Grade, text: impl Into<String>) -> Finding {
    Finding { about: about.to_owned(), grade, text: text.into(), advice: String::new() }
}

fn with_advice(finding: Finding, advice: impl Into<String>) -> Finding {
    Finding { advice: advice.into(), ..finding }
}

/// Formats a share in per cent, with the sign: `0.12 %`, `3.4 %`, `56 %`.
fn percent(share: f64) -> String {
    format!("{}\u{202f}%", number::percent(share))
}

/// Formats seconds as milliseconds with three significant digits: `16.1 ms`.
fn ms(seconds: f64) -> String {
    format!("{}\u{202f}ms", significant(seconds * 1e3))
}

/// Returns the number with its noun: `1 iteration`, `2 iterations`.
fn iterations(count: u64) -> String {
    number::counted(count, "iteration")
}
