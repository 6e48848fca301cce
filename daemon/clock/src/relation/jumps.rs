//! Jumps of a clock that no local clock shows, as when a virtual machine is paused or moved to another host.
//!
//! A message that waits on its way moves the middle of an exchange's bounds by half of what it waits, and makes its round trip longer
//! by all of it. A middle that moves further than half of what the round trip grew was not moved by waiting: either the path changed,
//! or a clock jumped. The two look the same in exchanges.
//!
//! When the edge's clock is set back, the exchanges under way have one bound from before the jump and one from after it, and seem to take
//! less time than the path needs. Their round trips would hide the jump in those that follow, so that they count only when one that
//! was sent later is as short: the path became shorter then.

use std::collections::VecDeque;

use crate::band::DriftLimit;
use crate::{Exchange, RawTime, Span};

/// Length of a stretch of which the shortest round trip is kept.
const STRETCH: i64 = 500_000_000;
/// The newest that are kept however old they are, and most that are kept.
const LEAST: usize = 8;
const MOST: usize = 20;
/// Fewer stretches tell nothing of what the shortest round trip is.
const LEAST_TO_SUSPECT: usize = 4;
/// A middle that moves by less is not suspected, or by less than a fiftieth of the shortest round trip.
const TOLERANCE: i64 = 100_000;
const TOLERANCE_SHARE: i64 = 50;

/// The exchange with the shortest round trip of each half second of the window.
#[derive(Clone, Debug, Default)]
pub(super) struct Floor {
    points: VecDeque<FloorPoint>,
    /// The shortest round trip, and how much longer the others of a few half seconds are: as much longer than the path's own it may be.
    shortest: i64,
    spread: i64,
    /// An exchange seemed to be shorter than the path: one that is sent from here on was not under way together with it.
    shortened_until: Option<RawTime>,
}

/// An exchange with a short round trip.
#[derive(Clone, Copy, Debug)]
struct FloorPoint {
    sent: RawTime,
    returned: RawTime,
    /// Of the bounds of the offset.
    middle: i64,
    round_trip: i64,
    uncertainty: i64,
}

/// What is suspected when an exchange moved the middle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Suspicion {
    /// By how much the middle moved.
    pub(super) moved: Span,
    /// When the last exchange before was sent that would have shown it, and when it returned.
    pub(super) last_before: (RawTime, RawTime),
}

impl From<&Exchange> for FloorPoint {
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

impl Floor {
    /// Returns what is to be suspected because of an exchange, which is within the limit of drift and of its change.
    pub(super) fn suspect(&self, exchange: &Exchange, drift: DriftLimit) -> Option<Suspicion> {
        let point = FloorPoint::from(exchange);
        let longer = point.round_trip.saturating_sub(self.shortest).saturating_abs();
        let newest = self.points.back()?;
        // Mostly the middle is where the newest one was.
        let tolerance = self.tolerance();
        let moved = |known: &FloorPoint| point.middle.saturating_sub(known.middle);
        if self.points.len() < LEAST_TO_SUSPECT
            || (longer / 2).saturating_add(tolerance) > moved(newest).abs()
        {
            return None;
        }
        let is_beyond = |known: &&FloorPoint| {
            let moved = moved(known).abs();
            let waited = longer.saturating_add(known.round_trip - self.shortest) / 2;
            // The middle is that of the bounds at two times, between which the offset drifts.
            let drifted =
                drift.between(known.sent.min(point.sent).nanos(), known.returned.max(point.returned).nanos());
            let explained = [waited, drifted, tolerance, self.spread, point.uncertainty, known.uncertainty];
            longer <= moved / 4 && moved > explained.into_iter().fold(0, i64::saturating_add)
        };
        let moved = moved(self.points.iter().rev().find(is_beyond)?);
        let would_show = |known: &&FloorPoint| known.round_trip - self.shortest <= moved.abs() / 4;
        let last = self.points.iter().rev().find(would_show)?;
        Some(Suspicion { moved: Span::from_nanos(moved), last_before: (last.sent, last.returned) })
    }

    fn tolerance(&self) -> i64 {
        TOLERANCE.max(self.shortest / TOLERANCE_SHARE)
    }

    /// Whether an exchange seems to be shorter than the path, and none that was not under way together with it was.
    fn may_span_jump(&mut self, point: &FloorPoint) -> bool {
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
                // By the clock that it was sent by it returned later by what it seems to be shorter.
                let apart = Span::from_nanos(shorter.saturating_add(explained));
                self.shortened_until = is_short.then(|| point.returned + apart);
                is_short
            }
        }
    }

    /// Takes an exchange, and drops those of more than `window` before it.
    pub(super) fn insert(&mut self, exchange: &Exchange, window: Span) {
        let point = FloorPoint::from(exchange);
        if self.may_span_jump(&point) {
            return;
        }
        let stretch = |point: &FloorPoint| point.sent.nanos().div_euclid(STRETCH);
        match self.points.back_mut() {
            Some(last) if stretch(last) == stretch(&point) => {
                if point.round_trip < last.round_trip {
                    *last = point;
                    self.shortest = self.shortest.min(point.round_trip);
                }
            }
            // One that was overtaken by those of the next half second adds nothing.
            Some(last) if stretch(last) > stretch(&point) => {}
            _ => {
                self.points.push_back(point);
                let start = point.sent - window;
                let is_needless = |points: &VecDeque<FloorPoint>| {
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

    /// Forgets all.
    pub(super) fn clear(&mut self) {
        self.points.clear();
        self.shortened_until = None;
    }

    fn measure(&mut self) {
        // The stretch that has just begun has not shown yet how short its round trips are.
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
        self.points.capacity() * size_of::<FloorPoint>()
    }
}
