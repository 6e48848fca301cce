//! Detection of jumps of a clock that no local clock shows, as when a virtual machine is paused or migrated.
//!
//! A message that waits on the network moves the middle of an exchange's bounds by half of its waiting time, and
//! lengthens its round trip by all of it. A middle that moves further than half of the round trip's growth was not
//! moved by waiting: either the path changed, or a clock jumped. Exchanges cannot tell these two apart.
//!
//! When the edge's clock is set back, the exchanges in flight have one bound from before the jump and one from after
//! it, and seem shorter than the path. Their round trips would hide the jump in later exchanges. Such an exchange
//! therefore counts only if one that was sent later is as short, which shows that the path became shorter.

use std::collections::VecDeque;

use crate::band::DriftLimit;
use crate::{Exchange, RawTime, Span};

/// Length in nanoseconds of the stretches whose shortest round trips are kept.
const STRETCH: i64 = 500_000_000;
/// Number of newest stretches that are kept at any age.
const LEAST: usize = 8;
/// Largest number of stretches that are kept.
const MOST: usize = 20;
/// Smallest number of stretches from which the shortest round trip is considered known.
const LEAST_TO_SUSPECT: usize = 4;
/// Movement of a middle in nanoseconds that is never suspected. The tolerance is a fiftieth of the shortest round trip
/// if that is more.
const TOLERANCE: i64 = 100_000;
const TOLERANCE_SHARE: i64 = 50;

/// The exchange with the shortest round trip of each half second of the window.
#[derive(Clone, Debug, Default)]
pub(super) struct ShortestRoundTrips {
    points: VecDeque<RoundTripPoint>,
    /// Shortest round trip, and the spread of the next ones above it, in nanoseconds. The shortest may exceed the
    /// path's own round trip by the spread.
    shortest: i64,
    spread: i64,
    /// Time until which short exchanges are ignored, after one seemed shorter than the path. An exchange sent later was
    /// not in flight together with it.
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
pub(super) struct Suspicion {
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
    /// Returns the jump that an exchange suggests, which must be within the limits of drift and of its change.
    pub(super) fn suspect(&self, exchange: &Exchange, drift: DriftLimit) -> Option<Suspicion> {
        let point = RoundTripPoint::from(exchange);
        let longer = point.round_trip.saturating_sub(self.shortest).saturating_abs();
        let newest = self.points.back()?;
        // Cheap check first: usually the middle is where the newest one was.
        let tolerance = self.tolerance();
        let moved = |known: &RoundTripPoint| point.middle.saturating_sub(known.middle);
        if self.points.len() < LEAST_TO_SUSPECT
            || (longer / 2).saturating_add(tolerance) > moved(newest).abs()
        {
            return None;
        }
        let is_beyond = |known: &&RoundTripPoint| {
            let moved = moved(known).abs();
            let waited = longer.saturating_add(known.round_trip - self.shortest) / 2;
            // The middle belongs to the bounds at two times, between which the offset drifts.
            let drifted =
                drift.between(known.sent.min(point.sent).nanos(), known.returned.max(point.returned).nanos());
            let explained = [waited, drifted, tolerance, self.spread, point.uncertainty, known.uncertainty];
            longer <= moved / 4 && moved > explained.into_iter().fold(0, i64::saturating_add)
        };
        let moved = moved(self.points.iter().rev().find(is_beyond)?);
        let would_show = |known: &&RoundTripPoint| known.round_trip - self.shortest <= moved.abs() / 4;
        let last = self.points.iter().rev().find(would_show)?;
        Some(Suspicion { moved: Span::from_nanos(moved), last_before: (last.sent, last.returned) })
    }

    fn tolerance(&self) -> i64 {
        TOLERANCE.max(self.shortest / TOLERANCE_SHARE)
    }

    /// Returns whether an exchange seems shorter than the path, and no exchange that was not in flight together with it
    /// did so.
    fn may_span_jump(&mut self, point: &RoundTripPoint) -> bool {
        let shorter = self.shortest.saturating_sub(point.round_trip);
        let explained = self.tolerance().saturating_add(self.spread).saturating_add(point.uncertainty);
        let is_short = self.points.len() >= LEAST_TO_SUSPECT && shorter > explained;
        match self.shortened_until {
            Some(until) if until <= point.sent => {
                self.shortened_until = None;
                false
            }
            Some(_) => is_short,
            None => {
                // By the clock that stamped its departure, the exchange returned later by as much as it seems shorter.
                let apart = Span::from_nanos(shorter.saturating_add(explained));
                self.shortened_until = is_short.then(|| point.returned + apart);
                is_short
            }
        }
    }

    /// Inserts an exchange, and removes those more than `window` before it.
    pub(super) fn insert(&mut self, exchange: &Exchange, window: Span) {
        let point = RoundTripPoint::from(exchange);
        if self.may_span_jump(&point) {
            return;
        }
        let stretch = |point: &RoundTripPoint| point.sent.nanos().div_euclid(STRETCH);
        match self.points.back_mut() {
            Some(last) if stretch(last) == stretch(&point) => {
                if point.round_trip < last.round_trip {
                    *last = point;
                    self.shortest = self.shortest.min(point.round_trip);
                }
            }
            // A late answer of an earlier half second adds nothing.
            Some(last) if stretch(last) > stretch(&point) => {}
            _ => {
                self.points.push_back(point);
                let start = point.sent - window;
                let is_needless = |points: &VecDeque<RoundTripPoint>| {
                    points.len() > MOST
                        || (points.len() > LEAST && points.front().is_some_and(|point| point.sent < start))
                };
                while is_needless(&self.points) {
                    self.points.pop_front();
                }
                self.measure();
            }
        }
    }

    /// Removes all exchanges.
    pub(super) fn clear(&mut self) {
        self.points.clear();
        self.shortened_until = None;
    }

    fn measure(&mut self) {
        // The newest stretch is incomplete, so that its shortest round trip is not known yet.
        let complete = self.points.len().saturating_sub(1).max(1);
        let mut trips = [i64::MAX; MOST];
        for (trip, point) in trips.iter_mut().zip(self.points.iter().take(complete)) {
            *trip = point.round_trip;
        }
        let (_, other, _) = trips[..].select_nth_unstable(LEAST.min(complete) - 1);
        self.shortest = self.points.iter().map(|point| point.round_trip).min().unwrap_or(0);
        self.spread = *other - self.shortest;
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.points.capacity() * size_of::<RoundTripPoint>()
    }
}
