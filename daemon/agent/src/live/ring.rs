//! The latest seconds of one pipeline.

use std::collections::VecDeque;

use peernet_logger::Tree;
use peernet_stream::{Outcome, Second};

use super::second_statistics::{SecondStatistics, has_episode_result};

/// Maximum number of seconds in the ring.
const MAX_SECONDS: usize = 64;
/// Maximum number of seconds in one update. After an outage the newest seconds are sent first.
const MAX_SENT_SECONDS: usize = 8;
/// Maximum number of seconds between the newest second and an earlier second in which an iteration ends. Iterations are
/// recorded when they end, so a larger number means that the wall clock was set back.
const MAX_BACKWARD_S: i64 = 1;

/// Statistics of the seconds in which an iteration ended, oldest first.
#[derive(Debug, Default)]
pub(super) struct Ring {
    seconds: VecDeque<SecondStatistics>,
    /// Number of changes of seconds so far.
    version: u64,
}

/// The seconds in an update with their versions, newest first: (start in Unix time, version). The seconds are marked as
/// sent with these versions once the update is sent.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct SecondVersions(Vec<(i64, u64)>);

impl SecondVersions {
    /// Keeps the newest `max_seconds` seconds.
    pub(super) fn truncate(&mut self, max_seconds: usize) {
        self.0.truncate(max_seconds);
    }
}

impl Ring {
    /// Adds an iteration that ended within the second `at` (Unix time).
    pub(super) fn record(&mut self, at: i64, outcome: &Outcome, warm_up: bool, tree: &Tree) {
        // A warm-up iteration is not in the statistics; only the result of an episode in its tree is.
        if warm_up && !has_episode_result(tree) {
            return;
        }
        // The version orders changes and updates: a second that changes while an update is sent is sent again.
        self.version += 1;
        let version = self.version;
        let second = self.second_at(at);
        second.version = version;
        second.record(outcome, warm_up, tree);
    }

    /// Returns the statistics of the second `at`, which are created if necessary.
    fn second_at(&mut self, at: i64) -> &mut SecondStatistics {
        if self.seconds.back().is_some_and(|newest| at < newest.at - MAX_BACKWARD_S) {
            // Seconds that occur again after the clock was set back replace the earlier seconds.
            self.seconds.retain(|second| second.at < at);
        }
        // The search starts at the end, because almost every iteration ends in the newest second.
        let index_at_or_before = self.seconds.iter().rposition(|second| second.at <= at);
        let index = match index_at_or_before {
            Some(index) if self.seconds[index].at == at => index,
            index_before => {
                let mut index = index_before.map_or(0, |index| index + 1);
                self.seconds.insert(index, SecondStatistics::new(at));
                // The new second itself stays, because the caller writes to it.
                if self.seconds.len() > MAX_SECONDS && index > 0 {
                    self.seconds.pop_front();
                    index -= 1;
                }
                index
            }
        };
        &mut self.seconds[index]
    }

    /// Returns the seconds that changed since they were last sent, newest first, and their versions.
    pub(super) fn changed_seconds(&self) -> (Vec<Second>, SecondVersions) {
        let changed_seconds = self
            .seconds
            .iter()
            .rev()
            .filter(|second| second.version > second.sent_version)
            .take(MAX_SENT_SECONDS);
        let (seconds, versions) =
            changed_seconds.map(|second| (second.to_message(), (second.at, second.version))).unzip();
        (seconds, SecondVersions(versions))
    }

    /// Marks the seconds of an update as sent.
    pub(super) fn mark_sent(&mut self, sent: &SecondVersions) {
        for (at, version) in &sent.0 {
            // A second that changed after the update was made has a larger version and is sent again.
            if let Some(second) = self.seconds.iter_mut().find(|second| second.at == *at) {
                second.sent_version = *version;
            }
        }
    }

    /// Marks all seconds as not sent.
    pub(super) fn mark_all_unsent(&mut self) {
        for second in &mut self.seconds {
            // Versions begin at 1.
            second.sent_version = 0;
        }
    }
}

#[cfg(test)]
mod tests;
