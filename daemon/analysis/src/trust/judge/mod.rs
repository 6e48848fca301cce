//! Judgements of a run: one file per subject. Each returns findings, independently of the others.

mod accuracy;
mod clocks;
mod conditions;
mod losses;
mod replayed;
mod restarts;
mod time_series;

use peernet_statistics::number::{counted, fixed, significant};
use peernet_stream::Grade;

use super::{Finding, TrustInput};

/// Subject of the finding about the end of a run.
pub(super) const END: &str = "end";

/// Returns all findings, in the order of the judgements.
pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    let mut all = Vec::new();
    all.extend(losses::findings(input));
    all.extend(time_series::findings(input));
    all.extend(restarts::findings(input));
    all.extend(replayed::findings(input));
    all.extend(clocks::findings(input));
    all.extend(accuracy::findings(input));
    all.extend(conditions::findings(&input.conditions));
    all
}

/// Returns a finding without advice.
fn finding(about: &str, grade: Grade, text: impl Into<String>) -> Finding {
    Finding { about: about.to_owned(), grade, text: text.into(), advice: String::new() }
}

fn with_advice(sentence: Finding, advice: impl Into<String>) -> Finding {
    Finding { advice: advice.into(), ..sentence }
}

/// Formats a share as per cent with two significant digits: `0.12 %`, `3.4 %`, `56 %`, `<0.01 %`.
fn percent(share: f64) -> String {
    let value = share * 100.0;
    let decimals = match value.abs() {
        v if v == 0.0 || v >= 9.95 => 0,
        v if v >= 0.995 => 1,
        v if v >= 0.005 => 2,
        _ => return "<0.01\u{202f}%".to_owned(),
    };
    format!("{}\u{202f}%", fixed(value, decimals))
}

/// Formats seconds as milliseconds with three significant digits: `16.1 ms`.
fn ms(seconds: f64) -> String {
    format!("{}\u{202f}ms", significant(seconds * 1e3))
}

/// Returns the number with its noun: `1 iteration`, `2 iterations`.
fn iterations(count: u64) -> String {
    counted(count, "iteration")
}
