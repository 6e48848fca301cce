//! For each time, the interval that must contain the offset of two clocks, as the exchanges prove it.
//!
//! The offset θ(x) is the cloud's clock minus the edge's clock when the edge's clock shows x. Each exchange bounds the
//! offset from above at the time at which the message was sent, and from below at the time at which the answer
//! returned. The limit of drift extends both bounds to other times.

mod best_points;
mod drift;
mod hull;
mod rate_change;
mod skew;
mod slots;
#[cfg(test)]
mod tests;
mod trend;

use std::collections::VecDeque;

pub(crate) use drift::{DriftChangeLimit, DriftLimit, DriftModel};
use rate_change::{Hulls, MAX_POINTS_BEFORE_OR_AFTER};
pub use skew::ProvenSkew;
use slots::{Insertion, Point, Slots, lowest_bound};
use trend::Trend;

use crate::{Exchange, Interval, RawTime, Span};

/// Number of newest exchanges that bound the offset however old they are. If the window contains fewer exchanges, the
/// window is extended back to the oldest of these exchanges.
// With rare exchanges, the window alone would often be empty, and the offset would have no bounds.
const MIN_BOUNDING_EXCHANGES: usize = 8;

/// The hulls are built in advance for queries up to this time after the newest exchange, nanoseconds.
// These hulls serve all queries up to then. Points that leave the window before then are left out.
const HULL_LEAD_NANOS: i64 = 1_000_000_000;

/// Amount by which each bound is widened, because stamps are rounded to whole nanoseconds.
// A bound is the difference of two stamps, each of which is wrong by less than one nanosecond.
const ROUNDING_NANOS: i64 = 2;

/// The two bounds that one exchange gives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    upper: Point,
    /// Lower bound with the opposite sign, so that the same code serves both sides.
    lower: Point,
}

impl From<&Exchange> for Bounds {
    fn from(exchange: &Exchange) -> Self {
        let point = |x: RawTime, bound: Span| Point {
            x: x.nanos(),
            bound: bound.nanos().saturating_add(ROUNDING_NANOS),
        };
        Self {
            upper: point(exchange.sent, exchange.upper()),
            lower: point(exchange.returned, -exchange.lower()),
        }
    }
}

impl Bounds {
    /// Returns the time on the edge's clock at which the message was sent. It identifies the exchange, because no two
    /// messages are sent at the same time.
    pub(crate) fn sent(&self) -> RawTime {
        RawTime::from_nanos(self.upper.x)
    }
}

/// Assumption that cannot be true together with an exchange and the earlier exchanges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Contradiction {
    /// The limit of drift.
    Drift,
    /// The limit of the drift's change. The limit of drift is not contradicted.
    DriftChange,
}

/// Interval that contains the offset at one time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct OffsetInterval {
    /// The interval that follows from the limit of drift and the limit of the drift's change. If no offset satisfies
    /// both limits, the interval that follows from the limit of drift alone.
    pub(crate) interval: Interval,
    /// `true` if an offset exists that satisfies both limits and all exchanges.
    pub(crate) is_consistent: bool,
}

/// The interval of the offset over time that exchanges prove.
///
/// An exchange bounds the offset only at times that are at most the length of the window away from it. The newest eight
/// exchanges are exceptions: they count at any age. If a clock violates the limit of drift or jumps unnoticed,
/// intervals are therefore wrong only as long as the window, or these eight exchanges, reach back to the violation.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    drift: DriftModel,
    /// Longest time between an exchange and a time at which the exchange bounds the offset, nanoseconds.
    window_length: i64,
    /// Time for which bounds are kept, nanoseconds.
    retention: i64,
    upper: Slots,
    /// Lower bounds with the opposite sign, so that the same code serves both sides.
    lower: Slots,
    /// The newest exchanges, in the order of their return.
    newest_exchanges: VecDeque<Bounds>,
    /// Convex hulls of the points around the newest exchange. They give the bounds by the limit of the drift's change
    /// ([`rate_change`]).
    hulls: Hulls,
    trend: Trend,
    /// Time on the edge's clock in nanoseconds at which the newest exchange returned.
    newest_return: i64,
    exchange_count: u64,
}

impl Band {
    /// Creates a band without exchanges. Exchanges are kept for `retention`, or for `window_length` if that is longer,
    /// to answer queries about the past.
    pub(crate) fn new(drift: DriftModel, window_length: Span, retention: Span) -> Self {
        let window_length = window_length.nanos().max(0);
        let retention = retention.nanos().max(window_length);
        Self {
            drift,
            window_length,
            retention,
            upper: Slots::new(drift.limit, retention),
            lower: Slots::new(drift.limit, retention),
            newest_exchanges: VecDeque::with_capacity(MIN_BOUNDING_EXCHANGES + 1),
            hulls: Hulls::default(),
            trend: Trend::default(),
            newest_return: i64::MIN,
            exchange_count: 0,
        }
    }

    /// Returns the assumption that an exchange contradicts: no offset satisfies the assumption, the exchange and all
    /// exchanges that are kept. `None` if the exchange contradicts no assumption.
    ///
    /// If each exchange is checked before it is inserted, the bounds by the limit of drift never exclude each other.
    /// The bounds by the limit of the drift's change can still exclude each other, because they involve three or four
    /// points at once. [`interval`](Self::interval) reports such a contradiction.
    // Proof of the first statement: let U be the upper bound of one exchange at x, L the lower bound of another at y,
    // and w(t) the largest drift during t. If the bounds at q excluded each other, U + w(|q − x|) < L − w(|q − y|),
    // then also U < L − w(|x − y|), and the later of the two exchanges would have been rejected. For that reason the
    // check covers all exchanges that are kept, not only the exchanges of the window.
    pub(crate) fn contradiction(&self, bounds: &Bounds) -> Option<Contradiction> {
        let Bounds { upper, lower } = *bounds;
        // Points of the lower side have the opposite sign, so that a bound is negated for the comparison with the other
        // side.
        let (negated_lower, negated_upper) = (lower.bound.saturating_neg(), upper.bound.saturating_neg());
        let limit = self.drift.limit;
        if self.lower.is_below(negated_upper, upper.x)
            || self.upper.is_below(negated_lower, lower.x)
            || self.newest_exchanges.iter().any(|other| {
                other.lower.is_below(negated_upper, limit, upper.x)
                    || other.upper.is_below(negated_lower, limit, lower.x)
            })
        {
            return Some(Contradiction::Drift);
        }
        let change = self.drift.change_limit?;
        // A cheap check comes first: an exchange contradicts nothing if the newest exchanges give bounds as good as its
        // own.
        let improves = |point: Point, side: fn(&Bounds) -> Point| {
            self.newest_exchanges.iter().all(|bounds| side(bounds).bound_at(limit, point.x) > point.bound)
        };
        let excludes = |q: i64, bound: i64, query: fn(&Hulls, i64, DriftChangeLimit) -> Option<i64>| {
            self.query_hulls(q, change, |hulls| query(hulls, q, change))
                .is_some_and(|opposite| opposite < bound)
        };
        let is_excluded = (improves(upper, |bounds| bounds.upper)
            && excludes(upper.x, negated_upper, Hulls::lower_bound))
            || (improves(lower, |bounds| bounds.lower)
                && excludes(lower.x, negated_lower, Hulls::upper_bound));
        is_excluded.then_some(Contradiction::DriftChange)
    }

    /// Inserts an exchange and removes the bounds of expired exchanges. One of the newest exchanges that is inserted again
    /// counts once.
    pub(crate) fn insert(&mut self, bounds: &Bounds) {
        self.newest_return = self.newest_return.max(bounds.lower.x);
        let start = self.newest_return.saturating_sub(self.retention);
        let inserted = [self.upper.insert(bounds.upper), self.lower.insert(bounds.lower)];
        self.upper.remove_before(start);
        self.lower.remove_before(start);
        // An exchange is inserted again if a better stamp of the answer's departure is known. It must not take two places
        // among the newest exchanges.
        match self.newest_exchanges.iter().position(|other| other.upper.x == bounds.upper.x) {
            Some(index) => _ = self.newest_exchanges.remove(index),
            None => self.exchange_count += 1,
        }
        let index = self.newest_exchanges.partition_point(|other| other.lower.x <= bounds.lower.x);
        self.newest_exchanges.insert(index, *bounds);
        if self.newest_exchanges.len() > MIN_BOUNDING_EXCHANGES {
            self.newest_exchanges.pop_front();
        }
        self.trend.insert(bounds.upper, bounds.lower, self.drift.limit.slope());
        if let Some(change) = self.drift.change_limit {
            let mut hulls = std::mem::take(&mut self.hulls);
            self.fill_hulls(&mut hulls, self.newest_return.saturating_add(HULL_LEAD_NANOS), inserted, change);
            self.hulls = hulls;
        }
    }

    /// Removes the bounds of exchanges after an exchange that was `sent` and `returned` at these times, also of exchanges
    /// that were in flight together with it. The estimate keeps its points of these exchanges, because it is not a bound.
    pub(crate) fn truncate(&mut self, sent: RawTime, returned: RawTime) {
        self.upper.truncate(sent.nanos());
        self.lower.truncate(returned.nanos());
        self.newest_exchanges.retain(|bounds| bounds.lower.x <= returned.nanos());
        self.hulls = Hulls::default();
    }

    /// Returns a copy of the band without the bounds of exchanges before `start`. The estimate and the number of
    /// exchanges still include them.
    pub(crate) fn without_exchanges_before(&self, start: RawTime) -> Self {
        let mut copy = Self { hulls: Hulls::default(), ..self.clone() };
        let start = start.nanos();
        copy.upper.remove_before(start);
        copy.lower.remove_before(start);
        copy.newest_exchanges.retain(|bounds| bounds.upper.x >= start);
        copy
    }

    /// Returns the interval at a time; `None` without exchanges.
    pub(crate) fn interval(&self, at: RawTime) -> Option<OffsetInterval> {
        let q = at.nanos();
        let interval = |hi: i64, lo: i64| Interval {
            lo: Span::from_nanos(lo.saturating_neg()),
            hi: Span::from_nanos(hi),
        };
        let (hi, lo) = (self.upper_bound(q)?, self.lower_bound(q)?);
        let by_drift_limit = OffsetInterval { interval: interval(hi, lo), is_consistent: true };
        let Some(change) = self.drift.change_limit else { return Some(by_drift_limit) };
        let (upper_bound, lower_bound) =
            self.query_hulls(q, change, |hulls| (hulls.upper_bound(q, change), hulls.lower_bound(q, change)));
        let (hi, lo) =
            (upper_bound.map_or(hi, |bound| bound.min(hi)), lower_bound.map_or(lo, |bound| bound.min(lo)));
        if hi.saturating_add(lo) < 0 {
            return Some(OffsetInterval { is_consistent: false, ..by_drift_limit });
        }
        Some(OffsetInterval { interval: interval(hi, lo), is_consistent: true })
    }

    /// Calls `query` with the hulls of the points around `q`.
    fn query_hulls<T>(&self, q: i64, change: DriftChangeLimit, query: impl Fn(&Hulls) -> T) -> T {
        if self.hulls.are_within(q, self.window_length) {
            return query(&self.hulls);
        }
        let mut hulls = Hulls::default();
        // `Other` makes `fill_hulls` build both sides from all points.
        self.fill_hulls(&mut hulls, q, [Insertion::Other; 2], change);
        query(&hulls)
    }

    /// Builds the hulls of the points around `q`. The two [`Insertion`]s say how the upper and the lower points changed
    /// since the last call.
    fn fill_hulls(
        &self,
        hulls: &mut Hulls,
        q: i64,
        [upper, lower]: [Insertion; 2],
        change: DriftChangeLimit,
    ) {
        if self.is_sparse(q) {
            // The newest exchanges are in the order in which they returned. The upper points may be in another order,
            // because they are at the times at which the exchanges were sent.
            let mut upper: Vec<Point> = self.newest_exchanges.iter().map(|bounds| bounds.upper).collect();
            upper.sort_unstable_by_key(|point| point.x);
            hulls.set_upper(upper.iter().copied(), change);
            hulls.set_lower(self.newest_exchanges.iter().map(|bounds| bounds.lower), change);
            hulls.are_of_slots = false;
            return;
        }
        // Hulls of other points cannot be updated with the newest point of a slot: it may be earlier than their points.
        let was_of_slots = std::mem::replace(&mut hulls.are_of_slots, true);
        let [upper, lower] = if was_of_slots { [upper, lower] } else { [Insertion::Other; 2] };
        let max_points = MAX_POINTS_BEFORE_OR_AFTER;
        match (upper, self.upper.newest()) {
            (Insertion::Newest, Some(newest)) => hulls.replace_upper(newest, change),
            (Insertion::Unchanged, _) => {}
            _ => hulls.set_upper(self.upper.points_around(q, self.window_length, max_points), change),
        }
        match (lower, self.lower.newest()) {
            (Insertion::Newest, Some(newest)) => hulls.replace_lower(newest, change),
            (Insertion::Unchanged, _) => {}
            _ => hulls.set_lower(self.lower.points_around(q, self.window_length, max_points), change),
        }
    }

    /// Returns whether the oldest of the newest eight exchanges is before the window of `q`.
    fn is_sparse(&self, q: i64) -> bool {
        self.newest_exchanges
            .front()
            .is_some_and(|oldest| q.saturating_sub(oldest.upper.x) > self.window_length)
    }

    /// Returns the age that an exchange can have and still bound the offset at a time: the window, or the age of the
    /// oldest of the newest eight exchanges if that is more. `None` without exchanges.
    pub(crate) fn window_span(&self, at: RawTime) -> Option<Span> {
        let oldest = self.newest_exchanges.front()?.upper.x;
        Some(Span::from_nanos(at.nanos().saturating_sub(oldest).max(self.window_length)))
    }

    /// Returns the upper bound at `q` by the limit of drift, from the points within the window and the newest
    /// exchanges.
    fn upper_bound(&self, q: i64) -> Option<i64> {
        let from_newest =
            lowest_bound(self.newest_exchanges.iter().map(|bounds| bounds.upper), self.drift.limit, q);
        self.upper.bound(q, self.window_length).into_iter().chain(from_newest).min()
    }

    /// Returns the lower bound at `q` by the limit of drift, with the opposite sign.
    fn lower_bound(&self, q: i64) -> Option<i64> {
        let from_newest =
            lowest_bound(self.newest_exchanges.iter().map(|bounds| bounds.lower), self.drift.limit, q);
        self.lower.bound(q, self.window_length).into_iter().chain(from_newest).min()
    }

    /// Returns the estimate at a time within `interval`, which must be the band's interval at that time.
    pub(crate) fn estimate(&self, at: RawTime, interval: Interval) -> Span {
        let estimate = self
            .trend
            .estimate_at(at.nanos(), self.drift.limit.slope())
            .unwrap_or_else(|| interval.middle().nanos());
        Span::from_nanos(estimate).clamp(interval.lo, interval.hi)
    }

    /// Returns the estimated change of the offset between two neighbouring times.
    pub(crate) fn offset_change(&self, from: RawTime, to: RawTime) -> Span {
        let slope = self.trend.slope_at(from.nanos(), self.drift.limit.slope()).unwrap_or(0.0);
        Span::from_nanos((slope * (to - from).nanos() as f64).round() as i64)
    }

    /// Returns the estimated skew in parts per million; `None` without enough exchanges.
    pub(crate) fn skew_ppm(&self) -> Option<f64> {
        self.trend.skew().map(|slope| slope * 1e6)
    }

    /// Returns the skew that the exchanges prove; `None` without enough exchanges.
    pub(crate) fn proven_skew(&self) -> Option<ProvenSkew> {
        self.trend.skew_bounds().proven_skew()
    }

    /// Returns the proven skew if it exceeds the limit of drift in either direction.
    pub(crate) fn excess_skew(&self) -> Option<ProvenSkew> {
        // The bounds are computed in floating point; a billionth is far more than its rounding error.
        let limit = self.drift.limit.slope() * 1e6 * (1.0 + 1e-9);
        self.proven_skew().filter(|skew| skew.min_ppm > limit || skew.max_ppm < -limit)
    }

    /// Returns the number of exchanges inserted.
    pub(crate) fn exchange_count(&self) -> u64 {
        self.exchange_count
    }

    /// Returns the time of the earliest exchange that can bound the offset at `at`: the start of the window, or the
    /// oldest of the newest eight exchanges if that is earlier.
    pub(crate) fn window_start(&self, at: RawTime) -> RawTime {
        let start = at.nanos().saturating_sub(self.window_length);
        let oldest = self.newest_exchanges.front().map_or(start, |oldest| oldest.upper.x);
        RawTime::from_nanos(start.min(oldest))
    }

    /// Returns the time on the edge's clock at which the newest exchange returned; `None` without exchanges.
    pub(crate) fn newest_return(&self) -> Option<RawTime> {
        (self.exchange_count > 0).then(|| RawTime::from_nanos(self.newest_return))
    }

    pub(crate) fn memory_bytes(&self) -> usize {
        self.upper.memory_bytes()
            + self.lower.memory_bytes()
            + self.newest_exchanges.capacity() * size_of::<Bounds>()
            + self.hulls.memory_bytes()
            + self.trend.memory_bytes()
    }
}
