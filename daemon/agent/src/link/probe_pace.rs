//! The rate at which a link is probed.

use std::sync::Mutex;

use peernet_clock::{MonoTime, Span};
use tokio::sync::watch;

use super::shared::{ProbeSettings, lock};

/// Time since the last data after which the probes are no longer sent at their full rate.
const IDLE_AFTER: Span = Span::from_seconds(3);

/// The rate of a link's probes, which is high while the link carries data.
#[derive(Debug)]
pub(super) struct ProbePace {
    rate_hz: watch::Sender<f64>,
    /// Time at which data last came back.
    used: Mutex<MonoTime>,
}

impl ProbePace {
    /// Creates the pace of a link on which data is about to be sent. No probes are sent before the rate is
    /// [adjusted](Self::adjust).
    pub(super) fn new(now: MonoTime) -> Self {
        Self { rate_hz: watch::Sender::new(0.0), used: Mutex::new(now) }
    }

    /// Records that data came back.
    pub(super) fn note_data(&self, now: MonoTime) {
        *lock(&self.used) = now;
    }

    /// Sets the current rate. Between two ends on one clock there is nothing to estimate: probes at the idle rate
    /// only check that the path works and the clock is really shared.
    pub(super) fn adjust(&self, probes: &ProbeSettings, is_same_clock: bool, now: MonoTime) {
        let is_busy = now - *lock(&self.used) < IDLE_AFTER;
        let wanted = if is_busy && !is_same_clock { probes.rate_hz } else { probes.idle_rate_hz };
        self.rate_hz.send_if_modified(|rate| std::mem::replace(rate, wanted).total_cmp(&wanted).is_ne());
    }

    /// Returns the current probes per second.
    pub(super) fn rate_hz(&self) -> f64 {
        *self.rate_hz.borrow()
    }

    /// Returns a receiver of the probes per second.
    pub(super) fn subscribe(&self) -> watch::Receiver<f64> {
        self.rate_hz.subscribe()
    }
}
