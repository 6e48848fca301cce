//! Times at which probes are due.

use peernet_clock::{MonoTime, Span};

/// Largest relative deviation of an interval from the mean, in both directions.
// Without jitter, probes could synchronise with periodic load.
const JITTER: f64 = 0.2;

/// Maximum number of probes per second.
const MAX_HZ: f64 = 1000.0;

/// Span within which the first probe is sent at a random time.
const FIRST_PROBE_WINDOW: Span = Span::from_millis(100);

/// A schedule of jittered intervals with a constant mean. Missed probes are skipped, so that there are no bursts.
#[derive(Debug)]
pub(crate) struct Schedule {
    /// Mean interval; `None` if the schedule is paused.
    interval: Option<Span>,
    /// Time of the next probe.
    due: MonoTime,
}

impl Schedule {
    pub(crate) fn new(rate_hz: f64, now: MonoTime) -> Self {
        let mut schedule = Self { interval: None, due: now };
        schedule.set_rate(rate_hz, now);
        schedule
    }

    /// Sets the rate from now on. A rate that is not a positive number pauses the schedule.
    pub(crate) fn set_rate(&mut self, rate_hz: f64, now: MonoTime) {
        let previous_interval = self.interval;
        self.interval = (rate_hz > 0.0).then(|| Span::from_seconds_f64(1.0 / rate_hz.min(MAX_HZ)));
        let Some(interval) = self.interval else { return };
        let first = now + scale(interval.min(FIRST_PROBE_WINDOW), rand::random());
        self.due = match previous_interval {
            None => first,
            // The next probe is due after at most one new interval. A time that is already earlier is kept.
            Some(_) => self.due.min(now + with_jitter(interval)),
        };
    }

    /// Returns the time of the next probe; `None` if the schedule is paused.
    pub(crate) fn due(&self) -> Option<MonoTime> {
        self.interval.map(|_| self.due)
    }

    pub(crate) fn is_due(&self, now: MonoTime) -> bool {
        self.due().is_some_and(|due| due <= now)
    }

    /// Sets the time of the next probe. Called when a probe is due and is sent at `now`.
    pub(crate) fn advance(&mut self, now: MonoTime) {
        if let Some(interval) = self.interval {
            let interval = with_jitter(interval);
            let next = self.due + interval;
            // Probes that were missed meanwhile are skipped.
            self.due = if next > now { next } else { now + interval };
        }
    }
}

fn with_jitter(interval: Span) -> Span {
    scale(interval, rand::random_range(1.0 - JITTER..=1.0 + JITTER))
}

fn scale(span: Span, factor: f64) -> Span {
    Span::from_seconds_f64(span.seconds() * factor)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn intervals_vary_by_a_fifth_and_keep_the_rate() {
        let mut schedule = Schedule::new(10.0, at(0));
        let first = schedule.due().expect("not paused");
        assert!(first <= at(100), "the first probe is sent soon: {first:?}");
        let mut previous = first;
        let mut intervals = Vec::new();
        for _ in 0..2000 {
            // Each call comes slightly late, as timers do.
            schedule.advance(previous + Span::from_millis(1));
            let due = schedule.due().expect("not paused");
            intervals.push((due - previous).seconds());
            previous = due;
        }
        assert!(intervals.iter().all(|interval| (0.08..=0.12).contains(interval)));
        assert!(
            intervals.iter().any(|interval| *interval < 0.09)
                && intervals.iter().any(|interval| *interval > 0.11)
        );
        let mean = (previous - first).seconds() / intervals.len() as f64;
        assert!((0.098..0.102).contains(&mean), "{mean}");
    }

    #[test]
    fn missed_probes_are_skipped() {
        let mut schedule = Schedule::new(10.0, at(0));
        schedule.advance(at(5000));
        assert!(schedule.due().is_some_and(|due| due >= at(5080) && due <= at(5120)), "{schedule:?}");
    }

    #[test]
    fn new_rate_applies_at_once_and_zero_pauses() {
        let mut schedule = Schedule::new(0.01, at(0));
        schedule.advance(at(100));
        assert!(schedule.due().is_some_and(|due| due > at(70_000)));
        schedule.set_rate(10.0, at(1000));
        assert!(schedule.due().is_some_and(|due| due <= at(1120)), "{schedule:?}");
        for paused in [0.0, -1.0, f64::NAN] {
            schedule.set_rate(paused, at(2000));
            assert_eq!(schedule.due(), None);
            assert!(!schedule.is_due(at(1_000_000)));
        }
        schedule.set_rate(f64::INFINITY, at(3000));
        assert!(schedule.due().is_some_and(|due| due >= at(3000) && due <= at(3001)), "{schedule:?}");
    }
}
