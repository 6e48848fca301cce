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
    last_request: Option<(SignalKind, Instant)>,
}

impl ShutdownRequests {
    /// Records a signal that arrives at `now`. Returns whether it is a new request; otherwise it repeats the last
    /// request.
    pub fn record_signal(&mut self, kind: SignalKind, now: Instant) -> bool {
        let repeats = |(last_kind, last_at): (SignalKind, Instant)| {
            last_kind == kind && now - last_at < SAME_REQUEST_PERIOD
        };
        if self.last_request.is_some_and(repeats) {
            return false;
        }
        self.last_request = Some((kind, now));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_signals_within_half_second_are_one_request() {
        let (mut shutdown_requests, begin) = (ShutdownRequests::default(), Instant::now());
        let mut is_request =
            |kind, ms| shutdown_requests.record_signal(kind, begin + Duration::from_millis(ms));
        let (terminate, interrupt) = (SignalKind::terminate(), SignalKind::interrupt());
        assert!(is_request(terminate, 0));
        assert!(!is_request(terminate, 0) && !is_request(terminate, 499));
        assert!(is_request(terminate, 500), "an equal signal after half a second is a new request");
        assert!(is_request(interrupt, 501), "a signal of another kind is a new request");
    }
}
