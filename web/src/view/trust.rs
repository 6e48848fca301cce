//! "Can I publish this run?", as a page shows it.

use peernet_analysis::trust::{Finding, Publish, Report};
use peernet_stream::Grade;

use super::chip::{Chip, Tone};

/// The answer as a page shows it.
pub(crate) struct Trust {
    pub chip: Chip,
    pub answer: String,
    /// Findings that speak against publishing or must be mentioned, the most harmful first.
    pub remarks: Vec<FindingLine>,
    /// Findings that are good or unknown.
    pub other_findings: Vec<FindingLine>,
}

/// A finding in a sentence. Names and commands are between backticks.
pub(crate) struct FindingLine {
    pub chip: Chip,
    pub text: String,
    pub advice: String,
}

impl From<&Report> for Trust {
    fn from(report: &Report) -> Self {
        // Unknown findings do not speak against publishing, so they are listed with the good ones.
        let (remarks, other_findings) =
            report.findings.iter().partition::<Vec<_>, _>(|finding| finding.grade > Grade::Unknown);
        let lines = |findings: Vec<&Finding>| {
            let line = |finding: &Finding| FindingLine {
                chip: chip(finding.grade),
                text: finding.text.clone(),
                advice: finding.advice.clone(),
            };
            findings.into_iter().map(line).collect()
        };
        Self {
            chip: match report.verdict {
                Publish::Yes => Chip::new(Tone::Ok, "ok", "yes"),
                Publish::WithRemarks => Chip::new(Tone::Warn, "remark", "with caveats"),
                Publish::No => Chip::new(Tone::Bad, "failed", "no"),
            },
            answer: report.answer(),
            remarks: lines(remarks),
            other_findings: lines(other_findings),
        }
    }
}

/// Returns the chip of a grade.
pub(crate) const fn chip(grade: Grade) -> Chip {
    match grade {
        Grade::Good => Chip::new(Tone::Ok, "ok", "good"),
        Grade::Unknown => Chip::new(Tone::Quiet, "unknown", "not known"),
        Grade::Doubtful => Chip::new(Tone::Warn, "remark", "caveat"),
        Grade::Bad => Chip::new(Tone::Bad, "failed", "bad"),
    }
}
