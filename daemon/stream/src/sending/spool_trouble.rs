//! Why the spool does not do its work.

use super::Notice;

/// A kind of work on the spool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SpoolWork {
    Append,
    Delete,
    Load,
    Renew,
}

/// The first failure that is not over.
#[derive(Clone, Debug, Default)]
pub(super) struct SpoolTrouble(Option<(SpoolWork, String)>);

impl SpoolTrouble {
    /// Why, in words.
    pub(super) fn reason(&self) -> Option<String> {
        self.0.as_ref().map(|(_, reason)| reason.clone())
    }

    /// Work failed: what the agent should know of it, if it is the first.
    pub(super) fn fail(&mut self, work: SpoolWork, reason: String) -> Option<Notice> {
        self.0.is_none().then(|| {
            self.0 = Some((work, reason.clone()));
            Notice::SpoolFailed(reason)
        })
    }

    /// Work succeeded: what the agent should know of it, if it had failed.
    pub(super) fn recover(&mut self, work: SpoolWork) -> Option<Notice> {
        self.0.take_if(|(failed, _)| *failed == work).map(|_| Notice::SpoolRecovered)
    }
}
