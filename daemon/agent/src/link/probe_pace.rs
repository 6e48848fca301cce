//! How often a link is probed.

use std::sync::Mutex;

use peernet_clock::{MonoTime, Span};
use tokio::sync::watch;

use super::shared::{ProbeSettings, lock};

/// Data this long ago does not keep the probes at their full rate.
const IN_USE: Span = Span::from_seconds(3);

/// The rate of a link's probes: they go out quickly while data does.
#[derive(Debug)]
pub(super) struct ProbePace {
    rate_hz: watch::Sender<f64>,
    /// When data last came back.
    used: Mutex<MonoTime>,
}

impl ProbePace {
    /// Data is about to be sent. There are no probes before the rate is [adjusted](Self::adjust).
    pub(super) fn new(now: MonoTime) -> Self {
        Self { rate_hz: watch::Sender::new(0.0), used: Mutex::new(now) }
    }

    /// Data came back.
    pub(super) fn note_data(&self, now: MonoTime) {
        *lock(&self.used) = now;
    }

    /// Sets the rate that holds now. Between two ends on one clock there is nothing to be estimated: the slow probes only show that the
    /// path is there and the clock really one.
    pub(super) fn adjust(&self, probes: &ProbeSettings, is_same_clock: bool, now: MonoTime) {
        let is_busy = now - *lock(&self.used) < IN_USE;
        let wanted = if is_busy && !is_same_clock { probes.rate_hz } else { probes.idle_rate_hz };
        self.rate_hz.send_if_modified(|rate| std::mem::replace(rate, wanted).total_cmp(&wanted).is_ne());
    }

    /// Probes per second now.
    pub(super) fn rate_hz(&self) -> f64 {
        *self.rate_hz.borrow()
    }

    /// Probes per second, now and from now on.
    pub(super) fn subscribe(&self) -> watch::Receiver<f64> {
        self.rate_hz.subscribe()
    }
}
