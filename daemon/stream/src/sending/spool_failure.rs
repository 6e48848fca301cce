//! The current error of the spool.

use super::Notice;

/// A kind of work on the spool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SpoolWork {
    Append,
    Delete,
    Load,
    Renew,
}

/// The first failure after which work of the same kind has not succeeded yet; `None` if the spool works.
#[derive(Clone, Debug, Default)]
pub(super) struct SpoolFailure(Option<(SpoolWork, String)>);

impl SpoolFailure {
    /// Returns the error as text.
    pub(super) fn reason(&self) -> Option<String> {
        self.0.as_ref().map(|(_, reason)| reason.clone())
    }

    /// Records a failure. Returns a notice if no earlier failure persists.
    pub(super) fn fail(&mut self, work: SpoolWork, reason: String) -> Option<Notice> {
        self.0.is_none().then(|| {
            self.0 = Some((work, reason.clone()));
            Notice::SpoolFailed(reason)
        })
    }

    /// Records a success. Returns a notice if this success ends the recorded failure.
    pub(super) fn recover(&mut self, work: SpoolWork) -> Option<Notice> {
        self.0.take_if(|(failed, _)| *failed == work).map(|_| Notice::SpoolRecovered)
    }
}
