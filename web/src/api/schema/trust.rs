//! Whether a run can be published, and what was found of its hosts.

use peernet_report::trust;
use peernet_stream as stream;
use serde::Serialize;
use utoipa::ToSchema;

/// Something about a host that decides how far a measurement on it can be trusted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Condition {
    /// Name of the host.
    pub host: String,
    /// What was looked at: `CPU governor`, `competing load`.
    pub about: String,
    /// In words, with unit.
    pub found: String,
    /// `good`, `unknown`, `doubtful` or `bad`.
    pub grade: &'static str,
    /// What to do about it; may be empty.
    pub advice: String,
}

/// The answer to "can I publish this run?".
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Trust {
    /// `yes`, `with-remarks` or `no`.
    pub verdict: &'static str,
    /// The same in a sentence.
    pub answer: String,
    /// The most harmful first.
    pub sentences: Vec<Sentence>,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Sentence {
    pub about: String,
    /// `good`, `unknown`, `doubtful` or `bad`.
    pub grade: &'static str,
    pub text: String,
    /// What to do about it; may be empty.
    pub advice: String,
}

const fn word(grade: stream::Grade) -> &'static str {
    match grade {
        stream::Grade::Good => "good",
        stream::Grade::Unknown => "unknown",
        stream::Grade::Doubtful => "doubtful",
        stream::Grade::Bad => "bad",
    }
}

impl From<&stream::Condition> for Condition {
    fn from(condition: &stream::Condition) -> Self {
        let stream::Condition { host, about, found, grade, advice } = condition.clone();
        Self { host, about, found, grade: word(grade), advice }
    }
}

impl From<&trust::Report> for Trust {
    fn from(report: &trust::Report) -> Self {
        let sentence = |sentence: &trust::Sentence| Sentence {
            about: sentence.about.clone(),
            grade: word(sentence.grade),
            text: sentence.text.clone(),
            advice: sentence.advice.clone(),
        };
        Self {
            verdict: report.verdict.name(),
            answer: report.answer(),
            sentences: report.sentences.iter().map(sentence).collect(),
        }
    }
}
