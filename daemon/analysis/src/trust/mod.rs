//! Answer to "can I publish this run?", with findings about the time before, during and after the run, in plain
//! sentences.
//!
//! ```text
//! rows (crate::rows) ──┐
//! roll-ups of a store ─┴─ TrustInput ── Report: a verdict, sentences ── text, JSON, page
//! ```
//!
//! The module does no I/O. The comments on each judgement and `docs/trust.md` have the thresholds and methods with
//! their sources.

mod ended_early;
mod judge;
mod load;
mod missing_count;
mod publication;
mod replayed;
mod restarts;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod time_series;
mod trend;
mod trust_input;

pub use ended_early::{EndedEarly, LimitUnit, Limits, Progress};
pub use judge::NOTABLE_SHARE;
pub(crate) use load::start_time;
pub use load::{Load, StartTimes, Starts, StartsSoFar};
pub use missing_count::MissingCount;
pub use publication::{publication_caveats, publication_summary};
pub use replayed::ReplayedLatencies;
pub(crate) use replayed::{DRAWN_LATENCY_COLUMN, OVERRUN_COLUMN};
pub use restarts::Restarts;
pub use time_series::{Beginning, Outliers, TimeSeries};
pub use trust_input::{DelayQuality, MissingEvents, TrustInput, names_of_distributions};

use std::cmp::Reverse;

use peernet_statistics::number::counted;
use peernet_stream::Grade;
use serde::{Deserialize, Serialize};

/// Judgement on whether the results of a run can be published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Publish {
    /// The results can be published as they are.
    Yes,
    /// The results can be published together with the texts of the doubtful findings.
    WithRemarks,
    /// The results cannot be published. A problem must be fixed and the run repeated.
    No,
}

impl Publish {
    /// Returns `yes`, `with-remarks` or `no`: the name in storage and in the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Yes => "yes",
            Self::WithRemarks => "with-remarks",
            Self::No => "no",
        }
    }
}

/// Result of one judgement, as text.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    /// Subject of the finding, in two or three words.
    pub about: String,
    /// Severity of the finding for publication.
    pub grade: Grade,
    /// Text of the finding: a plain sentence with numbers.
    pub text: String,
    /// Advice; empty if there is nothing to do.
    pub advice: String,
}

/// Answer to "can I publish this run?", with its reasons.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
    /// The answer.
    pub verdict: Publish,
    /// Findings, the most severe first. A finding about the end of the run comes before all others.
    #[serde(rename = "sentences")]
    pub findings: Vec<Finding>,
}

impl Report {
    /// Judges a run.
    pub fn new(input: &TrustInput) -> Self {
        let mut findings = judge::findings(input);
        // The sort is stable: findings of the same grade keep the order of the judgements.
        findings.sort_by_key(|finding| (finding.about != judge::END, Reverse(finding.grade)));
        let verdict = match findings.iter().map(|finding| finding.grade).max() {
            None | Some(Grade::Good | Grade::Unknown) => Publish::Yes,
            Some(Grade::Doubtful) => Publish::WithRemarks,
            Some(Grade::Bad) => Publish::No,
        };
        Self { verdict, findings }
    }

    /// Returns the answer as a sentence, with the number of doubtful or bad findings.
    pub fn answer(&self) -> String {
        let count = |grade| self.findings.iter().filter(|finding| finding.grade == grade).count() as u64;
        match self.verdict {
            Publish::Yes => "Yes: no check found a reason against it.".to_owned(),
            Publish::WithRemarks => {
                format!(
                    "Yes, with {} to publish beside the results.",
                    counted(count(Grade::Doubtful), "caveat")
                )
            }
            Publish::No => {
                format!("No: fix {} first, then repeat the run.", counted(count(Grade::Bad), "problem"))
            }
        }
    }

    /// Returns the text for a terminal: the answer, then a line for each finding. This line begins with a sign for the
    /// grade. If the finding has advice, the advice is on the next line.
    pub fn text(&self) -> String {
        let mut lines = vec![format!("Can this run be published? {}", self.answer()), String::new()];
        for finding in &self.findings {
            lines.push(format!("  {} {}", sign(finding.grade), finding.text));
            if !finding.advice.is_empty() {
                lines.push(format!("    → {}", finding.advice));
            }
        }
        lines.join("\n")
    }
}

/// Returns the sign that stands for a grade in a terminal.
const fn sign(grade: Grade) -> char {
    match grade {
        Grade::Good => '✓',
        Grade::Unknown => '?',
        Grade::Doubtful => '!',
        Grade::Bad => '✗',
    }
}
