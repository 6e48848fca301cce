//! Reasons why a pipeline has no connection to its peer. No I/O.

use std::time::Duration;

use peernet_stream::IncidentKind;

use crate::reconnect_backoff::ReconnectBackoff;

/// Reason why a pipeline has no connection to its peer or to the server of its model. The text says what is wrong and
/// what to do.
#[derive(Debug)]
pub(super) enum PeerProblem {
    /// The peer cannot be reached or does not answer.
    Unreachable(String),
    /// The peer refused, or a request or an answer is invalid. An early retry would fail again, so the pause before the
    /// retry is longer.
    Refused(String),
}

impl PeerProblem {
    pub(super) const fn kind(&self) -> IncidentKind {
        match self {
            Self::Unreachable(_) => IncidentKind::Disconnected,
            Self::Refused(_) => IncidentKind::Refused,
        }
    }

    pub(super) fn text(&self) -> &str {
        let (Self::Unreachable(text) | Self::Refused(text)) = self;
        text
    }

    /// Returns a text with the problem and the interval of the retries.
    pub(super) fn describe(&self) -> String {
        let (shortest, longest) =
            (ReconnectBackoff::MIN_PAUSE.as_secs_f64(), ReconnectBackoff::MAX_PAUSE.as_secs());
        match self {
            Self::Unreachable(text) => format!("{text} (retrying every {shortest} to {longest} s)"),
            Self::Refused(text) => {
                format!("{text} (retrying every {} s)", ReconnectBackoff::PAUSE_AFTER_REFUSAL.as_secs())
            }
        }
    }

    /// Returns the pause before the next attempt.
    pub(super) fn pause(&self, reconnect_backoff: &mut ReconnectBackoff) -> Duration {
        match self {
            Self::Unreachable(_) => reconnect_backoff.next_pause(),
            Self::Refused(_) => reconnect_backoff.refusal_pause(),
        }
    }

    /// Returns whether the report of `reported` also covers this problem. A problem is reported when it first occurs and
    /// not at every attempt.
    pub(super) fn is_covered_by(&self, reported: Option<&Self>) -> bool {
        match (self, reported) {
            // Attempts to reach one peer fail in various ways, such as a refused connection and a timeout.
            (Self::Unreachable(_), Some(Self::Unreachable(_))) => true,
            (Self::Refused(text), Some(Self::Refused(reported_text))) => text == reported_text,
            _ => false,
        }
    }
}
