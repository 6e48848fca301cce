//! One file per thing that is looked at. Each gives sentences; none knows of the others.

mod accuracy;
mod clocks;
mod conditions;
mod course;
mod losses;
mod restarts;

use peernet_statistics::number::{counted, fixed, significant};
use peernet_stream::Grade;

use super::{Evidence, Sentence};

/// What the sentence is about that says of a run that it broke off.
pub(super) const END: &str = "end";

/// All sentences, in the order in which they are looked at.
pub(super) fn sentences(evidence: &Evidence) -> Vec<Sentence> {
    let mut all = Vec::new();
    all.extend(losses::sentences(evidence));
    all.extend(course::sentences(evidence));
    all.extend(restarts::sentences(evidence));
    all.extend(clocks::sentences(evidence));
    all.extend(accuracy::sentences(evidence));
    all.extend(conditions::sentences(&evidence.conditions));
    all
}

/// A sentence without advice.
fn say(about: &str, grade: Grade, text: impl Into<String>) -> Sentence {
    Sentence { about: about.to_owned(), grade, text: text.into(), advice: String::new() }
}

fn advise(sentence: Sentence, advice: impl Into<String>) -> Sentence {
    Sentence { advice: advice.into(), ..sentence }
}

/// A share as per cent with two significant digits: `0.12 %`, `3.4 %`, `56 %`, `<0.01 %`.
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

/// Seconds as milliseconds with three significant digits: `16.1 ms`.
fn ms(seconds: f64) -> String {
    format!("{}\u{202f}ms", significant(seconds * 1e3))
}

/// `1 iteration`, `2 iterations`.
fn iterations(count: u64) -> String {
    counted(count, "iteration")
}
