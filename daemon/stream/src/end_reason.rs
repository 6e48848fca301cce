//! Reason why a run ended.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Reason why a run ended. Messages, stored rows, `run.json` and the API contain its text.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum EndReason {
    /// The reason is unknown; the text is empty, as in results of other programs.
    #[default]
    Unknown,
    /// The run reached its limit, or its sensor has no more samples; the text is `finished`.
    Finished,
    /// The agent was stopped; the text is `stopped`.
    Stopped,
    /// The run was aborted; the text is the error.
    Failed(String),
}

const FINISHED: &str = "finished";
const STOPPED: &str = "stopped";

impl EndReason {
    /// Returns the text of the reason for messages, storage and display.
    pub fn as_str(&self) -> &str {
        match self {
            Self::Unknown => "",
            Self::Finished => FINISHED,
            Self::Stopped => STOPPED,
            Self::Failed(reason) => reason,
        }
    }

    /// Returns the error if the run was aborted.
    pub fn failure(&self) -> Option<&str> {
        match self {
            Self::Failed(reason) => Some(reason),
            Self::Unknown | Self::Finished | Self::Stopped => None,
        }
    }
}

impl From<&str> for EndReason {
    fn from(text: &str) -> Self {
        text.to_owned().into()
    }
}

impl From<String> for EndReason {
    fn from(text: String) -> Self {
        match text.as_str() {
            "" => Self::Unknown,
            FINISHED => Self::Finished,
            STOPPED => Self::Stopped,
            _ => Self::Failed(text),
        }
    }
}

impl From<EndReason> for String {
    fn from(reason: EndReason) -> Self {
        match reason {
            EndReason::Failed(reason) => reason,
            other => other.as_str().to_owned(),
        }
    }
}

impl fmt::Display for EndReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_reason_is_written_as_its_text_and_read_back() {
        let reasons = [
            EndReason::Unknown,
            EndReason::Finished,
            EndReason::Stopped,
            EndReason::Failed("no camera".into()),
        ];
        for reason in reasons {
            let bytes = rmp_serde::to_vec(&reason).expect("a reason can be serialised");
            assert_eq!(bytes, rmp_serde::to_vec(reason.as_str()).expect("a text can be serialised"));
            assert_eq!(rmp_serde::from_slice::<EndReason>(&bytes).expect("the text of a reason"), reason);
        }
    }

    #[test]
    fn only_aborted_run_has_failure() {
        let failures = ["", "finished", "stopped", "no camera"].map(EndReason::from);
        assert_eq!(failures.each_ref().map(EndReason::failure), [None, None, None, Some("no camera")]);
    }
}
