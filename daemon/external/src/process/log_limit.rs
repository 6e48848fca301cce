//! Limit of the log lines of one process.

use std::time::Duration;

use peernet_clock::{MonoTime, Span};

/// Length of the period to which the limits apply.
const PERIOD: Span = Span::from_millis(10_000);
/// Maximum number of lines in one period.
const MAX_LINES: u64 = 200;
/// Maximum number of bytes in one period.
const MAX_PERIOD_BYTES: u64 = 32 << 10;

/// Limit of the lines and bytes that one process writes to the log in each period. A program that prints in a loop
/// would otherwise fill the disk with its log, and hide the log lines of everything else.
#[derive(Debug, Default)]
pub(super) struct LogLimit {
    /// End of the current period; `None` before the first line.
    period_end: Option<MonoTime>,
    /// Lines that were logged in the current period.
    logged: LogVolume,
    /// Lines that were left out and are not reported yet.
    omitted: LogVolume,
}

/// Number of lines, and number of bytes of these lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct LogVolume {
    pub(super) lines: u64,
    pub(super) bytes: u64,
}

impl LogVolume {
    fn add(&mut self, line: &str) {
        self.lines += 1;
        self.bytes += line.len() as u64;
    }
}

impl LogLimit {
    /// Returns whether a line may be logged at `now`. Counts the line as logged or as left out.
    pub(super) fn admit(&mut self, line: &str, now: MonoTime) -> bool {
        if self.period_end.is_none_or(|end| end <= now) {
            self.period_end = Some(now + PERIOD);
            self.logged = LogVolume::default();
        }
        let is_admitted = self.logged.lines < MAX_LINES && self.logged.bytes < MAX_PERIOD_BYTES;
        let volume = if is_admitted { &mut self.logged } else { &mut self.omitted };
        volume.add(line);
        is_admitted
    }

    /// Returns the time until the end of the period, if lines were left out in it.
    pub(super) fn time_to_report(&self, now: MonoTime) -> Option<Duration> {
        let period_end = self.period_end.filter(|_| self.omitted.lines > 0)?;
        Some((period_end - now).to_duration())
    }

    /// Takes the number of left-out lines and of their bytes if the period has ended; `None` if no line was left out.
    pub(super) fn take_omitted_after_period(&mut self, now: MonoTime) -> Option<LogVolume> {
        self.period_end.is_some_and(|end| end <= now).then(|| self.take_omitted()).flatten()
    }

    /// Takes the number of left-out lines and of their bytes; `None` if no line was left out.
    pub(super) fn take_omitted(&mut self) -> Option<LogVolume> {
        let omitted = std::mem::take(&mut self.omitted);
        (omitted.lines > 0).then_some(omitted)
    }

    /// Returns the limits in words.
    pub(super) fn in_words() -> String {
        format!(
            "at most {MAX_LINES} lines and {} KiB are logged in {} s",
            MAX_PERIOD_BYTES >> 10,
            PERIOD.seconds()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: i64) -> MonoTime {
        MonoTime::from_nanos(0) + Span::from_seconds(seconds)
    }

    #[test]
    fn lines_beyond_the_limit_are_counted_and_reported_once() {
        let mut limit = LogLimit::default();
        let logged = (0..1_000).filter(|_| limit.admit("four", at(0))).count() as u64;
        assert_eq!(logged, MAX_LINES);
        assert_eq!(limit.take_omitted_after_period(at(9)), None);
        assert_eq!(limit.time_to_report(at(9)), Some(Duration::from_secs(1)));
        let omitted = LogVolume { lines: 1_000 - MAX_LINES, bytes: 4 * (1_000 - MAX_LINES) };
        assert_eq!(limit.take_omitted_after_period(at(10)), Some(omitted));
        assert_eq!(limit.take_omitted_after_period(at(10)), None);
        assert!(limit.admit("again", at(10)) && limit.time_to_report(at(10)).is_none());
    }

    #[test]
    fn long_lines_reach_the_limit_of_bytes() {
        let mut limit = LogLimit::default();
        let line = "x".repeat(4_096);
        assert_eq!((0..100).filter(|_| limit.admit(&line, at(0))).count(), 8);
        assert_eq!(limit.take_omitted(), Some(LogVolume { lines: 92, bytes: 92 * 4_096 }));
    }
}
