//! Round trips of a connection's heartbeats.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

use crate::statistics::TransportRoundTrip;

/// Length of the periods for each of which the shortest round trip is stored.
// The reported minimum covers only the current and the previous period, because a path may change.
const PERIOD_OF_MINIMUM: Span = Span::from_seconds(150);

/// Maximum number of unanswered heartbeats that are stored. A further heartbeat replaces the oldest.
const MAX_UNANSWERED: usize = 64;

/// Smooths measured round trips (RFC 6298, section 2).
#[derive(Debug, Default)]
pub(crate) struct RoundTripEstimator {
    /// Smoothed round trip and its variation.
    smoothed: Option<(Span, Span)>,
    /// Shortest round trips of the current and the previous period.
    minima: (Option<Span>, Option<Span>),
    period_started_at: MonoTime,
    /// Departures of the unanswered heartbeats, oldest first.
    unanswered: VecDeque<MonoTime>,
}

impl RoundTripEstimator {
    /// Notes that a heartbeat is sent.
    pub(crate) fn record_ping(&mut self, now: MonoTime) {
        if self.unanswered.len() >= MAX_UNANSWERED {
            self.unanswered.pop_front();
        }
        self.unanswered.push_back(now);
    }

    /// Records the answer to the heartbeat that was sent at `sent_at`. Ignores an answer that belongs to no unanswered
    /// heartbeat, because such an answer was duplicated or altered on the way.
    pub(crate) fn record_pong(&mut self, sent_at: MonoTime, now: MonoTime) {
        if let Some(index) = self.unanswered.iter().position(|time| *time == sent_at) {
            self.unanswered.remove(index);
            self.measure(now - sent_at, now);
        }
    }

    fn measure(&mut self, round_trip: Span, now: MonoTime) {
        if now - self.period_started_at >= PERIOD_OF_MINIMUM {
            self.minima = (None, self.minima.0);
            self.period_started_at = now;
        }
        self.minima.0 = Some(self.minima.0.map_or(round_trip, |minimum| minimum.min(round_trip)));
        let nanos = round_trip.nanos();
        let (smoothed, variation) = match self.smoothed {
            None => (nanos, nanos / 2),
            Some((smoothed, variation)) => {
                let (smoothed, variation) = (smoothed.nanos(), variation.nanos());
                // The variation is computed from the old smoothed value, as RFC 6298 requires (section 2.3).
                let variation = variation + ((smoothed - nanos).abs() - variation) / 4;
                (smoothed + (nanos - smoothed) / 8, variation)
            }
        };
        self.smoothed = Some((Span::from_nanos(smoothed), Span::from_nanos(variation)));
    }

    /// Returns the estimate; `None` before the first answer.
    pub(crate) fn estimate(&self) -> Option<TransportRoundTrip> {
        let (smoothed, variation) = self.smoothed?;
        let (current, previous) = self.minima;
        Some(TransportRoundTrip { min: current.into_iter().chain(previous).min(), smoothed, variation })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_matching_heartbeat_replies_are_measured() {
        let time_at = |millis| MonoTime::default() + Span::from_millis(millis);
        let mut estimator = RoundTripEstimator::default();
        estimator.record_ping(time_at(10));
        estimator.record_pong(time_at(11), time_at(30));
        assert_eq!(estimator.estimate(), None);
        estimator.record_pong(time_at(10), time_at(30));
        let first = estimator.estimate().expect("the heartbeat was answered");
        assert_eq!(first.min, Some(Span::from_millis(20)));
        estimator.record_pong(time_at(10), time_at(40));
        assert_eq!(estimator.estimate(), Some(first), "an answer counts once");
    }

    #[test]
    fn estimate_smooths_and_forgets_old_minimum() {
        let time_at = |seconds| MonoTime::default() + Span::from_seconds(seconds);
        let (ms, mut estimator) = (Span::from_millis, RoundTripEstimator::default());
        assert_eq!(estimator.estimate(), None);
        estimator.measure(ms(8), time_at(0));
        let first = TransportRoundTrip { min: Some(ms(8)), smoothed: ms(8), variation: ms(4) };
        assert_eq!(estimator.estimate(), Some(first));
        estimator.measure(ms(16), time_at(1));
        let second = TransportRoundTrip { min: Some(ms(8)), smoothed: ms(9), variation: ms(5) };
        assert_eq!(estimator.estimate(), Some(second));
        estimator.measure(ms(16), time_at(200));
        assert_eq!(estimator.estimate().and_then(|estimate| estimate.min), Some(ms(8)));
        estimator.measure(ms(16), time_at(400));
        assert_eq!(estimator.estimate().and_then(|estimate| estimate.min), Some(ms(16)));
    }
}
