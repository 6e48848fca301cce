//! End of an agent in the foreground.

use std::convert::Infallible;

use peernet_stream::EndReason;

/// Reason for which the agent ended; `OwnReason` holds reasons that only one command has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ended<OwnReason = Infallible> {
    /// All was done, or nothing remains to do.
    Finished,
    /// The user ended it.
    Interrupted,
    /// The agent, or something that it needs, failed; the text is the reason.
    Failed(String),
    /// A reason for which the command has its own answer.
    OwnReason(OwnReason),
}

impl<OwnReason> Ended<OwnReason> {
    /// Converts the reason for which the agent's run ended; `what` is the word for the run in the command's messages.
    pub(crate) fn from_run_end(reason: EndReason, what: &str) -> Self {
        match reason {
            EndReason::Finished => Self::Finished,
            EndReason::Stopped => Self::Interrupted,
            EndReason::Failed(reason) => Self::Failed(format!("the {what} ended early: {reason}")),
            EndReason::Unknown => Self::Failed(format!("the {what} ended early")),
        }
    }
}
