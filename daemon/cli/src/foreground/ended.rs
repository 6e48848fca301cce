//! How an agent in the foreground ended.

use std::convert::Infallible;

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
