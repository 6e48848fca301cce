//! Estimates how fast storing catches up with measuring, from the storage lag in each live update.

use peernet_clock::{MonoTime, Span};

use crate::live_state::CatchingUp;

/// Time constant of the exponential weights, seconds.
const TIME_CONSTANT_S: f64 = 10.0;
/// Shortest observed time that supports a rate, seconds.
const MIN_OBSERVED_S: f64 = 2.0;
/// Time between updates after which the estimate is restarted. Updates arrive four times a second, so the rate before a
/// longer gap does not apply after it.
const MAX_UPDATE_GAP: Span = Span::from_seconds(5);
/// Smallest lag that counts as a backlog. A smaller lag is the time that a batch needs.
const MIN_BACKLOG: Span = Span::from_seconds(5);
/// Smallest rate at which the lag falls, in seconds per second, for an estimate.
const MIN_RATE: f64 = 0.02;

/// Exponentially weighted sums. They need constant memory and are unbiased from the first second on, because the sums
/// and the observed time decay alike.
#[derive(Debug, Default)]
pub(super) struct StorageLag {
    /// The previous update: its time, the lag, and the number of stored events.
    last: Option<(MonoTime, Span, u64)>,
    observed_s: f64,
    fallen_s: f64,
    stored: f64,
}

impl StorageLag {
    /// Adds an observation: the lag of storing, and the number of events stored until then.
    pub(super) fn observe(&mut self, behind: Option<Span>, stored: u64, now: MonoTime) {
        let Some(behind) = behind else {
            *self = Self::default();
            return;
        };
        if let Some((then, before, count)) = self.last {
            let elapsed = (now - then).seconds();
            // The count of a replaced spool starts at 0.
            if now - then > MAX_UPDATE_GAP || stored < count {
                *self = Self::default();
            } else {
                // Weight of the earlier sums.
                let kept = (-elapsed / TIME_CONSTANT_S).exp();
                self.observed_s = self.observed_s * kept + elapsed;
                self.fallen_s = self.fallen_s * kept + (before - behind).seconds();
                self.stored = self.stored * kept + (stored - count) as f64;
            }
        }
        self.last = Some((now, behind, stored));
    }

    /// Returns the estimate; `None` if the lag does not fall or is small.
    pub(super) fn estimate(&self) -> Option<CatchingUp> {
        let (_, behind, _) = self.last?;
        // Extrapolating from little data or a small lag would make the displayed time jump.
        if self.observed_s < MIN_OBSERVED_S || behind < MIN_BACKLOG {
            return None;
        }
        let rate = self.fallen_s / self.observed_s;
        (rate >= MIN_RATE).then(|| CatchingUp {
            rate,
            events_per_second: self.stored / self.observed_s,
            remaining: Span::from_seconds_f64(behind.seconds() / rate),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> MonoTime {
        MonoTime::from_nanos(7) + Span::from_seconds_f64(seconds)
    }

    /// Observes four updates a second from `from` to `to` seconds. `behind` gives the lag at a time.
    fn observe(lag: &mut StorageLag, from: i32, to: i32, behind: impl Fn(f64) -> f64) {
        for quarter in from * 4..to * 4 {
            let time = f64::from(quarter) / 4.0;
            let stored = (time * 20_000.0) as u64;
            lag.observe(Some(Span::from_seconds_f64(behind(time))), stored, at(time));
        }
    }

    #[test]
    fn falling_lag_yields_time_left() {
        let mut lag = StorageLag::default();
        observe(&mut lag, 0, 1, |time| 11_520.0 - 48.0 * time);
        assert_eq!(lag.estimate(), None, "one second supports no rate");
        observe(&mut lag, 1, 30, |time| 11_520.0 - 48.0 * time);
        let found = lag.estimate().expect("it falls");
        assert!((found.rate - 48.0).abs() < 1e-6, "{found:?}");
        assert!((found.events_per_second - 20_000.0).abs() < 1.0, "{found:?}");
        let left = (11_520.0 - 48.0 * 29.75) / 48.0;
        assert!((found.remaining.seconds() - left).abs() < 1e-3, "{found:?}");
    }

    #[test]
    fn growing_constant_or_small_lag_yields_no_rate() {
        for behind in [|time: f64| 100.0 + time, |_: f64| 100.0, |time: f64| (4.0 - time * 0.1).max(0.1)] {
            let mut lag = StorageLag::default();
            observe(&mut lag, 0, 30, behind);
            assert_eq!(lag.estimate(), None);
        }
    }

    #[test]
    fn estimate_follows_rate_and_smooths_steps() {
        let mut lag = StorageLag::default();
        observe(&mut lag, 0, 60, |time| 10_000.0 + time);
        observe(&mut lag, 60, 120, |time| 10_060.0 - 20.0 * (time - 60.0));
        let found = lag.estimate().expect("it falls");
        assert!((found.rate - 20.0).abs() < 0.3, "{found:?}");
        // Batches of four seconds each: the age of the oldest waiting event falls in steps.
        let mut lag = StorageLag::default();
        observe(&mut lag, 0, 60, |time| 10_000.0 - 40.0 * (time / 4.0).floor() * 4.0);
        let found = lag.estimate().expect("it falls");
        assert!((30.0..50.0).contains(&found.rate), "{found:?}");
    }

    #[test]
    fn estimate_restarts_after_silence_or_new_spool() {
        let mut lag = StorageLag::default();
        observe(&mut lag, 0, 30, |time| 10_000.0 - 20.0 * time);
        lag.observe(Some(Span::from_seconds(5_000)), 40_000_000, at(120.0));
        assert_eq!(lag.estimate(), None, "the silence is no catching up");
        observe(&mut lag, 121, 130, |time| 5_000.0 - 20.0 * (time - 121.0));
        assert_eq!(lag.estimate().map(|found| found.rate.round()), Some(20.0));
        lag.observe(Some(Span::from_seconds(4_000)), 3, at(130.0));
        assert_eq!(lag.estimate(), None, "a spool that was replaced begins to count anew");
        lag.observe(None, 4, at(131.0));
        assert_eq!(lag.estimate(), None, "nothing waits");
    }
}
