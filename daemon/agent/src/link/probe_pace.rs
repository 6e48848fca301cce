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
    /// Time at which the last answer to data arrived.
    last_data: Mutex<MonoTime>,
}

impl ProbePace {
    /// Creates the pace of a new link. No probes are sent before the rate is [adjusted](Self::adjust).
    pub(super) fn new(now: MonoTime) -> Self {
        Self { rate_hz: watch::Sender::new(0.0), last_data: Mutex::new(now) }
    }

    /// Records that an answer to data arrived.
    pub(super) fn record_data(&self, now: MonoTime) {
        *lock(&self.last_data) = now;
    }

    /// Sets the rate: the full rate while the link carries data, otherwise the idle rate.
    // If both ends read one clock, no offset is estimated. Probes at the idle rate then only check that the path works
    // and that the clock is still the same.
    pub(super) fn adjust(&self, probes: &ProbeSettings, is_same_clock: bool, now: MonoTime) {
        let is_busy = now - *lock(&self.last_data) < IDLE_AFTER;
        let new_rate = if is_busy && !is_same_clock { probes.rate_hz } else { probes.idle_rate_hz };
        self.rate_hz.send_if_modified(|rate| std::mem::replace(rate, new_rate).total_cmp(&new_rate).is_ne());
    }

    /// Returns the current rate in probes per second.
    pub(super) fn rate_hz(&self) -> f64 {
        *self.rate_hz.borrow()
    }

    /// Returns a receiver of the rate in probes per second.
    pub(super) fn subscribe(&self) -> watch::Receiver<f64> {
        self.rate_hz.subscribe()
    }
}
