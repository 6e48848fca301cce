//! How an agent in the foreground ended.

use std::convert::Infallible;

use peernet_stream::EndReason;

/// How it ended; `Own` is what only one command can meet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ended<Own = Infallible> {
    /// All was done, or there is no more to do.
    Finished,
    /// The user ended it.
    Interrupted,
    /// The agent or what it needs could not go on; the text says why.
    Failed(String),
    /// What the command has another answer to.
    Own(Own),
}

impl<Own> Ended<Own> {
    /// Takes the reason why the agent's run ended; `what` is the word for the run in the command's messages.
    pub(crate) fn of_run(reason: EndReason, what: &str) -> Self {
        match reason {
            EndReason::Finished => Self::Finished,
            EndReason::Stopped => Self::Interrupted,
            EndReason::Failed(reason) => Self::Failed(format!("the {what} ended early: {reason}")),
            EndReason::Unknown => Self::Failed(format!("the {what} ended early")),
        }
    }
}
