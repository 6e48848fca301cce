//! The `[aggregator.retention]` table: how long stored data is kept.

use serde::{Deserialize, Serialize};

const DAY_S: i64 = 86_400;
/// Longest period: a hundred years.
const MAX_DAYS: u32 = 36_525;
/// Smallest size limit. A smaller database has no space for a run.
const MIN_SIZE_LIMIT_BYTES: u64 = 16 << 20;

/// The `[aggregator.retention]` table.
///
/// Data ages only while an aggregator runs and stores into the database. Wall clocks do not matter. Data of pinned runs
/// is never deleted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RetentionConfig {
    /// Time for which iterations with their trees of nodes are kept, days. Here and for the other times, 0 means no
    /// limit.
    pub nodes_days: u32,
    /// Time for which statistics per second are kept, days.
    pub seconds_days: u32,
    /// Time for which statistics per ten seconds are kept, days.
    pub ten_seconds_days: u32,
    /// Time for which statistics per minute are kept, days.
    pub minutes_days: u32,
    /// Time for which statistics per hour are kept, days. Statistics of whole runs are never deleted.
    pub hours_days: u32,
    /// Time for which samples of the relation between two hosts' clocks (one per second) are kept, days.
    pub clock_samples_days: u32,
    /// Bytes that the database may use; 0 for no limit. Above this limit, the oldest nodes are deleted at any age. When
    /// no nodes remain, the statistics per second, per ten seconds and per minute are deleted in this order.
    pub size_limit_bytes: u64,
}

impl Default for RetentionConfig {
    fn default() -> Self {
        Self {
            nodes_days: 7,
            seconds_days: 1,
            ten_seconds_days: 7,
            minutes_days: 90,
            hours_days: 0,
            clock_samples_days: 7,
            size_limit_bytes: 0,
        }
    }
}

impl RetentionConfig {
    /// Returns the key of each invalid setting with a description of the problem.
    pub fn problems(&self) -> Vec<(&'static str, String)> {
        let mut problems = Vec::new();
        let periods_of_statistics = [
            ("retention.seconds_days", self.seconds_days),
            ("retention.ten_seconds_days", self.ten_seconds_days),
            ("retention.minutes_days", self.minutes_days),
            ("retention.hours_days", self.hours_days),
        ];
        let other_periods = [
            ("retention.nodes_days", self.nodes_days),
            ("retention.clock_samples_days", self.clock_samples_days),
        ];
        for (key, days) in periods_of_statistics.into_iter().chain(other_periods) {
            if days > MAX_DAYS {
                problems.push((key, format!("{days} is outside 0 to {MAX_DAYS}; 0 means no limit")));
            }
        }
        for [(finer, finer_days), (coarser, coarser_days)] in periods_of_statistics.array_windows() {
            if period_s(*finer_days).unwrap_or(i64::MAX) > period_s(*coarser_days).unwrap_or(i64::MAX) {
                let finer = finer.trim_start_matches("retention.");
                let message = format!(
                    "must not be shorter than {finer}: pages over a long time are made from the coarser statistics"
                );
                problems.push((coarser, message));
            }
        }
        let limit = self.size_limit_bytes;
        if limit > 0 && limit < MIN_SIZE_LIMIT_BYTES {
            problems.push((
                "retention.size_limit_bytes",
                format!("{limit} is below {MIN_SIZE_LIMIT_BYTES}; 0 means no limit"),
            ));
        }
        problems
    }
}

/// Converts days to seconds; `None` for data that is kept without limit.
pub(crate) fn period_s(days: u32) -> Option<i64> {
    (days > 0).then(|| i64::from(days) * DAY_S)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problems(change: impl FnOnce(&mut RetentionConfig)) -> Vec<&'static str> {
        let mut config = RetentionConfig::default();
        change(&mut config);
        config.problems().into_iter().map(|(key, _)| key).collect()
    }

    #[test]
    fn invalid_setting_is_named_by_key() {
        assert!(problems(|_| {}).is_empty());
        assert!(problems(|config| (config.nodes_days, config.size_limit_bytes) = (0, 1 << 30)).is_empty());
        assert_eq!(problems(|config| config.nodes_days = 40_000), ["retention.nodes_days"]);
        assert_eq!(problems(|config| config.size_limit_bytes = 1), ["retention.size_limit_bytes"]);
        // Pages show the coarser statistics for times whose finer statistics are deleted.
        assert_eq!(problems(|config| config.seconds_days = 8), ["retention.ten_seconds_days"]);
        assert_eq!(problems(|config| config.minutes_days = 0), Vec::<&str>::new());
        assert_eq!(
            problems(|config| (config.minutes_days, config.hours_days) = (0, 90)),
            ["retention.hours_days"]
        );
    }

    #[test]
    fn unknown_keys_are_refused() {
        assert!(serde_json::from_str::<RetentionConfig>(r#"{"nodes_days": 3}"#).is_ok());
        assert!(serde_json::from_str::<RetentionConfig>(r#"{"node_days": 3}"#).is_err());
    }
}
