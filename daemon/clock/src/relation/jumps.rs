//! Detection of jumps of a clock that no local clock shows, as when a virtual machine is paused or migrated.
//!
//! A message that waits on the network moves the middle of an exchange's bounds by half of its waiting time, and
//! lengthens its round trip by all of it. A middle that moves further than half of the round trip's growth was not
//! moved by waiting: either the path changed, or a clock jumped. Exchanges cannot tell these two apart.
//!
//! When the edge's clock is set back, the exchanges in flight have one bound from before the jump and the other from
//! after it, and seem shorter than the path. Their round trips would hide the jump in later exchanges. Such an exchange
//! therefore counts only if an exchange that was sent later is as short, which shows that the path became shorter.

use std::collections::VecDeque;

use crate::band::DriftLimit;
use crate::{Exchange, RawTime, Span};

/// Length of the intervals of which the exchange with the shortest round trip is kept.
const INTERVAL_NANOS: i64 = 500_000_000;
/// Number of newest points that are kept at any age.
const MIN_POINTS: usize = 8;
/// Largest number of points.
const MAX_POINTS: usize = 20;
/// Smallest number of points from which the shortest round trip is reliable.
const MIN_POINTS_TO_SUSPECT: usize = 4;
/// Movement of a middle that is never suspected.
const MIN_TOLERANCE_NANOS: i64 = 100_000;
/// The tolerance is the shortest round trip divided by this number, if that is more than the minimum.
const ROUND_TRIP_TO_TOLERANCE: i64 = 50;

/// The exchange with the shortest round trip of each interval of the window.
#[derive(Clone, Debug, Default)]
pub(super) struct ShortestRoundTrips {
    points: VecDeque<RoundTripPoint>,
    /// Shortest round trip, and the spread of the next shortest round trips above it, in nanoseconds. The shortest may exceed the
    /// path's own round trip by the spread.
    shortest: i64,
    spread: i64,
    /// Time until which short exchanges are ignored, because an exchange seemed shorter than the path.
    // An exchange that is sent later was not in flight together with the short one.
    shortened_until: Option<RawTime>,
}

/// An exchange with a short round trip.
#[derive(Clone, Copy, Debug)]
struct RoundTripPoint {
    sent: RawTime,
    returned: RawTime,
    /// Middle of the bounds of the offset, nanoseconds.
    middle: i64,
    round_trip: i64,
    uncertainty: i64,
}

/// A jump that an exchange suggests.
#[derive(Clone, Copy, Debug)]
pub(super) struct SuspectedJump {
    /// Movement of the middle.
    pub(super) moved: Span,
    /// Times at which the last earlier exchange that would have shown the jump was sent and returned.
    pub(super) last_before: (RawTime, RawTime),
}

impl From<&Exchange> for RoundTripPoint {
    fn from(exchange: &Exchange) -> Self {
        Self {
            sent: exchange.sent,
            returned: exchange.returned,
            middle: exchange.bounds().middle().nanos(),
            round_trip: exchange.round_trip().nanos(),
            uncertainty: exchange.uncertainty.nanos(),
        }
    }
}

impl ShortestRoundTrips {
    /// Returns the jump that an exchange suggests. The exchange must not contradict the band.
    pub(super) fn suspected_jump(&self, exchange: &Exchange, drift: DriftLimit) -> Option<SuspectedJump> {
        let point = RoundTripPoint::from(exchange);
        let extra_round_trip = point.round_trip.saturating_sub(self.shortest).saturating_abs();
        let newest = self.points.back()?;
        // Cheap check first: usually the middle is where the newest one was.
        let tolerance = self.tolerance();
        let moved = |earlier: &RoundTripPoint| point.middle.saturating_sub(earlier.middle);
        if self.points.len() < MIN_POINTS_TO_SUSPECT
            || (extra_round_trip / 2).saturating_add(tolerance) > moved(newest).abs()
        {
            return None;
        }
        let exceeds_explanation = |earlier: &&RoundTripPoint| {
            let moved = moved(earlier).abs();
            let waited = extra_round_trip.saturating_add(earlier.round_trip - self.shortest) / 2;
            // The middle belongs to the bounds at two times, between which the offset drifts.
            let drifted = drift.max_change_between(
                earlier.sent.min(point.sent).nanos(),
                earlier.returned.max(point.returned).nanos(),
            );
            let explained = [waited, drifted, tolerance, self.spread, point.uncertainty, earlier.uncertainty];
            extra_round_trip <= moved / 4 && moved > explained.into_iter().fold(0, i64::saturating_add)
        };
        let moved = moved(self.points.iter().rev().find(exceeds_explanation)?);
        let would_show = |earlier: &&RoundTripPoint| earlier.round_trip - self.shortest <= moved.abs() / 4;
        let last = self.points.iter().rev().find(would_show)?;
        Some(SuspectedJump { moved: Span::from_nanos(moved), last_before: (last.sent, last.returned) })
    }

    /// Returns the movement of a middle in nanoseconds up to which no jump is suspected.
    fn tolerance(&self) -> i64 {
        MIN_TOLERANCE_NANOS.max(self.shortest / ROUND_TRIP_TO_TOLERANCE)
    }

    /// Returns whether an exchange may have been in flight during a jump: it seems shorter than the path, and no exchange
    /// that was sent after its return is as short. Updates the time until which short exchanges are ignored.
    fn check_for_spanned_jump(&mut self, point: &RoundTripPoint) -> bool {
        let shorter = self.shortest.saturating_sub(point.round_trip);
        let explained = self.tolerance().saturating_add(self.spread).saturating_add(point.uncertainty);
        let is_short = self.points.len() >= MIN_POINTS_TO_SUSPECT && shorter > explained;
        match self.shortened_until {
            Some(until) if until <= point.sent => {
                self.shortened_until = None;
                false
            }
            Some(_) => is_short,
            None => {
                // By the clock that stamped its departure, the exchange returned later by as much as it seems shorter.
                let delay = Span::from_nanos(shorter.saturating_add(explained));
                self.shortened_until = is_short.then(|| point.returned + delay);
                is_short
            }
        }
    }

    /// Inserts an exchange, and removes those more than `window` before it.
    pub(super) fn insert(&mut self, exchange: &Exchange, window: Span) {
        let point = RoundTripPoint::from(exchange);
        if self.check_for_spanned_jump(&point) {
            return;
        }
        let interval = |point: &RoundTripPoint| point.sent.nanos().div_euclid(INTERVAL_NANOS);
        match self.points.back_mut() {
            Some(last) if interval(last) == interval(&point) => {
                if point.round_trip < last.round_trip {
                    *last = point;
                    self.shortest = self.shortest.min(point.round_trip);
                }
            }
            // A late answer of an earlier interval adds nothing.
            Some(last) if interval(last) > interval(&point) => {}
            _ => {
                self.points.push_back(point);
                let start = point.sent - window;
                let has_expired_point = |points: &VecDeque<RoundTripPoint>| {
                    points.len() > MAX_POINTS
                        || (points.len() > MIN_POINTS
                            && points.front().is_some_and(|point| point.sent < start))
                };
                while has_expired_point(&self.points) {
                    self.points.pop_front();
                }
                self.update_shortest();
            }
        }
    }

    /// Removes all exchanges.
    pub(super) fn clear(&mut self) {
        self.points.clear();
        self.shortened_until = None;
    }

    /// Updates the shortest round trip and the spread.
    fn update_shortest(&mut self) {
        // The newest interval is incomplete, so that its shortest round trip is not final.
        let complete = self.points.len().saturating_sub(1).max(1);
        let mut trips = [i64::MAX; MAX_POINTS];
        for (trip, point) in trips.iter_mut().zip(self.points.iter().take(complete)) {
            *trip = point.round_trip;
        }
        let (_, other, _) = trips[..].select_nth_unstable(MIN_POINTS.min(complete) - 1);
        self.shortest = self.points.iter().map(|point| point.round_trip).min().unwrap_or(0);
        self.spread = *other - self.shortest;
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.points.capacity() * size_of::<RoundTripPoint>()
    }
}
