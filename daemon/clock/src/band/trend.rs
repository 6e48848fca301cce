//! The point estimate of the offset within the band, and its rate.
//!
//! The estimate keeps the lowest upper and the highest lower point of each second, after the skew is removed. It uses
//! the points of about twenty seconds around the time of the query. The skew is the mean slope of two lines, one below
//! all upper points and the other above all lower points. After the skew is removed, the remaining drift is a wander
//! that is much slower than the limit of drift, so that the band of these points is much narrower. The estimate is the
//! middle of this narrow band. The estimate is right only if the shortest delays of both directions are equal. This
//! cannot be verified, and the bounds do not rely on it.
//!
//! The points that `slots` keeps are unsuitable for the estimate. A slot keeps the point that bounds later times best.
//! If the clocks drift apart at the limit, this is the first or the last point of the slot, whatever its delay.

use std::sync::OnceLock;

use super::best_points::{BestPoints, InsertResult};
use super::hull;
use super::skew::SkewBounds;
use super::slots::Point;

const SECOND: i64 = 1_000_000_000;
/// Maximum number of seconds of which points are kept.
const MAX_SECONDS: usize = 1024;
/// Number of seconds with exchanges that an estimate uses.
// More seconds make the estimate steadier under load; fewer seconds follow a wandering clock faster.
const ESTIMATE_SECONDS: usize = 20;
/// Number of seconds with exchanges that the reported skew uses.
const SKEW_SECONDS: usize = 120;
/// A point is used only for queries about times at most this far from the point.
const MAX_DISTANCE_NANOS: i64 = 120 * SECOND;
/// Assumed wander of clocks around their skew, seconds per second.
// Crystals wander far less, even at changing temperature.
const MAX_WANDER: f64 = 2e-6;
/// Minimum number of exchanges from which a skew is computed.
const MIN_EXCHANGES_FOR_SKEW: u64 = 8;
/// Shortest time between the first and the last exchange from which a skew is computed.
const MIN_EXCHANGE_RANGE_NANOS: i64 = 5 * SECOND;

/// The lowest upper and the highest lower point of each second, and the skew that follows from them.
#[derive(Clone, Debug)]
pub(super) struct Trend {
    upper: BestPoints,
    /// Lower bounds with the opposite sign.
    lower: BestPoints,
    /// Skew of the offset as of the newest second. Points of one second are compared after this skew is removed.
    slope: f64,
    /// Cached slope of the newest [`ESTIMATE_SECONDS`] seconds, until one of their points changes.
    // Most queries are about the present, and most exchanges change no point.
    newest_slope: OnceLock<Option<f64>>,
    /// Times of the first and the last exchange, nanoseconds.
    time_range: Option<(i64, i64)>,
    exchange_count: u64,
    skew_bounds: SkewBounds,
}

impl Default for Trend {
    fn default() -> Self {
        let no_points = || BestPoints::new(SECOND, MAX_SECONDS);
        Self {
            upper: no_points(),
            lower: no_points(),
            slope: 0.0,
            newest_slope: OnceLock::new(),
            time_range: None,
            exchange_count: 0,
            skew_bounds: SkewBounds::default(),
        }
    }
}

impl Trend {
    /// Inserts the two points of an exchange. `limit` is the largest slope that the offset can have, seconds per
    /// second.
    pub(super) fn insert(&mut self, upper: Point, lower: Point, limit: f64) {
        // The upper point is at the time at which the exchange was sent, the lower point at the later time at which it
        // returned.
        let (first, last) = self.time_range.unwrap_or((upper.x, lower.x));
        self.time_range = Some((first.min(upper.x), last.max(lower.x)));
        self.exchange_count += 1;
        self.skew_bounds.insert(upper, lower, self.slope);
        let results = [self.upper.insert(upper, self.slope), self.lower.insert(lower, -self.slope)];
        if results != [InsertResult::Worse; 2] {
            self.newest_slope.take();
        }
        // The slope is updated once per second. This is enough, because the skew changes slowly.
        if results.contains(&InsertResult::First) {
            self.slope = self.slope(lower.x, ESTIMATE_SECONDS, limit).unwrap_or(0.0);
        }
    }

    /// Returns the estimate at a time in nanoseconds; `None` without enough exchanges.
    ///
    /// If the clocks wander faster than assumed, the narrow band is empty. The estimate then uses half of the seconds;
    /// if that band is empty, too, a quarter of the seconds.
    pub(super) fn estimate_at(&self, x: i64, limit: f64) -> Option<i64> {
        [ESTIMATE_SECONDS, ESTIMATE_SECONDS / 2, ESTIMATE_SECONDS / 4].into_iter().find_map(|seconds| {
            let slope = self.slope(x, seconds, limit)?;
            let above = lowest_bound(&self.upper, x, seconds, slope)?;
            let below = lowest_bound(&self.lower, x, seconds, -slope)?;
            // `below` has the opposite sign, as in `self.lower`. If the sum is below 0, the narrow band is empty.
            (above.saturating_add(below) >= 0).then(|| above.saturating_sub(below) / 2)
        })
    }

    /// Returns the rate of the offset around a time in seconds per second.
    pub(super) fn slope_at(&self, x: i64, limit: f64) -> Option<f64> {
        self.slope(x, ESTIMATE_SECONDS, limit)
    }

    /// Returns the rate of the offset over the latest exchanges in seconds per second. No limit applies, so clocks
    /// that exceed the limit are visible.
    pub(super) fn skew(&self) -> Option<f64> {
        self.slope(self.time_range?.1, SKEW_SECONDS, f64::INFINITY)
    }

    /// Returns the points that bound the skew whatever the delays were.
    pub(super) fn skew_bounds(&self) -> &SkewBounds {
        &self.skew_bounds
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.upper.memory_bytes() + self.lower.memory_bytes() + self.skew_bounds.memory_bytes()
    }

    /// Returns the rate of the offset in seconds per second, from the points of the `seconds` seconds nearest to `x`.
    /// `None` without enough exchanges.
    fn slope(&self, x: i64, seconds: usize, limit: f64) -> Option<f64> {
        let (first, last) = self.time_range?;
        if self.exchange_count < MIN_EXCHANGES_FOR_SKEW
            || last.saturating_sub(first) < MIN_EXCHANGE_RANGE_NANOS
        {
            return None;
        }
        let compute = || {
            let above = hull::slope_below(nearest_points(&self.upper, x, seconds))?;
            let below = hull::slope_below(nearest_points(&self.lower, x, seconds))?;
            Some((above - below) / 2.0)
        };
        let are_newest =
            |points: &BestPoints| points.newest_points_are_around(x, seconds, MAX_DISTANCE_NANOS as u64);
        let slope = if seconds == ESTIMATE_SECONDS && are_newest(&self.upper) && are_newest(&self.lower) {
            *self.newest_slope.get_or_init(compute)
        } else {
            compute()
        };
        // A steeper slope is noise of the delays, because the clocks cannot drift so fast.
        Some(slope?.clamp(-limit, limit))
    }
}

/// Returns the lowest bound at `x` that the points around `x` give, if the skew is `slope` and clocks wander around
/// this skew by at most [`MAX_WANDER`].
fn lowest_bound(points: &BestPoints, x: i64, seconds: usize, slope: f64) -> Option<i64> {
    let bound_at = |point: Point| {
        let distance = x.saturating_sub(point.x) as f64;
        point.bound.saturating_add((slope * distance + MAX_WANDER * distance.abs()).round() as i64)
    };
    nearest_points(points, x, seconds).map(bound_at).min()
}

/// Returns the points of the seconds nearest to `x`: half of the points before `x` and half after `x`, if enough exist.
fn nearest_points(points: &BestPoints, x: i64, seconds: usize) -> impl Iterator<Item = Point> + '_ {
    points.points_around(x, seconds).filter(move |point| point.x.abs_diff(x) <= MAX_DISTANCE_NANOS as u64)
}
