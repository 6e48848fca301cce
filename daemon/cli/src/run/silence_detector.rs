//! Detection of processes that hang.

use std::collections::BTreeSet;
use std::time::Duration;

use tokio::time::Instant;

/// Time without a progress report after which a process that measures is called silent.
const SILENCE: Duration = Duration::from_secs(30);

/// Detector of processes that report no progress. A process reports its progress several times a second, also while it
/// waits.
pub(super) struct SilenceDetector {
    /// Time of the last report of each process; `None` if its silence was already shown.
    last_reports: Vec<Option<Instant>>,
    next_check: Instant,
}

impl SilenceDetector {
    pub(super) fn new(process_count: usize) -> Self {
        let now = Instant::now();
        Self { last_reports: vec![Some(now); process_count], next_check: now + SILENCE }
    }

    /// Records that a process has reported.
    pub(super) fn record_report(&mut self, index: usize) {
        self.last_reports[index] = Some(Instant::now());
    }

    /// Waits for the next check. Cancel safe.
    pub(super) async fn wait(&self) {
        tokio::time::sleep_until(self.next_check).await;
    }

    /// Returns the processes among `indexes` that have become silent since the last check, and sets
    /// the time of the next check. A process is returned again only after it has reported.
    pub(super) fn newly_silent(&mut self, now: Instant, indexes: &BTreeSet<usize>) -> Vec<usize> {
        self.next_check = now + SILENCE / 6;
        let is_silent = |last: Option<Instant>| last.is_some_and(|last| now >= last + SILENCE);
        let silent: Vec<usize> =
            indexes.iter().copied().filter(|index| is_silent(self.last_reports[*index])).collect();
        silent.iter().for_each(|index| self.last_reports[*index] = None);
        silent
    }

    /// Returns the message about a silent process.
    pub(super) fn message() -> String {
        format!(
            "the process of this run has reported no progress for {} s: the process is suspended, or this machine is overloaded; Ctrl-C ends the run",
            SILENCE.as_secs()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silent_process_is_returned_once_until_it_reports() {
        let mut detector = SilenceDetector::new(3);
        let start = Instant::now();
        let measuring = BTreeSet::from([0, 2]);
        assert_eq!(detector.newly_silent(start + SILENCE / 2, &measuring), [0; 0]);
        assert_eq!(
            detector.newly_silent(start + SILENCE * 2, &measuring),
            [0, 2],
            "process 1 does not measure"
        );
        assert_eq!(detector.newly_silent(start + SILENCE * 3, &measuring), [0; 0]);
        detector.record_report(2);
        assert_eq!(detector.newly_silent(start + SILENCE * 4, &measuring), [2]);
    }
}
