//! The offset of two clocks as a band over time: everything that exchanges say, and nothing that they do not.
//!
//! The offset θ(x) is the cloud's clock minus the edge's when the edge's shows x. Each exchange bounds it from
//! above at the time it was sent and from below at the time it returned; a limited drift carries both to other times.

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

/// The newest exchanges count however old they are: where they are rarer than this many in a window, the window reaches
/// back to them.
const LEAST_EXCHANGES: usize = 8;

/// The hulls of the newest exchanges are made for questions so long after them, too, and leave out what is then too old.
const LEAD: i64 = 1_000_000_000;

/// Stamps are cut or rounded to whole nanoseconds, the two of a bound each by less than one.
const RESOLUTION: i64 = 2;

/// What one exchange says.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    upper: Point,
    /// Lower bounds with the opposite sign, so that the same code keeps both.
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
    /// When the exchange began, by the edge's clock: no two begin at once.
    pub(crate) fn sent(&self) -> RawTime {
        RawTime::from_nanos(self.upper.x)
    }
}

/// Which assumption an exchange contradicts together with what was learnt before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Contradiction {
    /// The limit of drift.
    Drift,
    /// The limit of drift's change, not that of drift.
    DriftChange,
}

/// Interval that contains the offset at one time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct OffsetInterval {
    /// By both assumptions; by the limit of drift alone where no offset fits both.
    pub(crate) interval: Interval,
    /// Whether there is an offset that fits both assumptions and all exchanges.
    pub(crate) is_consistent: bool,
}

/// What the exchanges of a window prove.
///
/// An exchange bounds the offset at times no further from it than the window, so that a clock which breaks the limit of
/// drift, or jumps without notice, spoils no interval for longer than that.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    drift: DriftModel,
    window: i64,
    retention: i64,
    upper: Slots,
    /// Lower bounds with the opposite sign, so that the same code keeps both.
    lower: Slots,
    /// The newest exchanges, by the time that they returned.
    latest: VecDeque<Bounds>,
    /// Of the points around the newest exchange.
    hulls: Hulls,
    trend: Trend,
    /// When the newest exchange returned.
    newest: i64,
    exchanges: u64,
}

impl Band {
    /// A band that knows nothing. Exchanges are kept for `retention`, at least as long as the window, for questions about the past.
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

    /// What the exchange contradicts: no offset fits both the exchange and all that is kept.
    ///
    /// As long as each exchange is asked before it is taken, the cones of the limit of drift have something in common
    /// everywhere: hi(q) < lo(q) would mean U + w(|q − x|) < L − w(|q − y|), hence U < L − w(|x − y|) for two exchanges that
    /// are kept at once, and the later would have been found out. For that, all that is kept is asked here, not only
    /// what is within the window. The rules of the rate's change bind three and four points at once: what they bound may be empty
    /// though each exchange was asked, which [`interval`](Self::interval) tells.
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
        // One that bounds no better than the newest do cannot contradict what they leave; that is cheap to see.
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

    /// Takes an exchange, and drops what is too old by now.
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

    /// Forgets what bounds the offset after a time. The estimate keeps it: it promises nothing.
    pub(crate) fn truncate(&mut self, end: RawTime) {
        let end = end.nanos();
        self.upper.truncate(end);
        self.lower.truncate(end);
        self.latest.retain(|bounds| bounds.lower.x <= end);
        self.hulls = Hulls::default();
    }

    /// Returns the band without what it keeps from before a time.
    pub(crate) fn since(&self, start: RawTime) -> Self {
        let mut since = Self { hulls: Hulls::default(), ..self.clone() };
        let start = start.nanos();
        since.upper.expire(start);
        since.lower.expire(start);
        since.latest.retain(|bounds| bounds.upper.x >= start);
        since
    }

    /// The interval at a time; `None` without an exchange.
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

    /// Asks the hulls of the points around a time.
    fn with_hulls<T>(&self, q: i64, change: DriftChangeLimit, ask: impl Fn(&Hulls) -> T) -> T {
        if self.hulls.are_within(q, self.window) {
            return ask(&self.hulls);
        }
        let mut hulls = Hulls::default();
        self.fill(&mut hulls, q, [Insertion::Other; 2], change);
        ask(&hulls)
    }

    /// Makes the hulls of the points around a time, as far as they are others than before.
    fn fill(&self, hulls: &mut Hulls, q: i64, [upper, lower]: [Insertion; 2], change: DriftChangeLimit) {
        if self.is_sparse(q) {
            // By the time that they were sent the upper points need not be in order.
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

    /// Whether the newest exchanges reach back further than the window, seen from a time.
    fn is_sparse(&self, q: i64) -> bool {
        self.latest.front().is_some_and(|oldest| q.saturating_sub(oldest.upper.x) > self.window)
    }

    /// How far the exchanges that bound the offset at a time reach back: the window, or further where the newest are rare.
    pub(crate) fn reach(&self, at: RawTime) -> Option<Span> {
        let oldest = self.latest.front()?.upper.x;
        Some(Span::from_nanos(at.nanos().saturating_sub(oldest).max(self.window)))
    }

    /// The upper bound at a time by the limit of drift, by what is within the window of it, and by the latest exchanges.
    fn above(&self, q: i64) -> Option<i64> {
        let latest = lowest(self.latest.iter().map(|bounds| bounds.upper), self.drift.limit, q);
        self.upper.bound(q, self.window).into_iter().chain(latest).min()
    }

    /// The lower bound at a time, likewise, with the sign turned.
    fn below(&self, q: i64) -> Option<i64> {
        let latest = lowest(self.latest.iter().map(|bounds| bounds.lower), self.drift.limit, q);
        self.lower.bound(q, self.window).into_iter().chain(latest).min()
    }

    /// The best guess at a time, within `interval` (which is the band's at that time).
    pub(crate) fn estimate(&self, at: RawTime, interval: Interval) -> Span {
        let guess =
            self.trend.at(at.nanos(), self.drift.limit.slope()).unwrap_or_else(|| interval.middle().nanos());
        Span::from_nanos(guess).clamp(interval.lo, interval.hi)
    }

    /// By how much the offset most likely grows from one time to another one near.
    pub(crate) fn growth(&self, from: RawTime, to: RawTime) -> Span {
        let slope = self.trend.slope_at(from.nanos(), self.drift.limit.slope()).unwrap_or(0.0);
        Span::from_nanos((slope * (to - from).nanos() as f64).round() as i64)
    }

    /// How fast the offset grows, parts per million; `None` before there are enough exchanges.
    pub(crate) fn skew_ppm(&self) -> Option<f64> {
        self.trend.skew().map(|slope| slope * 1e6)
    }

    /// What the exchanges prove of that; `None` before there are enough.
    pub(crate) fn proven_skew(&self) -> Option<ProvenSkew> {
        self.trend.proof().proven()
    }

    /// The same, where the offset must have grown or shrunk faster than the limit.
    pub(crate) fn excess_skew(&self) -> Option<ProvenSkew> {
        // The proof is computed in floating point: a billionth part is far more than its rounding.
        let limit = self.drift.limit.slope() * 1e6 * (1.0 + 1e-9);
        self.proven_skew().filter(|skew| skew.least_ppm > limit || skew.most_ppm < -limit)
    }

    /// Exchanges taken.
    pub(crate) fn exchanges(&self) -> u64 {
        self.exchanges
    }

    /// Returns the time from which on exchanges bound the offset at a time: the begin of the window, or of the latest exchanges where
    /// these are rare.
    pub(crate) fn bounds_from(&self, at: RawTime) -> RawTime {
        let begin = at.nanos().saturating_sub(self.window);
        let oldest = self.latest.front().map_or(begin, |oldest| oldest.upper.x);
        RawTime::from_nanos(begin.min(oldest))
    }

    /// When the newest exchange returned, by the edge's clock.
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
