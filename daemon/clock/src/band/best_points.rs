//! The best point of each stretch of time, with the skew taken out.

use std::collections::VecDeque;

use super::slots::Point;

/// The lowest point of each stretch, by time.
#[derive(Clone, Debug)]
pub(super) struct BestPoints {
    /// Length of a stretch, nanoseconds.
    stretch: i64,
    most: usize,
    points: VecDeque<Point>,
}

impl BestPoints {
    /// Of the newest `most` stretches.
    pub(super) fn new(stretch: i64, most: usize) -> Self {
        Self { stretch, most, points: VecDeque::new() }
    }

    /// Takes a point if it is the best of its stretch for a skew. Returns whether it is the first.
    pub(super) fn insert(&mut self, point: Point, slope: f64) -> bool {
        let stretch = |point: &Point| point.x.div_euclid(self.stretch);
        let at = match self.points.back() {
            Some(last) if stretch(last) >= stretch(&point) => {
                self.points.partition_point(|other| stretch(other) < stretch(&point))
            }
            _ => self.points.len(),
        };
        if let Some(known) = self.points.get(at).filter(|known| stretch(known) == stretch(&point)) {
            let drifted = known.bound.saturating_add((slope * (point.x - known.x) as f64) as i64);
            if point.bound < drifted {
                self.points[at] = point;
            }
            return false;
        }
        if self.points.len() >= self.most {
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

    /// All, by time.
    pub(super) fn iter(&self) -> impl Iterator<Item = Point> + '_ {
        self.points.iter().copied()
    }

    /// So many that are nearest to a time, half of them before and half after it where there are so many.
    pub(super) fn around(&self, x: i64, count: usize) -> impl Iterator<Item = Point> + '_ {
        let after = self.points.partition_point(|point| point.x < x);
        let end = after.saturating_add(count / 2).max(count).min(self.points.len());
        self.points.range(end.saturating_sub(count)..end).copied()
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
    fn seconds_stay_in_order_and_few_in_whatever_order_they_come() {
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
    fn the_best_of_a_second_is_the_lowest_with_the_skew_taken_out() {
        let mut seconds = BestPoints::new(SECOND, 1024);
        assert!(seconds.insert(Point { x: 0, bound: 100 }, 50e-6));
        assert!(!seconds.insert(Point { x: 10_000_000, bound: 400 }, 50e-6));
        assert_eq!(seconds.points[0].bound, 400);
        assert!(!seconds.insert(Point { x: 20_000_000, bound: 901 }, 50e-6));
        assert_eq!(seconds.points[0].bound, 400);
    }
}
