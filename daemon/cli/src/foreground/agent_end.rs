//! End of an agent in the foreground.

use std::convert::Infallible;

use peernet_stream::EndReason;

/// Reason why the agent ended. `OwnReason` is the type of the reasons that only one command has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum AgentEnd<OwnReason = Infallible> {
    /// Nothing remains to be done.
    Finished,
    /// The user ended the agent.
    Interrupted,
    /// The agent, or something that it needs, failed; the text is the reason.
    Failed(String),
    /// A reason that only this command has.
    OwnReason(OwnReason),
}

impl<OwnReason> AgentEnd<OwnReason> {
    /// Converts the reason why the agent's run ended. `noun` is the word for the run in the command's messages.
    pub(crate) fn from_run_end(reason: EndReason, noun: &str) -> Self {
        match reason {
            EndReason::Finished => Self::Finished,
            EndReason::Stopped => Self::Interrupted,
            EndReason::Failed(reason) => Self::Failed(format!("the {noun} ended early: {reason}")),
            EndReason::Unknown => Self::Failed(format!("the {noun} ended early")),
        }
    }
}
