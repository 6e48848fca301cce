//! Round trips of a connection's heartbeats.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

use crate::statistics::TransportRoundTrip;

/// Length of a period. The minimum covers the last one to two periods, because paths change.
const MIN_PERIOD: Span = Span::from_seconds(150);

/// Largest number of heartbeats whose answers are awaited: those of a second at the highest rate.
const MAX_ASKED: usize = 64;

/// Smooths measured round trips (RFC 6298, section 2).
#[derive(Debug, Default)]
pub(crate) struct RoundTripEstimator {
    smoothed: Option<(Span, Span)>,
    /// Shortest round trips of the present and the previous period.
    shortest: (Option<Span>, Option<Span>),
    period_began: MonoTime,
    /// Departures of the unanswered heartbeats, oldest first.
    asked: VecDeque<MonoTime>,
}

impl RoundTripEstimator {
    /// Notes that a heartbeat is sent.
    pub(crate) fn ask(&mut self, now: MonoTime) {
        if self.asked.len() >= MAX_ASKED {
            self.asked.pop_front();
        }
        self.asked.push_back(now);
    }

    /// Handles an answer to the heartbeat that was sent at `asked`. An answer to no such heartbeat is not measured,
    /// because it was duplicated or altered on the way.
    pub(crate) fn answer(&mut self, asked: MonoTime, now: MonoTime) {
        if let Some(at) = self.asked.iter().position(|time| *time == asked) {
            self.asked.remove(at);
            self.measure(now - asked, now);
        }
    }

    fn measure(&mut self, trip: Span, now: MonoTime) {
        if now - self.period_began >= MIN_PERIOD {
            self.shortest = (None, self.shortest.0);
            self.period_began = now;
        }
        self.shortest.0 = Some(self.shortest.0.map_or(trip, |shortest| shortest.min(trip)));
        let nanos = trip.nanos();
        let (smoothed, variation) = match self.smoothed {
            None => (nanos, nanos / 2),
            Some((smoothed, variation)) => {
                let (smoothed, variation) = (smoothed.nanos(), variation.nanos());
                let variation = variation + ((smoothed - nanos).abs() - variation) / 4;
                (smoothed + (nanos - smoothed) / 8, variation)
            }
        };
        self.smoothed = Some((Span::from_nanos(smoothed), Span::from_nanos(variation)));
    }

    /// Returns the estimate; `None` before the first answer.
    pub(crate) fn estimate(&self) -> Option<TransportRoundTrip> {
        let (smoothed, variation) = self.smoothed?;
        let (this, before) = self.shortest;
        Some(TransportRoundTrip { min: this.into_iter().chain(before).min(), smoothed, variation })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_matching_heartbeat_replies_are_measured() {
        let at = |millis| MonoTime::default() + Span::from_millis(millis);
        let mut estimator = RoundTripEstimator::default();
        estimator.ask(at(10));
        estimator.answer(at(11), at(30));
        assert_eq!(estimator.estimate(), None);
        estimator.answer(at(10), at(30));
        let first = estimator.estimate().expect("it was answered");
        assert_eq!(first.min, Some(Span::from_millis(20)));
        estimator.answer(at(10), at(40));
        assert_eq!(estimator.estimate(), Some(first), "an answer counts once");
    }

    #[test]
    fn estimate_smooths_and_forgets_old_minimum() {
        let at = |seconds| MonoTime::default() + Span::from_seconds(seconds);
        let (ms, mut estimator) = (Span::from_millis, RoundTripEstimator::default());
        assert_eq!(estimator.estimate(), None);
        estimator.measure(ms(8), at(0));
        let first = TransportRoundTrip { min: Some(ms(8)), smoothed: ms(8), variation: ms(4) };
        assert_eq!(estimator.estimate(), Some(first));
        estimator.measure(ms(16), at(1));
        let second = TransportRoundTrip { min: Some(ms(8)), smoothed: ms(9), variation: ms(5) };
        assert_eq!(estimator.estimate(), Some(second));
        estimator.measure(ms(16), at(200));
        assert_eq!(estimator.estimate().and_then(|estimate| estimate.min), Some(ms(8)));
        estimator.measure(ms(16), at(400));
        assert_eq!(estimator.estimate().and_then(|estimate| estimate.min), Some(ms(16)));
    }
}
