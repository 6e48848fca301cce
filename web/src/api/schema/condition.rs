//! Conditions of the hosts of a run.

use peernet_stream as stream;
use serde::Serialize;
use utoipa::ToSchema;

/// Result of a check of a host before a run, which affects whether the run can be trusted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Condition {
    /// Name of the host.
    pub host: String,
    /// Subject of the check: `CPU governor`, `competing load`.
    pub about: String,
    /// Description of the observed state, with unit.
    pub found: String,
    /// `good`, `unknown`, `doubtful` or `bad`.
    pub grade: &'static str,
    /// Advice on what to do; may be empty.
    pub advice: String,
}

/// Returns the name of a grade in the API.
pub(crate) const fn grade_name(grade: stream::Grade) -> &'static str {
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
        Self { host, about, found, grade: grade_name(grade), advice }
    }
}
