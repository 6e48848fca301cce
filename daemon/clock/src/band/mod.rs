//! The offset of two clocks as a band over time: everything that exchanges say, and nothing that they do not.
//!
//! The offset θ(x) is the cloud's clock minus the edge's when the edge's shows x. Each exchange bounds it from
//! above at the time it was sent and from below at the time it returned; a limited drift carries both to other times.

mod drift;
mod hull;
mod slots;
#[cfg(test)]
mod tests;
mod trend;

use std::collections::VecDeque;

pub(crate) use drift::DriftLimit;
use slots::{Point, Slots, lowest};
use trend::Trend;

use crate::{Exchange, Interval, RawTime, Span};

/// The newest exchanges count however old they are: where they are rarer than this many in a window, the window reaches
/// back to them.
const LEAST_EXCHANGES: usize = 8;

/// Stamps are cut or rounded to whole nanoseconds, the two of a bound each by less than one.
const RESOLUTION: i64 = 2;

/// What one exchange says.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    upper: Point,
    /// With the sign turned.
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

/// What the exchanges of a window prove.
///
/// An exchange bounds the offset at times no further from it than the window, so that a clock which breaks the limit of
/// drift, or jumps without notice, spoils no interval for longer than that.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    drift: DriftLimit,
    window: i64,
    retention: i64,
    upper: Slots,
    /// With the sign turned.
    lower: Slots,
    /// The newest exchanges, by the time that they returned.
    latest: VecDeque<Bounds>,
    trend: Trend,
    newest: i64,
    exchanges: u64,
}

impl Band {
    /// A band that knows nothing. Exchanges are kept for `retention`, at least as long as the window, for questions about the past.
    pub(crate) fn new(drift: DriftLimit, window: Span, retention: Span) -> Self {
        let window = window.nanos().max(0);
        let retention = retention.nanos().max(window);
        Self {
            drift,
            window,
            retention,
            upper: Slots::new(drift, retention),
            lower: Slots::new(drift, retention),
            latest: VecDeque::with_capacity(LEAST_EXCHANGES + 1),
            trend: Trend::default(),
            newest: i64::MIN,
            exchanges: 0,
        }
    }

    /// Whether no offset fits both the exchange and all that is kept.
    ///
    /// As long as each exchange is asked before it is taken, the band is nowhere empty: hi(q) < lo(q) would mean
    /// U + w(|q − x|) < L − w(|q − y|), hence U < L − w(|x − y|) for two exchanges that are kept at once, and the later would
    /// have been found out. For that, all that is kept is asked here, not only what is within the window.
    pub(crate) fn excludes(&self, bounds: &Bounds) -> bool {
        let Bounds { upper, lower } = *bounds;
        let (most, least) = (lower.bound.saturating_neg(), upper.bound.saturating_neg());
        self.lower.is_below(least, upper.x)
            || self.upper.is_below(most, lower.x)
            || self.latest.iter().any(|other| {
                other.lower.is_below(least, self.drift, upper.x)
                    || other.upper.is_below(most, self.drift, lower.x)
            })
    }

    /// Takes an exchange, and drops what is too old by now.
    pub(crate) fn insert(&mut self, bounds: &Bounds) {
        self.newest = self.newest.max(bounds.lower.x);
        let start = self.newest.saturating_sub(self.retention);
        for (slots, point) in [(&mut self.upper, bounds.upper), (&mut self.lower, bounds.lower)] {
            slots.insert(point);
            slots.expire(start);
        }
        let at = self.latest.partition_point(|other| other.lower.x <= bounds.lower.x);
        self.latest.insert(at, *bounds);
        if self.latest.len() > LEAST_EXCHANGES {
            self.latest.pop_front();
        }
        self.exchanges += 1;
        self.trend.insert(bounds.upper, bounds.lower, self.drift.slope());
    }

    /// The interval at a time; `None` without an exchange.
    pub(crate) fn interval(&self, at: RawTime) -> Option<Interval> {
        let q = at.nanos();
        let (hi, lo) = (self.above(q)?, self.below(q)?.saturating_neg());
        Some(Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) })
    }

    /// The upper bound at a time, by what is within the window of it, and by the latest exchanges.
    fn above(&self, q: i64) -> Option<i64> {
        let latest = lowest(self.latest.iter().map(|bounds| bounds.upper), self.drift, q);
        self.upper.bound(q, self.window).into_iter().chain(latest).min()
    }

    /// The lower bound at a time, with the sign turned.
    fn below(&self, q: i64) -> Option<i64> {
        let latest = lowest(self.latest.iter().map(|bounds| bounds.lower), self.drift, q);
        self.lower.bound(q, self.window).into_iter().chain(latest).min()
    }

    /// The best guess at a time, within `interval` (which is the band's at that time).
    pub(crate) fn estimate(&self, at: RawTime, interval: Interval) -> Span {
        let guess =
            self.trend.at(at.nanos(), self.drift.slope()).unwrap_or_else(|| interval.middle().nanos());
        Span::from_nanos(guess).clamp(interval.lo, interval.hi)
    }

    /// By how much the offset most likely grows from one time to another one near.
    pub(crate) fn growth(&self, from: RawTime, to: RawTime) -> Span {
        let slope = self.trend.slope_at(from.nanos(), self.drift.slope()).unwrap_or(0.0);
        Span::from_nanos((slope * (to - from).nanos() as f64).round() as i64)
    }

    /// How fast the offset grows, parts per million; `None` before there are enough exchanges.
    pub(crate) fn skew_ppm(&self) -> Option<f64> {
        self.trend.skew(self.drift.slope()).map(|slope| slope * 1e6)
    }

    /// Exchanges taken.
    pub(crate) fn exchanges(&self) -> u64 {
        self.exchanges
    }

    /// When the newest exchange returned, by the edge's clock.
    pub(crate) fn newest(&self) -> Option<RawTime> {
        (self.exchanges > 0).then(|| RawTime::from_nanos(self.newest))
    }

    pub(crate) fn memory_bytes(&self) -> usize {
        self.upper.memory_bytes()
            + self.lower.memory_bytes()
            + self.latest.capacity() * size_of::<Bounds>()
            + self.trend.memory_bytes()
    }
}
