//! The table `[clock]`.

use std::time::Duration;

use peernet_clock::{RelationSettings, Span};
use serde::{Deserialize, Serialize};

/// `[clock]`: assumptions about the clocks, on which the intervals of one-way delays depend.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClockConfig {
    /// Largest drift between this host's clock and a peer's, parts per million, above 0 and at most 1000. The
    /// intervals of delays hold while the real drift is smaller. Default: 200.
    pub max_drift_ppm: f64,
    /// Fastest change of this drift, parts per million per second, above 0 and at most 1000. Where both clocks run
    /// freely, the intervals of delays hold while the real change is slower. Default: 1.
    pub max_drift_change_ppm_per_s: f64,
    /// Longest time between an exchange with a peer and a delay that the exchange bounds. The newest eight exchanges
    /// are an exception: they bound a delay at any distance in time. Seconds, 10 to 86400. Default: 10.
    pub window_s: f64,
    /// Longest time between the delay of a message and the nearest exchange that does not include this message. A delay
    /// without such an exchange is `stale`. Seconds, 0.1 to 3600, at most `window_s`. Default: 10.
    pub fresh_s: f64,
    /// `true` if the claims of both hosts' time daemons narrow the intervals of delays. Default: `false`.
    pub trust_time_daemons: bool,
    /// Source of the time stamps of probes. Default: `kernel`.
    pub timestamps: Timestamps,
    /// Sources of claims about this host's wall clock. Default: `["kernel", "chrony"]`.
    pub discipline: Vec<ClaimSource>,
    /// Interval at which the claims are read; seconds, 0.1 to 3600. Default: 5.
    pub discipline_interval_s: f64,
    /// Command that queries chrony. Default: `chronyc`.
    pub chronyc: String,
    /// Arguments of the command before `-c tracking`, such as `["-h", "127.0.0.1", "-p", "1323"]`. Default: none.
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
            discipline: vec![ClaimSource::Kernel, ClaimSource::Chrony],
            discipline_interval_s: 5.0,
            chronyc: "chronyc".to_owned(),
            chronyc_arguments: Vec::new(),
        }
    }
}

impl ClockConfig {
    /// Returns the settings of the clock relations.
    pub fn relation_settings(&self) -> RelationSettings {
        RelationSettings {
            max_drift_ppm: self.max_drift_ppm,
            max_drift_change_ppm_per_s: self.max_drift_change_ppm_per_s,
            window: Span::from_seconds_f64(self.window_s),
            // `window` is the shortest possible retention. It suffices, because an agent judges only the delays of
            // recent messages.
            retention: Span::from_seconds_f64(self.window_s),
            max_fresh_age: Span::from_seconds_f64(self.fresh_s),
            trust_time_daemons: self.trust_time_daemons,
            ..RelationSettings::default()
        }
    }

    /// Returns the interval at which claims about the wall clock are read.
    pub fn discipline_interval(&self) -> Duration {
        Span::from_seconds_f64(self.discipline_interval_s).to_duration()
    }
}

/// Source of the time stamps of probes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Timestamps {
    /// The kernel, if it supports time stamps of packets.
    #[default]
    Kernel,
    /// The program, which reads its own clock; needed where a process runs under libfaketime, which does not change the
    /// kernel's stamps.
    User,
}

/// Source of claims about this host's wall clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ClaimSource {
    /// The kernel's own error bound, which ntpd, chrony and PTP daemons maintain.
    Kernel,
    /// chrony, queried by `chronyc`.
    Chrony,
}
