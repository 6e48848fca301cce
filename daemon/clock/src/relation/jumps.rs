//! Detection of jumps of a clock that no other clock of its host shows, as when a virtual machine is paused or
//! migrated.
//!
//! If a message of an exchange waits on the network, the middle of the exchange's bounds moves by half of the waiting
//! time, and the round trip grows by all of the waiting time. If a middle moves further than half of the round trip's
//! growth, waiting does not explain the movement: either the path changed, or a clock jumped. Exchanges cannot tell
//! these two cases apart.
//!
//! When the edge's clock is set back, the exchanges in flight have one bound from before the jump and the other from
//! after it, so that they seem shorter than the path. Compared with these short round trips, later exchanges would seem
//! to have waited, and waiting would explain the jump. An exchange that seems shorter than the path therefore counts
//! only if an exchange that was sent later is as short, which shows that the path itself became shorter.

use std::collections::VecDeque;

use crate::band::DriftLimit;
use crate::{Exchange, RawTime, Span};

/// Length of an interval. In each interval, only the exchange with the shortest round trip is kept.
const INTERVAL_NANOS: i64 = 500_000_000;
/// Number of newest points that are kept at any age.
const MIN_POINTS: usize = 8;
/// Maximum number of points.
const MAX_POINTS: usize = 20;
/// Minimum number of points for the shortest round trip to be reliable.
const MIN_POINTS_TO_SUSPECT: usize = 4;
/// Smallest tolerance. If a middle moves by less than the tolerance, no jump is suspected.
const MIN_TOLERANCE_NANOS: i64 = 100_000;
/// The tolerance is the shortest round trip divided by this number, but at least [`MIN_TOLERANCE_NANOS`].
const ROUND_TRIP_TO_TOLERANCE: i64 = 50;

/// The exchange with the shortest round trip of each interval of time within the window.
#[derive(Clone, Debug, Default)]
pub(super) struct ShortestRoundTrips {
    points: VecDeque<RoundTripPoint>,
    /// Shortest round trip in nanoseconds.
    shortest_round_trip: i64,
    /// The [`MIN_POINTS`]-th shortest round trip minus the shortest round trip, in nanoseconds. The shortest round trip may
    /// exceed the round trip of the path itself by this much.
    spread: i64,
    /// Time until which short exchanges are ignored, because an exchange seemed shorter than the path.
    // An exchange that is sent after this time was not in flight together with the short exchange.
    ignore_short_until: Option<RawTime>,
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
    /// Movement of the middle of the bounds: the size of the jump.
    pub(super) movement: Span,
    /// Times at which an exchange was sent and returned: the last exchange before the jump with a round trip that is
    /// short enough to show the jump.
    pub(super) last_exchange_before: (RawTime, RawTime),
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
        // If this round trip is shorter than all earlier ones, the earlier exchanges waited. The difference then
        // explains a movement, too.
        let round_trip_difference =
            point.round_trip.saturating_sub(self.shortest_round_trip).saturating_abs();
        let newest = self.points.back()?;
        // A cheap check comes first: usually the middle is close to the middle of the newest point. If the newest point
        // waited, it may be from after a jump and not have shown it, so the newest point with a short round trip must be
        // close, too.
        let tolerance = self.tolerance();
        let movement_from = |earlier: &RoundTripPoint| point.middle.saturating_sub(earlier.middle);
        let max_movement = (round_trip_difference / 2).saturating_add(tolerance);
        let is_close = |earlier: &RoundTripPoint| max_movement > movement_from(earlier).abs();
        let max_round_trip = self.shortest_round_trip.saturating_add(tolerance).saturating_add(self.spread);
        let has_short_round_trip = |earlier: &&RoundTripPoint| earlier.round_trip <= max_round_trip;
        if self.points.len() < MIN_POINTS_TO_SUSPECT
            || (is_close(newest) && self.points.iter().rev().find(has_short_round_trip).is_none_or(is_close))
        {
            return None;
        }
        let shows_jump = |earlier: &&RoundTripPoint| {
            let movement = movement_from(earlier).abs();
            let by_waiting =
                round_trip_difference.saturating_add(earlier.round_trip - self.shortest_round_trip) / 2;
            // The two bounds of an exchange hold at different times: when it was sent, and when it returned. The offset
            // may drift between all of these times.
            let by_drift = drift.max_change_between(
                earlier.sent.min(point.sent).nanos(),
                earlier.returned.max(point.returned).nanos(),
            );
            let explanations =
                [by_waiting, by_drift, tolerance, self.spread, point.uncertainty, earlier.uncertainty];
            // Only a round trip near the shortest one shows a jump. Otherwise waiting explains much of the movement.
            round_trip_difference <= movement / 4
                && movement > explanations.into_iter().fold(0, i64::saturating_add)
        };
        let movement = movement_from(self.points.iter().rev().find(shows_jump)?);
        // If the jump was before an exchange with a short round trip, this exchange would have shown the jump. The jump
        // is therefore after the last such exchange.
        let would_show_jump =
            |earlier: &&RoundTripPoint| earlier.round_trip - self.shortest_round_trip <= movement.abs() / 4;
        let last = self.points.iter().rev().find(would_show_jump)?;
        Some(SuspectedJump {
            movement: Span::from_nanos(movement),
            last_exchange_before: (last.sent, last.returned),
        })
    }

    /// Returns the movement of a middle in nanoseconds up to which no jump is suspected.
    fn tolerance(&self) -> i64 {
        MIN_TOLERANCE_NANOS.max(self.shortest_round_trip / ROUND_TRIP_TO_TOLERANCE)
    }

    /// Returns whether an exchange may have been in flight during a jump: it seems shorter than the path, and it was
    /// not sent after the return of an exchange that also seemed shorter. Updates the time until which short exchanges
    /// are ignored.
    fn check_for_spanned_jump(&mut self, point: &RoundTripPoint) -> bool {
        let deficit = self.shortest_round_trip.saturating_sub(point.round_trip);
        let max_explained_deficit =
            self.tolerance().saturating_add(self.spread).saturating_add(point.uncertainty);
        let is_short = self.points.len() >= MIN_POINTS_TO_SUSPECT && deficit > max_explained_deficit;
        match self.ignore_short_until {
            Some(until) if until <= point.sent => {
                self.ignore_short_until = None;
                false
            }
            Some(_) => is_short,
            None => {
                // If the exchange spans a jump, the clock was set back before the return, by at most the missing time.
                // Other exchanges in flight may have been sent before the jump. Their stamps may therefore be later
                // than the return, by at most the missing time.
                let missing_time = Span::from_nanos(deficit.saturating_add(max_explained_deficit));
                self.ignore_short_until = is_short.then(|| point.returned + missing_time);
                is_short
            }
        }
    }

    /// Inserts an exchange, and removes the exchanges that were sent more than `window_length` before it.
    pub(super) fn insert(&mut self, exchange: &Exchange, window_length: Span) {
        let point = RoundTripPoint::from(exchange);
        if self.check_for_spanned_jump(&point) {
            return;
        }
        let interval = |point: &RoundTripPoint| point.sent.nanos().div_euclid(INTERVAL_NANOS);
        match self.points.back_mut() {
            Some(last) if interval(last) == interval(&point) => {
                if point.round_trip < last.round_trip {
                    *last = point;
                    self.update_shortest();
                }
            }
            // The exchange belongs to an earlier interval, because its answer was late. It is ignored.
            Some(last) if interval(last) > interval(&point) => {}
            _ => {
                self.points.push_back(point);
                let start = point.sent - window_length;
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
        self.ignore_short_until = None;
    }

    /// Updates the shortest round trip and the spread.
    fn update_shortest(&mut self) {
        // The newest interval is incomplete, so its shortest round trip is not final.
        let complete_intervals = self.points.len().saturating_sub(1).max(1);
        let mut round_trips = [i64::MAX; MAX_POINTS];
        for (round_trip, point) in round_trips.iter_mut().zip(self.points.iter().take(complete_intervals)) {
            *round_trip = point.round_trip;
        }
        let (_, nth_shortest, _) =
            round_trips[..].select_nth_unstable(MIN_POINTS.min(complete_intervals) - 1);
        self.shortest_round_trip = self.points.iter().map(|point| point.round_trip).min().unwrap_or(0);
        self.spread = *nth_shortest - self.shortest_round_trip;
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.points.capacity() * size_of::<RoundTripPoint>()
    }
}
