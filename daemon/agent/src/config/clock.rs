//! `[clock]`

use std::time::Duration;

use peernet_clock::{RelationSettings, Span};
use serde::{Deserialize, Serialize};

/// `[clock]`: what one-way delays rest on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClockConfig {
    /// The fastest that this host's clock and a peer's may drift apart, parts per million, above 0 and at most 1000. All
    /// bounds of delays hold as long as this does. Default: 200.
    pub max_drift_ppm: f64,
    /// The fastest that this drift may change, parts per million per second, above 0 and at most 1000. Where both clocks run
    /// freely, all bounds of delays hold as long as this does, too. Default: 1.
    pub max_drift_change_ppm_per_s: f64,
    /// No exchange with a peer bounds delays for longer, but for the newest eight; seconds, 10 to 86400. Default: 10.
    pub window_s: f64,
    /// A delay with no other exchange so near in time is `stale`; seconds, 0.1 to 3600, at most `window_s`.
    /// Default: 10.
    pub fresh_s: f64,
    /// Whether the claims of both hosts' time daemons narrow the intervals of delays. Default: `false`.
    pub trust_time_daemons: bool,
    /// Who stamps probes. Default: `kernel`.
    pub timestamps: Timestamps,
    /// Whose claims about this host's wall clock are read. Default: `["kernel", "chrony"]`.
    pub discipline: Vec<DisciplineSource>,
    /// How often they are read; seconds, 0.1 to 3600. Default: 5.
    pub discipline_interval_s: f64,
    /// The command that asks chrony. Default: `chronyc`.
    pub chronyc: String,
    /// Its arguments before `-c tracking`, such as `["-h", "127.0.0.1", "-p", "1323"]`. Default: none.
    pub chronyc_arguments: Vec<String>,
}

impl Default for ClockConfig {
    fn default() -> Self {
        Self {
            max_drift_ppm: 200.0,
            max_drift_change_ppm_per_s: 1.0,
            window_s: 10.0,
            fresh_s: 10.0,
            trust_time_daemons: false,
            timestamps: Timestamps::default(),
            discipline: vec![DisciplineSource::Kernel, DisciplineSource::Chrony],
            discipline_interval_s: 5.0,
            chronyc: "chronyc".to_owned(),
            chronyc_arguments: Vec::new(),
        }
    }
}

impl ClockConfig {
    /// What the estimates of offsets rest on.
    pub fn relation(&self) -> RelationSettings {
        RelationSettings {
            max_drift_ppm: self.max_drift_ppm,
            max_drift_change_ppm_per_s: self.max_drift_change_ppm_per_s,
            window: Span::from_seconds_f64(self.window_s),
            retention: Span::from_seconds_f64(self.window_s),
            fresh: Span::from_seconds_f64(self.fresh_s),
            trust_time_daemons: self.trust_time_daemons,
            ..RelationSettings::default()
        }
    }

    /// How often claims about the wall clock are read.
    pub fn discipline_interval(&self) -> Duration {
        Span::from_seconds_f64(self.discipline_interval_s).to_duration()
    }
}

/// Who stamps probes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Timestamps {
    /// The kernel, where it can.
    #[default]
    Kernel,
    /// The program alone, so that a whole process can be put under libfaketime, which does not reach the
    /// kernel's stamps.
    User,
}

/// Whose claims about this host's wall clock are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DisciplineSource {
    /// The kernel's own error bound, which ntpd, chrony and PTP daemons keep up to date.
    Kernel,
    /// chrony, asked by `chronyc`.
    Chrony,
}
