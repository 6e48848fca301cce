//! Estimates how fast storing catches up with measuring, from the storage lag at each live update. The storage lag is
//! the age of the oldest event that is not stored yet.

use peernet_clock::{MonoTime, Span};

use crate::live_state::CatchingUp;

/// Time constant of the exponential weights, seconds.
const TIME_CONSTANT_S: f64 = 10.0;
/// Shortest observed time that supports a rate, seconds.
const MIN_OBSERVED_S: f64 = 2.0;
/// Silence after which the estimate is restarted. Updates arrive four times a second. The rate before a longer silence
/// does not apply after the silence.
const MAX_SILENCE: Span = Span::from_seconds(5);
/// Smallest lag that counts as a backlog. A smaller lag is normal, because a batch needs some time until
/// it is stored.
const MIN_BACKLOG: Span = Span::from_seconds(5);
/// Smallest decrease of the lag for which there is an estimate, seconds per second.
const MIN_RATE: f64 = 0.02;

/// Exponentially weighted sums, from which the rates are computed in constant memory. The rates are unbiased
/// from the first second on, because the sums and the observed time decay equally.
#[derive(Debug, Default)]
pub(super) struct LagEstimator {
    /// The previous update: its time, the lag, and the number of stored events.
    last_update: Option<(MonoTime, Span, u64)>,
    /// Observed time, seconds.
    observed_s: f64,
    /// Decrease of the lag, seconds.
    decrease_s: f64,
    /// Number of events that were stored.
    stored_events: f64,
}

impl LagEstimator {
    /// Adds an observation: the storage lag, and the number of events stored until then. The estimate restarts if no
    /// event waits (`None`).
    pub(super) fn observe(&mut self, lag: Option<Span>, stored: u64, now: MonoTime) {
        let Some(lag) = lag else {
            *self = Self::default();
            return;
        };
        if let Some((previous_time, previous_lag, previous_stored)) = self.last_update {
            let elapsed = (now - previous_time).seconds();
            // The count of a replaced spool starts at 0.
            if now - previous_time > MAX_SILENCE || stored < previous_stored {
                *self = Self::default();
            } else {
                // Weight of the earlier sums.
                let weight = (-elapsed / TIME_CONSTANT_S).exp();
                self.observed_s = self.observed_s * weight + elapsed;
                self.decrease_s = self.decrease_s * weight + (previous_lag - lag).seconds();
                self.stored_events = self.stored_events * weight + (stored - previous_stored) as f64;
            }
        }
        self.last_update = Some((now, lag, stored));
    }

    /// Returns the estimate; `None` if the lag does not fall or is small.
    pub(super) fn estimate(&self) -> Option<CatchingUp> {
        let (_, lag, _) = self.last_update?;
        // Extrapolating from little data or a small lag would make the displayed time jump.
        if self.observed_s < MIN_OBSERVED_S || lag < MIN_BACKLOG {
            return None;
        }
        let rate = self.decrease_s / self.observed_s;
        (rate >= MIN_RATE).then(|| CatchingUp {
            rate,
            events_per_second: self.stored_events / self.observed_s,
            remaining: Span::from_seconds_f64(lag.seconds() / rate),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> MonoTime {
        MonoTime::from_nanos(7) + Span::from_seconds_f64(seconds)
    }

    /// Observes four updates a second from `from` to `to` seconds. `lag_at` returns the lag at a time.
    fn observe(estimator: &mut LagEstimator, from: i32, to: i32, lag_at: impl Fn(f64) -> f64) {
        for quarter in from * 4..to * 4 {
            let time = f64::from(quarter) / 4.0;
            let stored = (time * 20_000.0) as u64;
            estimator.observe(Some(Span::from_seconds_f64(lag_at(time))), stored, at(time));
        }
    }

    #[test]
    fn falling_lag_yields_time_left() {
        let mut estimator = LagEstimator::default();
        observe(&mut estimator, 0, 1, |time| 11_520.0 - 48.0 * time);
        assert_eq!(estimator.estimate(), None, "one second supports no rate");
        observe(&mut estimator, 1, 30, |time| 11_520.0 - 48.0 * time);
        let estimate = estimator.estimate().expect("the lag falls");
        assert!((estimate.rate - 48.0).abs() < 1e-6, "{estimate:?}");
        assert!((estimate.events_per_second - 20_000.0).abs() < 1.0, "{estimate:?}");
        let remaining_s = (11_520.0 - 48.0 * 29.75) / 48.0;
        assert!((estimate.remaining.seconds() - remaining_s).abs() < 1e-3, "{estimate:?}");
    }

    #[test]
    fn growing_constant_or_small_lag_yields_no_rate() {
        for lag_at in [|time: f64| 100.0 + time, |_: f64| 100.0, |time: f64| (4.0 - time * 0.1).max(0.1)] {
            let mut estimator = LagEstimator::default();
            observe(&mut estimator, 0, 30, lag_at);
            assert_eq!(estimator.estimate(), None);
        }
    }

    #[test]
    fn estimate_follows_rate_and_smooths_steps() {
        let mut estimator = LagEstimator::default();
        observe(&mut estimator, 0, 60, |time| 10_000.0 + time);
        observe(&mut estimator, 60, 120, |time| 10_060.0 - 20.0 * (time - 60.0));
        let estimate = estimator.estimate().expect("the lag falls");
        assert!((estimate.rate - 20.0).abs() < 0.3, "{estimate:?}");
        // Batches of four seconds each: the age of the oldest waiting event falls in steps.
        let mut estimator = LagEstimator::default();
        observe(&mut estimator, 0, 60, |time| 10_000.0 - 40.0 * (time / 4.0).floor() * 4.0);
        let estimate = estimator.estimate().expect("the lag falls");
        assert!((30.0..50.0).contains(&estimate.rate), "{estimate:?}");
    }

    #[test]
    fn estimate_restarts_after_silence_or_new_spool() {
        let mut estimator = LagEstimator::default();
        observe(&mut estimator, 0, 30, |time| 10_000.0 - 20.0 * time);
        // This number of stored events is larger than that of the next update, so the next update restarts the
        // estimate again.
        estimator.observe(Some(Span::from_seconds(5_000)), 40_000_000, at(120.0));
        assert_eq!(estimator.estimate(), None, "a silence restarts the estimate");
        observe(&mut estimator, 121, 130, |time| 5_000.0 - 20.0 * (time - 121.0));
        assert_eq!(estimator.estimate().map(|estimate| estimate.rate.round()), Some(20.0));
        estimator.observe(Some(Span::from_seconds(4_000)), 3, at(130.0));
        assert_eq!(estimator.estimate(), None, "a replaced spool restarts the estimate");
        estimator.observe(None, 4, at(131.0));
        assert_eq!(estimator.estimate(), None, "no event waits");
    }
}
