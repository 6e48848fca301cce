//! The offset of two wall clocks as a band over time: everything that exchanges say, and nothing that they do not.
//!
//! The offset θ(x) is the cloud's wall clock minus the edge's when the edge's shows x. Each exchange bounds it from
//! above at the time it was sent and from below at the time it returned; a limited drift carries both to other times.

mod drift;
mod hull;
mod side;
#[cfg(test)]
mod tests;
mod trend;

pub(crate) use drift::DriftLimit;
use side::{Point, Side};
use trend::Trend;

use crate::{Exchange, Interval, Span, WallTime};

/// Most points that each side keeps.
const CAPACITY: usize = 16_384;

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
        let point = |x: WallTime, bound: Span| Point {
            x: x.unix_nanos(),
            bound: bound.nanos().saturating_add(RESOLUTION),
        };
        Self {
            upper: point(exchange.sent, exchange.upper()),
            lower: point(exchange.returned, -exchange.lower()),
        }
    }
}

impl Bounds {
    /// When the exchange began, by the edge's wall clock: no two begin at once.
    pub(crate) fn sent(&self) -> WallTime {
        WallTime::from_unix_nanos(self.upper.x)
    }
}

/// All exchanges of a window.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    drift: DriftLimit,
    window: i64,
    upper: Side,
    /// With the sign turned.
    lower: Side,
    trend: Trend,
    newest: i64,
    exchanges: u64,
}

impl Band {
    /// A band that knows nothing.
    pub(crate) fn new(drift: DriftLimit, window: Span) -> Self {
        Self::with_capacity(drift, window, CAPACITY)
    }

    fn with_capacity(drift: DriftLimit, window: Span, capacity: usize) -> Self {
        let window = window.nanos().max(0);
        let side = || Side::new(drift, window, capacity);
        Self {
            drift,
            window,
            upper: side(),
            lower: side(),
            trend: Trend::default(),
            newest: i64::MIN,
            exchanges: 0,
        }
    }

    /// Whether no offset fits both the exchange and the band.
    ///
    /// As long as each exchange is asked before it is taken, the band is nowhere empty: hi(q) < lo(q) would mean
    /// U + w(|q − x|) < L − w(|q − y|), hence U < L − w(|x − y|) for two exchanges, and the later would have been found out.
    pub(crate) fn excludes(&self, bounds: &Bounds) -> bool {
        let below =
            |bound: i64, other: Option<i64>| other.is_some_and(|other| bound < other.saturating_neg());
        below(bounds.upper.bound, self.lower.bound(bounds.upper.x))
            || below(bounds.lower.bound, self.upper.bound(bounds.lower.x))
    }

    /// Takes an exchange. No interval within the window gets wider by it.
    pub(crate) fn insert(&mut self, bounds: &Bounds) {
        self.newest = self.newest.max(bounds.lower.x);
        let start = self.newest.saturating_sub(self.window);
        for (side, point) in [(&mut self.upper, bounds.upper), (&mut self.lower, bounds.lower)] {
            side.expire(start);
            side.insert(point);
            side.expire(start);
        }
        self.exchanges += 1;
        self.trend.insert(bounds.upper, bounds.lower, self.drift.slope());
    }

    /// The interval at a time; `None` without an exchange.
    pub(crate) fn interval(&self, at: WallTime) -> Option<Interval> {
        let q = at.unix_nanos();
        let (hi, lo) = (self.upper.bound(q)?, self.lower.bound(q)?.saturating_neg());
        Some(Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) })
    }

    /// The best guess at a time, within `interval` (which is the band's at that time).
    pub(crate) fn estimate(&self, at: WallTime, interval: Interval) -> Span {
        let guess =
            self.trend.at(at.unix_nanos(), self.drift.slope()).unwrap_or_else(|| interval.middle().nanos());
        Span::from_nanos(guess).clamp(interval.lo, interval.hi)
    }

    /// By how much the offset most likely grows from one time to another one near.
    pub(crate) fn growth(&self, from: WallTime, to: WallTime) -> Span {
        let slope = self.trend.slope_at(from.unix_nanos(), self.drift.slope()).unwrap_or(0.0);
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

    /// When the newest exchange returned, by the edge's wall clock.
    pub(crate) fn newest(&self) -> Option<WallTime> {
        (self.exchanges > 0).then(|| WallTime::from_unix_nanos(self.newest))
    }

    pub(crate) fn memory_bytes(&self) -> usize {
        self.upper.memory_bytes() + self.lower.memory_bytes() + self.trend.memory_bytes()
    }
}
