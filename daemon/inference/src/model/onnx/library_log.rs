//! ONNX Runtime's messages in this program's log.

use std::sync::{Arc, Mutex, PoisonError};

use ort::logging::LogLevel;
use peernet_clock::{LogThrottle, MonoTime, SharedClock};

/// Part of the message about a run of a session that this program has terminated. Such a message is not an error.
const TERMINATED: &str = "Exiting due to terminate flag";

/// Writes the library's messages into this program's log. Each kind of message has at most one line per minute, because
/// every sample that a model refuses leads to a message.
pub(super) struct LibraryLog {
    clock: SharedClock,
    throttle: Mutex<LogThrottle>,
}

impl LibraryLog {
    pub(super) fn new(clock: &SharedClock) -> Self {
        Self { clock: Arc::clone(clock), throttle: Mutex::default() }
    }

    /// Logs a message. The level is `debug` if the message is neither a warning nor an error, if it is about a
    /// terminated run of a session, or if a line of the same kind was logged within the last minute.
    pub(super) fn log(&self, level: LogLevel, place: &str, message: &str) {
        let messages = self.messages_since_last_line(level, (place, message), self.clock.mono());
        let repeated = match messages {
            None | Some(0 | 1) => String::new(),
            Some(messages) => format!(" ({messages} such messages since the last line)"),
        };
        match (messages, level) {
            (None, _) => tracing::debug!(place, "onnxruntime: {message}"),
            (Some(_), LogLevel::Error | LogLevel::Fatal) => {
                tracing::error!(place, "onnxruntime: {message}{repeated}");
            }
            (Some(_), _) => tracing::warn!(place, "onnxruntime: {message}{repeated}"),
        }
    }

    /// Returns the number of messages of this kind since the last line; `None` if this message is logged at level
    /// `debug` only.
    fn messages_since_last_line(
        &self,
        level: LogLevel,
        (place, message): (&str, &str),
        now: MonoTime,
    ) -> Option<u64> {
        if matches!(level, LogLevel::Verbose | LogLevel::Info) || message.contains(TERMINATED) {
            return None;
        }
        let mut throttle = self.throttle.lock().unwrap_or_else(PoisonError::into_inner);
        // The second argument is the address of a peer. These messages have none.
        throttle.count_event(&kind(place, message), None, now)
    }
}

/// Returns the kind of a message: the place and the text without digits, up to `Status Message:`. The text after
/// `Status Message:` may contain values of the sample.
fn kind(place: &str, message: &str) -> String {
    let (text, _) = message.split_once("Status Message:").unwrap_or((message, ""));
    let is_no_digit = |character: &char| !character.is_ascii_digit();
    place.chars().chain([' ']).chain(text.chars().filter(is_no_digit)).collect()
}

#[cfg(test)]
mod tests {
    use peernet_clock::{ClockIdentity, Span, SystemClock};

    use super::*;

    const PLACE: &str = "sequential_executor.cc:677 ExecuteKernel";

    fn at(seconds: i64) -> MonoTime {
        MonoTime::from_nanos(0) + Span::from_seconds(seconds)
    }

    fn log() -> LibraryLog {
        let clock: SharedClock =
            Arc::new(SystemClock::new(ClockIdentity::new("test", ClockIdentity::SYSTEM)));
        LibraryLog::new(&clock)
    }

    #[test]
    fn refused_samples_make_one_line_per_minute() {
        let log = log();
        let refusal = |index: i64| {
            format!(
                "Non-zero status code returned while running Gather node. Name:'' Status Message: idx={index}"
            )
        };
        let logged =
            |index: i64, now| log.messages_since_last_line(LogLevel::Error, (PLACE, &refusal(index)), now);
        assert_eq!(logged(5_000, at(0)), Some(1));
        assert_eq!((1..516).filter_map(|index| logged(index, at(1))).count(), 0);
        assert_eq!(logged(7, at(60)), Some(516));
        let other = "Expected shape from model of {1,4} does not match actual shape of {2,4} for output y";
        assert_eq!(log.messages_since_last_line(LogLevel::Warning, (PLACE, other), at(61)), Some(1));
    }

    #[test]
    fn terminated_run_of_session_is_no_error() {
        let message = "Non-zero status code returned while running Loop node. Name:'' Status Message: Exiting due to terminate flag \
                       being set to true.";
        assert_eq!(log().messages_since_last_line(LogLevel::Error, (PLACE, message), at(0)), None);
        assert_eq!(log().messages_since_last_line(LogLevel::Info, (PLACE, "a remark"), at(0)), None);
    }
}
