//! "Can I publish this run?", as a page shows it.

use peernet_analysis::trust::{Finding, Publish, Report};
use peernet_stream::Grade;

use super::chip::{Chip, Tone};

/// The answer as a page shows it.
pub(crate) struct Trust {
    pub chip: Chip,
    pub answer: String,
    /// Findings that speak against publishing or must be mentioned, the most harmful first.
    pub remarks: Vec<Line>,
    /// Findings that are good or unknown.
    pub rest: Vec<Line>,
}

/// One sentence; names and commands are between backticks.
pub(crate) struct Line {
    pub chip: Chip,
    pub text: String,
    pub advice: String,
}

impl From<&Report> for Trust {
    fn from(report: &Report) -> Self {
        let (worse, rest) =
            report.findings.iter().partition::<Vec<_>, _>(|sentence| sentence.grade > Grade::Unknown);
        let lines = |sentences: Vec<&Finding>| {
            let line = |sentence: &Finding| Line {
                chip: chip(sentence.grade),
                text: sentence.text.clone(),
                advice: sentence.advice.clone(),
            };
            sentences.into_iter().map(line).collect()
        };
        Self {
            chip: match report.verdict {
                Publish::Yes => Chip::new(Tone::Ok, "ok", "yes"),
                Publish::WithRemarks => Chip::new(Tone::Warn, "remark", "with remarks"),
                Publish::No => Chip::new(Tone::Bad, "failed", "no"),
            },
            answer: report.answer(),
            remarks: lines(worse),
            rest: lines(rest),
        }
    }
}

/// Returns a grade by word and sign.
const fn chip(grade: Grade) -> Chip {
    match grade {
        Grade::Good => Chip::new(Tone::Ok, "ok", "good"),
        Grade::Unknown => Chip::new(Tone::Quiet, "unknown", "not known"),
        Grade::Doubtful => Chip::new(Tone::Warn, "remark", "doubtful"),
        Grade::Bad => Chip::new(Tone::Bad, "failed", "bad"),
    }
}
