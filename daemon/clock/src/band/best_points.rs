//! The lowest point of each interval of time. Points of one interval are compared after the skew is removed from them.

use std::collections::VecDeque;

use super::slots::Point;

/// Result of the insertion of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum InsertResult {
    /// The point was not inserted: its interval has a better point or is too old.
    Worse,
    /// The point replaced an earlier point of its interval.
    Better,
    /// The point is the first of its interval.
    First,
}

/// The lowest point of each interval, in the order of time.
#[derive(Clone, Debug)]
pub(super) struct BestPoints {
    /// Length of an interval, nanoseconds.
    interval: i64,
    max_points: usize,
    points: VecDeque<Point>,
}

impl BestPoints {
    /// Creates an empty set that keeps the points of the newest `max_points` intervals of `interval` nanoseconds.
    pub(super) fn new(interval: i64, max_points: usize) -> Self {
        Self { interval, max_points, points: VecDeque::new() }
    }

    /// Inserts a point if it is the lowest point of its interval after the skew is removed. `slope` is the skew in
    /// seconds per second.
    pub(super) fn insert(&mut self, point: Point, slope: f64) -> InsertResult {
        let interval_number = point.x.div_euclid(self.interval);
        let interval_of = |point: &Point| point.x.div_euclid(self.interval);
        let index = match self.points.back().map(interval_of) {
            // Most points belong to the newest interval.
            Some(last) if last == interval_number => self.points.len() - 1,
            Some(last) if last > interval_number => {
                self.points.partition_point(|other| interval_of(other) < interval_number)
            }
            _ => self.points.len(),
        };
        if let Some(best) =
            self.points.get(index).copied().filter(|point| interval_of(point) == interval_number)
        {
            // If the skew were not removed, the lowest point would always be the earliest or the latest of its
            // interval.
            let expected_bound = best.bound.saturating_add((slope * (point.x - best.x) as f64) as i64);
            if point.bound >= expected_bound {
                return InsertResult::Worse;
            }
            self.points[index] = point;
            return InsertResult::Better;
        }
        if self.points.len() >= self.max_points {
            if index == 0 {
                // The interval is older than the intervals of all other points.
                return InsertResult::Worse;
            }
            self.points.pop_front();
            self.points.insert(index - 1, point);
        } else {
            self.points.insert(index, point);
        }
        InsertResult::First
    }

    /// Returns all points in the order of time.
    pub(super) fn iter(&self) -> impl Iterator<Item = Point> + '_ {
        self.points.iter().copied()
    }

    /// Returns `count` points around `x`: half of them before `x` and half after `x`. If there are too few points on
    /// one side, more points of the other side are returned instead.
    pub(super) fn points_around(&self, x: i64, count: usize) -> impl Iterator<Item = Point> + '_ {
        let first_at_or_after = self.points.partition_point(|point| point.x < x);
        let end = first_at_or_after.saturating_add(count / 2).max(count).min(self.points.len());
        self.points.range(end.saturating_sub(count)..end).copied()
    }

    /// Returns `true` if [`points_around`](Self::points_around) returns the newest points for `x` and all of these
    /// points lie within `reach` of `x`.
    pub(super) fn newest_points_are_around(&self, x: i64, count: usize, reach: u64) -> bool {
        let len = self.points.len();
        // `points_around` returns the newest `count` points if at most `count / 2` of all points are at or after `x`.
        // This is the case if the point just before the newest `count / 2` points is before `x`.
        let (oldest, middle) = (len.saturating_sub(count), len.saturating_sub(count / 2 + 1));
        let is_near = |index: usize| self.points.get(index).is_some_and(|point| point.x.abs_diff(x) <= reach);
        let x_is_after_middle = len <= count || self.points.get(middle).is_some_and(|point| point.x < x);
        x_is_after_middle && is_near(oldest) && is_near(len.saturating_sub(1))
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.points.capacity() * size_of::<Point>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    #[test]
    fn points_stay_sorted_and_few_in_any_order() {
        let mut seconds = BestPoints::new(SECOND, 1024);
        for n in 0..3_000i64 {
            let x = (n * 7919 % 3_000) * SECOND + n;
            seconds.insert(Point { x, bound: 0 }, 0.0);
            assert!(seconds.points.len() <= 1024);
            assert!(n % 100 != 0 || seconds.points.iter().is_sorted_by_key(|point| point.x));
        }
        assert!(seconds.points.iter().is_sorted_by_key(|point| point.x));
    }

    #[test]
    fn best_point_is_lowest_after_skew_is_removed() {
        let mut seconds = BestPoints::new(SECOND, 1024);
        let mut insert = |x: i64, bound: i64| seconds.insert(Point { x, bound }, 50e-6);
        assert_eq!(insert(0, 100), InsertResult::First);
        assert_eq!(insert(10_000_000, 400), InsertResult::Better);
        assert_eq!(insert(20_000_000, 901), InsertResult::Worse);
        assert_eq!(seconds.points[0].bound, 400);
    }

    #[test]
    fn newest_points_are_around_agrees_with_points() {
        let mut seconds = BestPoints::new(SECOND, 1024);
        for n in [0, 1, 2, 3, 10, 11, 12, 40] {
            seconds.insert(Point { x: n * SECOND, bound: 0 }, 0.0);
            for (x, count) in (0..60).flat_map(|x| [(x, 2), (x, 4), (x, 6)]) {
                let x = x * SECOND;
                let around: Vec<Point> = seconds.points_around(x, count).collect();
                let newest: Vec<Point> =
                    seconds.iter().skip(seconds.points.len().saturating_sub(count)).collect();
                let are_near = around.iter().all(|point| point.x.abs_diff(x) <= 20 * SECOND as u64);
                let expected = around == newest && are_near;
                assert_eq!(
                    seconds.newest_points_are_around(x, count, 20 * SECOND as u64),
                    expected,
                    "{x} {count}"
                );
            }
        }
    }
}
