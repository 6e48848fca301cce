//! The offset of two clocks as a band over time: exactly what the exchanges prove.
//!
//! The offset θ(x) is the cloud's clock minus the edge's clock when the edge's shows x. Each exchange bounds it from
//! above at the time it was sent and from below at the time it returned. The limit of drift extends both bounds to
//! other times.

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
use rate_change::{Hulls, MOST};
pub use skew::ProvenSkew;
use slots::{Insertion, Point, Slots, lowest};
use trend::Trend;

use crate::{Exchange, Interval, RawTime, Span};

/// Number of newest exchanges that count at any age. Where the window holds fewer, it is extended back to them.
const LEAST_EXCHANGES: usize = 8;

/// Time in nanoseconds by which the hulls of the newest exchanges are made ahead, so that they serve queries shortly
/// after them. Points that will be too old by then are left out.
const LEAD: i64 = 1_000_000_000;

/// Allowance in nanoseconds for stamps that are cut or rounded to whole nanoseconds: less than one for each of a
/// bound's two.
const RESOLUTION: i64 = 2;

/// The two bounds that one exchange gives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    upper: Point,
    /// Lower bound with the opposite sign, so that the same code serves both sides.
    lower: Point,
}

impl From<&Exchange> for Bounds {
    fn from(exchange: &Exchange) -> Self {
        let point =
            |x: RawTime, bound: Span| Point { x: x.nanos(), bound: bound.nanos().saturating_add(RESOLUTION) };
        Self {
            upper: point(exchange.sent, exchange.upper()),
            lower: point(exchange.returned, -exchange.lower()),
        }
    }
}

impl Bounds {
    /// Time on the edge's clock at which the exchange began. It identifies the exchange, because no two begin at the
    /// same time.
    pub(crate) fn sent(&self) -> RawTime {
        RawTime::from_nanos(self.upper.x)
    }
}

/// Assumption that an exchange contradicts together with the exchanges before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Contradiction {
    /// The limit of drift.
    Drift,
    /// The limit of the drift's change; the limit of drift holds.
    DriftChange,
}

/// Interval that contains the offset at one time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct OffsetInterval {
    /// The interval by both assumptions; by the limit of drift alone where no offset satisfies both.
    pub(crate) interval: Interval,
    /// `true` if an offset exists that satisfies both assumptions and all exchanges.
    pub(crate) is_consistent: bool,
}

/// The interval of the offset over time that the exchanges of a window prove.
///
/// Exchanges bound the offset only at times within a window of them; only the newest eight count at any age. A clock
/// that violates the limit of drift, or jumps unnoticed, therefore makes intervals wrong for no longer than that.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    drift: DriftModel,
    window: i64,
    retention: i64,
    upper: Slots,
    /// Lower bounds with the opposite sign, so that the same code serves both sides.
    lower: Slots,
    /// The newest exchanges, in the order of their return.
    latest: VecDeque<Bounds>,
    /// Hulls of the points around the newest exchange.
    hulls: Hulls,
    trend: Trend,
    /// Time on the edge's clock in nanoseconds at which the newest exchange returned.
    newest: i64,
    exchanges: u64,
}

impl Band {
    /// Creates a band without exchanges. Exchanges are kept for `retention`, or for `window` if that is longer, to
    /// answer queries about the past.
    pub(crate) fn new(drift: DriftModel, window: Span, retention: Span) -> Self {
        let window = window.nanos().max(0);
        let retention = retention.nanos().max(window);
        Self {
            drift,
            window,
            retention,
            upper: Slots::new(drift.limit, retention),
            lower: Slots::new(drift.limit, retention),
            latest: VecDeque::with_capacity(LEAST_EXCHANGES + 1),
            hulls: Hulls::default(),
            trend: Trend::default(),
            newest: i64::MIN,
            exchanges: 0,
        }
    }

    /// Returns the assumption that the exchange contradicts: no offset satisfies both the exchange and everything kept.
    ///
    /// The cones of the limit of drift always have an offset in common, if each exchange is checked before it is
    /// inserted: hi(q) < lo(q) would mean U + w(|q − x|) < L − w(|q − y|), hence U < L − w(|x − y|) for two exchanges
    /// that are kept at once, and the later one would have been rejected. For that reason the check covers all that is
    /// kept, not only the window. The rules for the rate's change involve three and four points at once: their bounds
    /// may exclude each other although each exchange was checked. [`interval`](Self::interval) reports that.
    pub(crate) fn contradiction(&self, bounds: &Bounds) -> Option<Contradiction> {
        let Bounds { upper, lower } = *bounds;
        let (most, least) = (lower.bound.saturating_neg(), upper.bound.saturating_neg());
        let limit = self.drift.limit;
        if self.lower.is_below(least, upper.x)
            || self.upper.is_below(most, lower.x)
            || self.latest.iter().any(|other| {
                other.lower.is_below(least, limit, upper.x) || other.upper.is_below(most, limit, lower.x)
            })
        {
            return Some(Contradiction::Drift);
        }
        let change = self.drift.change?;
        // An exchange whose bounds are no better than those of the newest ones cannot contradict them. This check is
        // cheap.
        let adds = |point: Point, side: fn(&Bounds) -> Point| {
            self.latest.iter().all(|known| side(known).carried(limit, point.x) > point.bound)
        };
        let excludes = |q: i64, bound: i64, ask: fn(&Hulls, i64, DriftChangeLimit) -> Option<i64>| {
            self.with_hulls(q, change, |hulls| ask(hulls, q, change)).is_some_and(|known| known < bound)
        };
        let is_excluded = (adds(upper, |bounds| bounds.upper) && excludes(upper.x, least, Hulls::below))
            || (adds(lower, |bounds| bounds.lower) && excludes(lower.x, most, Hulls::above));
        is_excluded.then_some(Contradiction::DriftChange)
    }

    /// Inserts an exchange and removes expired ones.
    pub(crate) fn insert(&mut self, bounds: &Bounds) {
        self.newest = self.newest.max(bounds.lower.x);
        let start = self.newest.saturating_sub(self.retention);
        let inserted = [self.upper.insert(bounds.upper), self.lower.insert(bounds.lower)];
        self.upper.expire(start);
        self.lower.expire(start);
        let at = self.latest.partition_point(|other| other.lower.x <= bounds.lower.x);
        self.latest.insert(at, *bounds);
        if self.latest.len() > LEAST_EXCHANGES {
            self.latest.pop_front();
        }
        self.exchanges += 1;
        self.trend.insert(bounds.upper, bounds.lower, self.drift.limit.slope());
        if let Some(change) = self.drift.change {
            let mut hulls = std::mem::take(&mut self.hulls);
            self.fill(&mut hulls, self.newest.saturating_add(LEAD), inserted, change);
            self.hulls = hulls;
        }
    }

    /// Removes everything that bounds the offset after `end`. The estimate keeps its points, because it is no bound.
    pub(crate) fn truncate(&mut self, end: RawTime) {
        let end = end.nanos();
        self.upper.truncate(end);
        self.lower.truncate(end);
        self.latest.retain(|bounds| bounds.lower.x <= end);
        self.hulls = Hulls::default();
    }

    /// Returns a copy of the band without the exchanges before `start`.
    pub(crate) fn since(&self, start: RawTime) -> Self {
        let mut since = Self { hulls: Hulls::default(), ..self.clone() };
        let start = start.nanos();
        since.upper.expire(start);
        since.lower.expire(start);
        since.latest.retain(|bounds| bounds.upper.x >= start);
        since
    }

    /// Returns the interval at a time; `None` without exchanges.
    pub(crate) fn interval(&self, at: RawTime) -> Option<OffsetInterval> {
        let q = at.nanos();
        let interval = |hi: i64, lo: i64| Interval {
            lo: Span::from_nanos(lo.saturating_neg()),
            hi: Span::from_nanos(hi),
        };
        let (hi, lo) = (self.above(q)?, self.below(q)?);
        let cones = OffsetInterval { interval: interval(hi, lo), is_consistent: true };
        let Some(change) = self.drift.change else { return Some(cones) };
        let (above, below) =
            self.with_hulls(q, change, |hulls| (hulls.above(q, change), hulls.below(q, change)));
        let (hi, lo) = (above.map_or(hi, |bound| bound.min(hi)), below.map_or(lo, |bound| bound.min(lo)));
        if hi.saturating_add(lo) < 0 {
            return Some(OffsetInterval { is_consistent: false, ..cones });
        }
        Some(OffsetInterval { interval: interval(hi, lo), is_consistent: true })
    }

    /// Calls `ask` with the hulls of the points around `q`.
    fn with_hulls<T>(&self, q: i64, change: DriftChangeLimit, ask: impl Fn(&Hulls) -> T) -> T {
        if self.hulls.are_within(q, self.window) {
            return ask(&self.hulls);
        }
        let mut hulls = Hulls::default();
        self.fill(&mut hulls, q, [Insertion::Other; 2], change);
        ask(&hulls)
    }

    /// Builds the hulls of the points around `q`. Unchanged sides are kept.
    fn fill(&self, hulls: &mut Hulls, q: i64, [upper, lower]: [Insertion; 2], change: DriftChangeLimit) {
        if self.is_sparse(q) {
            // The latest exchanges are in the order of their return, in which the upper points need not be sorted.
            let mut upper: Vec<Point> = self.latest.iter().map(|bounds| bounds.upper).collect();
            upper.sort_unstable_by_key(|point| point.x);
            hulls.set_upper(upper.iter().copied(), change);
            hulls.set_lower(self.latest.iter().map(|bounds| bounds.lower), change);
            return;
        }
        match (upper, self.upper.newest()) {
            (Insertion::Newest, Some(newest)) => hulls.replace_upper(newest, change),
            (Insertion::Unchanged, _) => {}
            _ => hulls.set_upper(self.upper.around(q, self.window, MOST), change),
        }
        match (lower, self.lower.newest()) {
            (Insertion::Newest, Some(newest)) => hulls.replace_lower(newest, change),
            (Insertion::Unchanged, _) => {}
            _ => hulls.set_lower(self.lower.around(q, self.window, MOST), change),
        }
    }

    /// Returns whether the newest exchanges reach back further than the window before `q`.
    fn is_sparse(&self, q: i64) -> bool {
        self.latest.front().is_some_and(|oldest| q.saturating_sub(oldest.upper.x) > self.window)
    }

    /// Returns the age of the oldest exchange that bounds the offset at a time: the window, or more where exchanges are
    /// rare.
    pub(crate) fn reach(&self, at: RawTime) -> Option<Span> {
        let oldest = self.latest.front()?.upper.x;
        Some(Span::from_nanos(at.nanos().saturating_sub(oldest).max(self.window)))
    }

    /// Returns the upper bound at `q` by the limit of drift, from the points within the window and the latest
    /// exchanges.
    fn above(&self, q: i64) -> Option<i64> {
        let latest = lowest(self.latest.iter().map(|bounds| bounds.upper), self.drift.limit, q);
        self.upper.bound(q, self.window).into_iter().chain(latest).min()
    }

    /// Returns the lower bound at `q` in the same way, with the opposite sign.
    fn below(&self, q: i64) -> Option<i64> {
        let latest = lowest(self.latest.iter().map(|bounds| bounds.lower), self.drift.limit, q);
        self.lower.bound(q, self.window).into_iter().chain(latest).min()
    }

    /// Returns the estimate at a time within `interval`, which must be the band's interval at that time.
    pub(crate) fn estimate(&self, at: RawTime, interval: Interval) -> Span {
        let guess =
            self.trend.at(at.nanos(), self.drift.limit.slope()).unwrap_or_else(|| interval.middle().nanos());
        Span::from_nanos(guess).clamp(interval.lo, interval.hi)
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
        self.trend.proof().proven()
    }

    /// Returns the proven skew if it exceeds the limit of drift in either direction.
    pub(crate) fn excess_skew(&self) -> Option<ProvenSkew> {
        // The proof is computed in floating point; a billionth is far more than its rounding error.
        let limit = self.drift.limit.slope() * 1e6 * (1.0 + 1e-9);
        self.proven_skew().filter(|skew| skew.least_ppm > limit || skew.most_ppm < -limit)
    }

    /// Returns the number of exchanges inserted.
    pub(crate) fn exchanges(&self) -> u64 {
        self.exchanges
    }

    /// Returns the time from which on exchanges bound the offset at `at`: the begin of the window, or of the latest
    /// exchanges where these are rare.
    pub(crate) fn window_start(&self, at: RawTime) -> RawTime {
        let begin = at.nanos().saturating_sub(self.window);
        let oldest = self.latest.front().map_or(begin, |oldest| oldest.upper.x);
        RawTime::from_nanos(begin.min(oldest))
    }

    /// Returns the time on the edge's clock at which the newest exchange returned.
    pub(crate) fn newest(&self) -> Option<RawTime> {
        (self.exchanges > 0).then(|| RawTime::from_nanos(self.newest))
    }

    pub(crate) fn memory_bytes(&self) -> usize {
        self.upper.memory_bytes()
            + self.lower.memory_bytes()
            + self.latest.capacity() * size_of::<Bounds>()
            + self.hulls.memory_bytes()
            + self.trend.memory_bytes()
    }
}
