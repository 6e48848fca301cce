//! The point estimate: where in the band the offset most likely is, and how fast it moves.
//!
//! The slots are not made for it: the best point of a slot is the one that bounds later times best, and two clocks that drift
//! apart at the very limit make that the earliest or the latest of all. Instead each second keeps its best point on either side. The skew is the mean of the slopes of two lines, one
//! laid under all upper points, one over all lower ones, of some twenty seconds around the time in question. With the
//! skew taken out, what is left of the drift is a wander, much slower than the limit, and the band of those points
//! is much narrower; the offset is taken to be in its middle. That takes the shortest delays of both directions to be
//! alike, which nobody can know and the bounds do not rely on.

use std::collections::VecDeque;

use super::hull;
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
#[derive(Clone, Debug, Default)]
pub(super) struct Trend {
    upper: Seconds,
    /// With the sign turned.
    lower: Seconds,
    /// Of the offset, as of the last new second: a later point is better when it is lower than the drift explains.
    slope: f64,
    span: Option<(i64, i64)>,
    exchanges: u64,
}

impl Trend {
    /// Takes an exchange; `limit` is the steepest slope there can be.
    pub(super) fn insert(&mut self, upper: Point, lower: Point, limit: f64) {
        let (first, last) = self.span.unwrap_or((upper.x, lower.x));
        self.span = Some((first.min(upper.x), last.max(lower.x)));
        self.exchanges += 1;
        let begun = [self.upper.insert(upper, self.slope), self.lower.insert(lower, -self.slope)];
        if begun.contains(&true) {
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
            let above = self.upper.lowest(x, seconds, slope)?;
            let below = self.lower.lowest(x, seconds, -slope)?;
            (above.saturating_add(below) >= 0).then(|| above.saturating_sub(below) / 2)
        })
    }

    /// How fast the offset grows around a time, seconds per second.
    pub(super) fn slope_at(&self, x: i64, limit: f64) -> Option<f64> {
        self.slope(x, FOR_ESTIMATE, limit)
    }

    /// How fast the offset grows, seconds per second, over the latest exchanges.
    pub(super) fn skew(&self, limit: f64) -> Option<f64> {
        self.slope(self.span?.1, FOR_SKEW, limit)
    }

    pub(super) fn memory_bytes(&self) -> usize {
        (self.upper.points.capacity() + self.lower.points.capacity()) * size_of::<Point>()
    }

    fn slope(&self, x: i64, seconds: usize, limit: f64) -> Option<f64> {
        let (first, last) = self.span?;
        if self.exchanges < LEAST_EXCHANGES || last.saturating_sub(first) < LEAST_TIME {
            return None;
        }
        let above = hull::slope_under(self.upper.around(x, seconds))?;
        let below = hull::slope_under(self.lower.around(x, seconds))?;
        Some(((above - below) / 2.0).clamp(-limit, limit))
    }
}

/// The lowest point of each second, by time.
#[derive(Clone, Debug, Default)]
struct Seconds {
    points: VecDeque<Point>,
}

impl Seconds {
    /// Whether it is the first of its second.
    fn insert(&mut self, point: Point, slope: f64) -> bool {
        let second = |point: &Point| point.x.div_euclid(SECOND);
        let at = match self.points.back() {
            Some(last) if second(last) >= second(&point) => {
                self.points.partition_point(|other| second(other) < second(&point))
            }
            _ => self.points.len(),
        };
        if let Some(known) = self.points.get_mut(at).filter(|known| second(known) == second(&point)) {
            let drifted = known.bound.saturating_add((slope * (point.x - known.x) as f64) as i64);
            if point.bound < drifted {
                *known = point;
            }
            return false;
        }
        if self.points.len() >= SECONDS {
            if at == 0 {
                return false;
            }
            self.points.pop_front();
            self.points.insert(at - 1, point);
        } else {
            self.points.insert(at, point);
        }
        true
    }

    /// The bound at a time by the points around it, for a known skew and a wander around it.
    fn lowest(&self, x: i64, seconds: usize, slope: f64) -> Option<i64> {
        let carried = |point: Point| {
            let away = x.saturating_sub(point.x) as f64;
            point.bound.saturating_add((slope * away + WANDER * away.abs()).round() as i64)
        };
        self.around(x, seconds).map(carried).min()
    }

    /// The points of the nearest seconds, half of them before and half after where there are so many.
    fn around(&self, x: i64, seconds: usize) -> impl Iterator<Item = Point> + '_ {
        let after = self.points.partition_point(|point| point.x < x);
        let end = after.saturating_add(seconds / 2).max(seconds).min(self.points.len());
        let near = move |point: &Point| point.x.abs_diff(x) <= REACH as u64;
        self.points.range(end.saturating_sub(seconds)..end).copied().filter(near)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_stay_in_order_and_few_in_whatever_order_they_come() {
        let mut seconds = Seconds::default();
        for n in 0..3_000i64 {
            let x = (n * 7919 % 3_000) * SECOND + n;
            seconds.insert(Point { x, bound: 0 }, 0.0);
            assert!(seconds.points.len() <= SECONDS);
            assert!(n % 100 != 0 || seconds.points.iter().is_sorted_by_key(|point| point.x));
        }
        assert!(seconds.points.iter().is_sorted_by_key(|point| point.x));
    }

    #[test]
    fn the_best_of_a_second_is_the_lowest_with_the_skew_taken_out() {
        let mut seconds = Seconds::default();
        assert!(seconds.insert(Point { x: 0, bound: 100 }, 50e-6));
        assert!(!seconds.insert(Point { x: 10_000_000, bound: 400 }, 50e-6));
        assert_eq!(seconds.points[0].bound, 400);
        assert!(!seconds.insert(Point { x: 20_000_000, bound: 901 }, 50e-6));
        assert_eq!(seconds.points[0].bound, 400);
    }
}
