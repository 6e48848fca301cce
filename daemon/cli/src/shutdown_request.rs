//! Requests to end the program by signals. One request may arrive as two signals.

use std::time::Duration;

use tokio::signal::unix::SignalKind;
use tokio::time::Instant;

/// Signals of one kind within this time count as one request. For example, `timeout` signals a process and then its
/// process group, so that the process gets two signals.
const SAME_REQUEST_PERIOD: Duration = Duration::from_millis(500);

/// Detection of signals that repeat a request.
#[derive(Debug, Default)]
pub struct ShutdownRequests {
    last: Option<(SignalKind, Instant)>,
}

impl ShutdownRequests {
    /// Returns whether a signal that arrives at `now` is another request.
    pub fn is_another(&mut self, kind: SignalKind, now: Instant) -> bool {
        let repeats = |(last_kind, last_at): (SignalKind, Instant)| {
            last_kind == kind && now - last_at < SAME_REQUEST_PERIOD
        };
        if self.last.is_some_and(repeats) {
            return false;
        }
        self.last = Some((kind, now));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_signals_within_moment_are_one_request() {
        let (mut shutdown_requests, begin) = (ShutdownRequests::default(), Instant::now());
        let mut is_request = |kind, ms| shutdown_requests.is_another(kind, begin + Duration::from_millis(ms));
        let (terminate, interrupt) = (SignalKind::terminate(), SignalKind::interrupt());
        assert!(is_request(terminate, 0));
        assert!(!is_request(terminate, 0) && !is_request(terminate, 499));
        assert!(is_request(terminate, 500), "somebody insists");
        assert!(is_request(interrupt, 501), "another signal is another wish");
    }
}
