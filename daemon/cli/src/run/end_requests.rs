//! Time limits for processes that are to end because the user pressed Ctrl-C. After the limit,
//! SIGKILL ends the processes. A suspended process reacts to no other signal.

use std::time::Duration;

use rustix::process::Signal;
use tokio::time::Instant;

use crate::foreground::long_duration;

/// Limit after the first request: work in progress is finished, and the results are written.
const FIRST_TIMEOUT: Duration = Duration::from_secs(60);
/// Limit after the second request: only the results are written.
const SECOND_TIMEOUT: Duration = Duration::from_secs(10);

/// The user's requests to end and their deadlines.
#[derive(Debug, Default)]
pub(super) struct EndRequests {
    requests: u32,
    deadline: Option<Instant>,
}

impl EndRequests {
    /// Handles a request. Returns the signal for the processes and a text for the user.
    pub(super) fn request(&mut self, now: Instant) -> (Signal, String) {
        self.requests += 1;
        // Sets the deadline, but never to a later time. Returns the time until the deadline as a text.
        let mut set_deadline = |time: Duration| {
            let deadline = self.deadline.map_or(now + time, |deadline| deadline.min(now + time));
            self.deadline = Some(deadline);
            long_duration((deadline - now).as_secs_f64())
        };
        // The signals differ, so that a process cannot take the second one for a repetition of the first.
        match self.requests {
            1 => (
                Signal::INT,
                format!(
                    "stopping; work in progress is killed after {}, press Ctrl-C again to shorten this time",
                    set_deadline(FIRST_TIMEOUT)
                ),
            ),
            2 => (
                Signal::TERM,
                format!(
                    "processes that do not end within {} are killed, press Ctrl-C again to kill them now",
                    set_deadline(SECOND_TIMEOUT)
                ),
            ),
            _ => (self.take_kill_signal(), "the processes were killed".to_owned()),
        }
    }

    /// Waits until the deadline; does not return if there is no deadline.
    pub(super) async fn wait_for_deadline(&self) {
        match self.deadline {
            Some(deadline) => tokio::time::sleep_until(deadline).await,
            None => std::future::pending().await,
        }
    }

    /// Returns SIGKILL, which ends even a suspended process, and removes the deadline.
    pub(super) const fn take_kill_signal(&mut self) -> Signal {
        self.deadline = None;
        Signal::KILL
    }

    /// Returns whether the user requested the end.
    pub(super) const fn is_requested(&self) -> bool {
        self.requests > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_request_never_extends_deadline() {
        let (mut end_requests, began) = (EndRequests::default(), Instant::now());
        let at = |seconds: u64| began + Duration::from_secs(seconds);
        assert!(!end_requests.is_requested());
        let (signal, message) = end_requests.request(at(0));
        assert!(signal == Signal::INT && message.contains("1 min"), "{message}");
        assert_eq!((end_requests.is_requested(), end_requests.deadline), (true, Some(at(60))));
        let (signal, message) = end_requests.request(at(53));
        assert!(
            signal == Signal::TERM && message.contains("within 7.0 s"),
            "the second deadline is not later than the first: {message}"
        );
        assert_eq!(end_requests.deadline, Some(at(60)));
        assert_eq!(end_requests.request(at(54)).0, Signal::KILL);
        assert_eq!(end_requests.deadline, None);
    }

    #[test]
    fn deadline_after_second_request_is_short() {
        let (mut end_requests, began) = (EndRequests::default(), Instant::now());
        end_requests.request(began);
        end_requests.request(began + Duration::from_secs(1));
        assert_eq!(end_requests.deadline, Some(began + Duration::from_secs(11)));
    }
}
