//! Log lines about failed iterations. No I/O.
//!
//! The first failure of each kind is logged at once, later failures in at most one summary per minute.

use peernet_clock::{MonoTime, Span};
use peernet_statistics::number::counted;
use peernet_stream::Outcome;

/// Shortest time between two log lines about one kind of failure.
// Without the limit, a pipeline that fails at a high rate would fill the log.
const MIN_INTERVAL: Span = Span::from_seconds(60);

/// The failures of a run, by kind.
#[derive(Debug, Default)]
pub(super) struct FailureLog {
    failed: UnloggedFailures,
    lost: UnloggedFailures,
    timed_out: UnloggedFailures,
}

/// Failures of one kind since the last log line about that kind.
#[derive(Debug, Default)]
struct UnloggedFailures {
    /// Time of the last log line; `None` before the first.
    logged_at: Option<MonoTime>,
    count: u64,
    /// Number of the iteration that failed last, and the reason.
    latest: Option<(u64, String)>,
}

impl FailureLog {
    /// Records the outcome of iteration `number`. Returns the log lines that are due.
    ///
    /// A summary may be due after a successful iteration as well. Otherwise the summary would wait for a further
    /// failure, which may never occur.
    pub(super) fn record(&mut self, number: u64, outcome: &Outcome, now: MonoTime) -> Vec<String> {
        match outcome {
            Outcome::Ok => {}
            Outcome::Failed(reason) => self.failed.add(number, reason),
            Outcome::Lost(reason) => self.lost.add(number, reason),
            Outcome::Timeout(reason) => self.timed_out.add(number, reason),
        }
        self.take_lines(|kind| kind.is_due(now), now)
    }

    /// Returns log lines about all failures that were not logged yet.
    pub(super) fn take_remaining(&mut self, now: MonoTime) -> Vec<String> {
        self.take_lines(|_| true, now)
    }

    /// Returns a log line for each kind with unlogged failures for which `is_due` is `true`.
    fn take_lines(&mut self, is_due: impl Fn(&UnloggedFailures) -> bool, now: MonoTime) -> Vec<String> {
        let kinds =
            [(&mut self.failed, "failed"), (&mut self.lost, "lost"), (&mut self.timed_out, "timed out")];
        let due_kinds = kinds.into_iter().filter(|(kind, _)| kind.count > 0 && is_due(kind));
        due_kinds.filter_map(|(kind, description)| kind.take_line(description, now)).collect()
    }
}

impl UnloggedFailures {
    fn add(&mut self, number: u64, reason: &str) {
        self.count += 1;
        self.latest = Some((number, reason.to_owned()));
    }

    fn is_due(&self, now: MonoTime) -> bool {
        self.logged_at.is_none_or(|logged_at| now - logged_at >= MIN_INTERVAL)
    }

    /// Returns a log line about the failures since the previous log line; `None` if there are no failures.
    fn take_line(&mut self, description: &str, now: MonoTime) -> Option<String> {
        let (number, reason) = self.latest.take()?;
        let count = std::mem::take(&mut self.count);
        let reason = if reason.is_empty() { reason } else { format!(": {reason}") };
        let previous_logged_at = self.logged_at.replace(now);
        Some(match previous_logged_at {
            None => format!("iteration {number}: {description}{reason}"),
            Some(previous_logged_at) => {
                let seconds = (now - previous_logged_at).seconds();
                let iterations = counted(count, "more iteration");
                format!(
                    "{iterations} {description} in {seconds:.0} s; the latest is iteration {number}{reason}"
                )
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NO_LINES: [String; 0] = [];

    fn at(seconds: i64) -> MonoTime {
        MonoTime::from_nanos(seconds * 1_000_000_000)
    }

    #[test]
    fn first_failure_of_each_kind_is_logged_at_once() {
        let mut log = FailureLog::default();
        let failed = Outcome::Failed("no such file".to_owned());
        assert_eq!(log.record(1, &Outcome::Ok, at(0)), NO_LINES);
        assert_eq!(log.record(2, &failed, at(1)), ["iteration 2: failed: no such file"]);
        assert_eq!(log.record(3, &failed, at(2)), NO_LINES);
        assert_eq!(
            log.record(4, &Outcome::Timeout("no answer".into()), at(3)),
            ["iteration 4: timed out: no answer"]
        );
        let lost = Outcome::Lost("the connection broke".to_owned());
        assert_eq!(log.record(5, &lost, at(4)), ["iteration 5: lost: the connection broke"]);
    }

    #[test]
    fn later_failures_are_summed_up_once_a_minute() {
        let mut log = FailureLog::default();
        let failed = |reason: &str| Outcome::Failed(reason.to_owned());
        log.record(1, &failed("first"), at(0));
        let lines: Vec<String> = (2..=600)
            .flat_map(|n| log.record(n, &failed(&format!("reason {n}")), at(n.cast_signed() / 10)))
            .collect();
        assert_eq!(lines, ["599 more iterations failed in 60 s; the latest is iteration 600: reason 600"]);
        assert_eq!(log.record(601, &failed("last"), at(61)), NO_LINES);
        assert_eq!(
            log.record(602, &Outcome::Ok, at(120)),
            ["1 more iteration failed in 60 s; the latest is iteration 601: last"]
        );
        assert_eq!(log.take_remaining(at(121)), NO_LINES);
    }

    #[test]
    fn end_of_run_logs_remaining_failures() {
        let mut log = FailureLog::default();
        log.record(1, &Outcome::Timeout(String::new()), at(0));
        log.record(2, &Outcome::Timeout(String::new()), at(5));
        let line = "1 more iteration timed out in 10 s; the latest is iteration 2";
        assert_eq!(log.take_remaining(at(10)), [line]);
    }
}
