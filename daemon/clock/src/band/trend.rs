//! The point estimate: where in the band the offset most likely is, and how fast it moves.
//!
//! The slots are not made for it: the best point of a slot is the one that bounds later times best, and two clocks that drift
//! apart at the very limit make that the earliest or the latest of all. Instead each second keeps its best point on either side. The skew is the mean of the slopes of two lines, one
//! laid under all upper points, one over all lower ones, of some twenty seconds around the time in question. With the
//! skew taken out, what is left of the drift is a wander, much slower than the limit, and the band of those points
//! is much narrower; the offset is taken to be in its middle. That takes the shortest delays of both directions to be
//! alike, which nobody can know and the bounds do not rely on.

use std::sync::OnceLock;

use super::best_points::{BestPoints, Placement};
use super::hull;
use super::skew::SkewProof;
use super::slots::Point;

const SECOND: i64 = 1_000_000_000;
/// Most seconds that are kept.
const SECONDS: usize = 1024;
/// Seconds with exchanges that count. More make it steadier under load, fewer follow a wandering clock.
const FOR_ESTIMATE: usize = 20;
/// For the skew: it is only reported.
const FOR_SKEW: usize = 120;
/// Seconds with exchanges further than this from the time in question say nothing of it.
const REACH: i64 = 120 * SECOND;
/// How fast clocks wander around their skew: crystals at changing temperature, by far less.
const WANDER: f64 = 2e-6;
/// Fewer exchanges or a shorter time tell nothing of the skew.
const LEAST_EXCHANGES: u64 = 8;
const LEAST_TIME: i64 = 5 * SECOND;

/// The best points of each second.
#[derive(Clone, Debug)]
pub(super) struct Trend {
    upper: BestPoints,
    /// With the sign turned.
    lower: BestPoints,
    /// Of the offset, as of the last new second: a later point is better when it is lower than the drift explains.
    slope: f64,
    /// Of the newest [`FOR_ESTIMATE`] seconds, once it was asked for and until one of their points is another: most questions are about
    /// now, and most exchanges change no point.
    newest_slope: OnceLock<Option<f64>>,
    span: Option<(i64, i64)>,
    exchanges: u64,
    proof: SkewProof,
}

impl Default for Trend {
    fn default() -> Self {
        let best = || BestPoints::new(SECOND, SECONDS);
        Self {
            upper: best(),
            lower: best(),
            slope: 0.0,
            newest_slope: OnceLock::new(),
            span: None,
            exchanges: 0,
            proof: SkewProof::default(),
        }
    }
}

impl Trend {
    /// Takes an exchange; `limit` is the steepest slope there can be.
    pub(super) fn insert(&mut self, upper: Point, lower: Point, limit: f64) {
        let (first, last) = self.span.unwrap_or((upper.x, lower.x));
        self.span = Some((first.min(upper.x), last.max(lower.x)));
        self.exchanges += 1;
        self.proof.insert(upper, lower, self.slope);
        let placed = [self.upper.insert(upper, self.slope), self.lower.insert(lower, -self.slope)];
        if placed != [Placement::Worse; 2] {
            self.newest_slope.take();
        }
        if placed.contains(&Placement::First) {
            self.slope = self.slope(lower.x, FOR_ESTIMATE, limit).unwrap_or(0.0);
        }
    }

    /// The estimate at a time, nanoseconds; `None` before there are enough exchanges.
    ///
    /// Where the narrow band is empty the clocks wander faster than was taken for granted: fewer seconds are asked, down
    /// to a quarter.
    pub(super) fn at(&self, x: i64, limit: f64) -> Option<i64> {
        [FOR_ESTIMATE, FOR_ESTIMATE / 2, FOR_ESTIMATE / 4].into_iter().find_map(|seconds| {
            let slope = self.slope(x, seconds, limit)?;
            let above = lowest(&self.upper, x, seconds, slope)?;
            let below = lowest(&self.lower, x, seconds, -slope)?;
            (above.saturating_add(below) >= 0).then(|| above.saturating_sub(below) / 2)
        })
    }

    /// How fast the offset grows around a time, seconds per second.
    pub(super) fn slope_at(&self, x: i64, limit: f64) -> Option<f64> {
        self.slope(x, FOR_ESTIMATE, limit)
    }

    /// How fast the offset grows, seconds per second, over the latest exchanges; no limit is put on it, so that clocks which do not
    /// keep theirs are seen.
    pub(super) fn skew(&self) -> Option<f64> {
        self.slope(self.span?.1, FOR_SKEW, f64::INFINITY)
    }

    /// What the exchanges prove of the skew.
    pub(super) fn proof(&self) -> &SkewProof {
        &self.proof
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.upper.memory_bytes() + self.lower.memory_bytes() + self.proof.memory_bytes()
    }

    fn slope(&self, x: i64, seconds: usize, limit: f64) -> Option<f64> {
        let (first, last) = self.span?;
        if self.exchanges < LEAST_EXCHANGES || last.saturating_sub(first) < LEAST_TIME {
            return None;
        }
        let between = || {
            let above = hull::slope_under(around(&self.upper, x, seconds))?;
            let below = hull::slope_under(around(&self.lower, x, seconds))?;
            Some((above - below) / 2.0)
        };
        let are_newest = |points: &BestPoints| points.are_newest_around(x, seconds, REACH as u64);
        let slope = if seconds == FOR_ESTIMATE && are_newest(&self.upper) && are_newest(&self.lower) {
            *self.newest_slope.get_or_init(between)
        } else {
            between()
        };
        Some(slope?.clamp(-limit, limit))
    }
}

/// The bound at a time by the points around it, for a known skew and a wander around it.
fn lowest(points: &BestPoints, x: i64, seconds: usize, slope: f64) -> Option<i64> {
    let carried = |point: Point| {
        let away = x.saturating_sub(point.x) as f64;
        point.bound.saturating_add((slope * away + WANDER * away.abs()).round() as i64)
    };
    around(points, x, seconds).map(carried).min()
}

/// The points of the nearest seconds, half of them before and half after where there are so many.
fn around(points: &BestPoints, x: i64, seconds: usize) -> impl Iterator<Item = Point> + '_ {
    points.around(x, seconds).filter(move |point| point.x.abs_diff(x) <= REACH as u64)
}
