//! The `[web.warn]` table of the configuration file: limits beyond which the overview warns.

use peernet_analysis::stage_split::NOTABLE_UNEXPLAINED_SHARE;
use peernet_analysis::trust::NOTABLE_SHARE;
use serde::{Deserialize, Serialize};

use super::ConfigProblem;

/// Limits beyond which the overview warns. An infinite limit disables its warning.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WarnConfig {
    /// p99 of a pipeline's `total` over the last minute, as a multiple of its median.
    pub p99_over_median: f64,
    /// Busy share of a host's cores in percent, exceeded for ten seconds.
    pub cpu_percent: f64,
    /// Unexplained time in percent of `total`, over the last minute. Stages, late starts, and restarts of a process of
    /// the model explain time. The default is the limit of the trust report.
    pub unattributed_percent: f64,
    /// Skipped starts in percent of the starts that were due in the last minute.
    pub skipped_percent: f64,
    /// Delay of late starts in percent of `total` over the last minute.
    pub late_percent: f64,
}

impl Default for WarnConfig {
    fn default() -> Self {
        Self {
            p99_over_median: 5.0,
            cpu_percent: 90.0,
            unattributed_percent: NOTABLE_UNEXPLAINED_SHARE * 100.0,
            skipped_percent: NOTABLE_SHARE * 100.0,
            late_percent: 10.0,
        }
    }
}

impl WarnConfig {
    /// Returns a problem for each limit that is negative or not a number.
    pub(crate) fn check(&self) -> Vec<ConfigProblem> {
        let Self { p99_over_median, cpu_percent, unattributed_percent, skipped_percent, late_percent } =
            *self;
        let limits = [
            ("warn.p99_over_median", p99_over_median),
            ("warn.cpu_percent", cpu_percent),
            ("warn.unattributed_percent", unattributed_percent),
            ("warn.skipped_percent", skipped_percent),
            ("warn.late_percent", late_percent),
        ];
        let invalid = limits.into_iter().filter(|(_, limit)| limit.is_nan() || *limit < 0.0);
        let new_problem = |(key, limit)| ConfigProblem {
            key,
            message: format!("{limit} is not a valid limit: write 0 or more, or inf for no warning"),
        };
        invalid.map(new_problem).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_or_nan_limit_is_rejected() {
        assert_eq!(WarnConfig::default().check(), []);
        let disabled = WarnConfig { cpu_percent: f64::INFINITY, ..WarnConfig::default() };
        assert_eq!(disabled.check(), []);
        let wrong = WarnConfig { late_percent: -1.0, cpu_percent: f64::NAN, ..WarnConfig::default() };
        let keys: Vec<_> = wrong.check().into_iter().map(|problem| problem.key).collect();
        assert_eq!(keys, ["warn.cpu_percent", "warn.late_percent"]);
    }
}
