//! One side of the band: of everything that bounds the offset from above, the best of each short stretch of time.
//!
//! A point (x, U) says that the offset is at most U at the edge's time x. Because it drifts no faster than ρ, it is at
//! most U + w(|q − x|) at any time q, where w(d) is ρ·d rounded up: a cone that opens upwards. The bound at q is the
//! lowest of all cones. Bounds from below are the same with the sign turned.
//!
//! Of each slot one point is kept, the one whose cone is the lowest at the later of two times. By
//! w(a + b) ≥ w(a) + w(b) − 1 it is, to a nanosecond, the lowest at every time after the slot, too: a question about now gets
//! the answer that all exchanges together give; only at the far end of the window the last slot goes as a whole. A question about a time within the slot may lose ρ × twice its length. Any
//! subset of true bounds is true, so thinning never makes an interval wrong.

use std::collections::VecDeque;

use super::drift::DriftLimit;

/// The usual length of a slot, nanoseconds: 20 slots in the default window.
const LENGTH: i64 = 500_000_000;
/// Longer times have no more slots than this, but longer ones.
const MOST: i64 = 1_200;

/// A bound of the offset that holds exactly at one time; nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Point {
    pub(super) x: i64,
    pub(super) bound: i64,
}

impl Point {
    /// What it says of another time.
    #[inline]
    pub(super) fn carried(self, drift: DriftLimit, q: i64) -> i64 {
        self.bound.saturating_add(drift.between(self.x, q))
    }

    /// Whether its cone at `q` is lower than a bound: mostly its tip is not, which costs less to see.
    #[inline]
    pub(super) fn is_below(self, bound: i64, drift: DriftLimit, q: i64) -> bool {
        self.bound < bound && self.carried(drift, q) < bound
    }
}

/// The lowest cone at `q`; `None` without any point.
#[inline]
pub(super) fn lowest(
    points: impl DoubleEndedIterator<Item = Point>,
    drift: DriftLimit,
    q: i64,
) -> Option<i64> {
    // The last are mostly the nearest to `q`, and rule out many by their tips alone.
    points.rev().fold(None, |best, point| match best {
        Some(best) if point.bound >= best => Some(best),
        Some(best) => Some(point.carried(drift, q).min(best)),
        None => Some(point.carried(drift, q)),
    })
}

/// What became of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Insertion {
    /// Its slot has a better one.
    Unchanged,
    /// It is the best of the newest slot, instead of another one.
    Newest,
    /// It is the first of its slot, or the best of an older one.
    Other,
}

/// The best point of each slot, by time.
#[derive(Clone, Debug)]
pub(super) struct Slots {
    drift: DriftLimit,
    length: i64,
    points: VecDeque<Point>,
}

impl Slots {
    /// Slots for points that are kept so long, nanoseconds.
    pub(super) fn new(drift: DriftLimit, retention: i64) -> Self {
        Self { drift, length: LENGTH.max(retention / MOST), points: VecDeque::new() }
    }

    /// The lowest cone at `q` of the points no further from it than `reach`; `None` without any.
    #[inline]
    pub(super) fn bound(&self, q: i64, reach: i64) -> Option<i64> {
        let near = |point: &&Point| point.x.abs_diff(q) <= reach.unsigned_abs();
        lowest(self.points.iter().filter(near).copied(), self.drift, q)
    }

    /// The newest point.
    pub(super) fn newest(&self) -> Option<Point> {
        self.points.back().copied()
    }

    /// Points no further from `q` than `reach`, at most `most` of each side of it; in the order of time.
    pub(super) fn around(&self, q: i64, reach: i64, most: usize) -> impl Iterator<Item = Point> + Clone + '_ {
        let split = self.points.partition_point(|point| point.x <= q);
        let range = split.saturating_sub(most)..split.saturating_add(most).min(self.points.len());
        self.points.range(range).copied().filter(move |point| point.x.abs_diff(q) <= reach.unsigned_abs())
    }

    /// Drops every point after `end`.
    pub(super) fn truncate(&mut self, end: i64) {
        self.points.truncate(self.points.partition_point(|point| point.x <= end));
    }

    /// Whether a cone at `q` is lower than a bound.
    #[inline]
    pub(super) fn is_below(&self, bound: i64, q: i64) -> bool {
        self.points.iter().any(|point| point.is_below(bound, self.drift, q))
    }

    /// Takes a point if it is the best of its slot.
    pub(super) fn insert(&mut self, point: Point) -> Insertion {
        let slot = |point: &Point| point.x.div_euclid(self.length);
        let at = match self.points.back() {
            // Mostly it is of the newest slot.
            Some(last) if slot(last) == slot(&point) => self.points.len() - 1,
            Some(last) if slot(last) < slot(&point) => self.points.len(),
            _ => self.points.partition_point(|other| slot(other) < slot(&point)),
        };
        match self.points.get_mut(at) {
            Some(known) if known.x.div_euclid(self.length) == point.x.div_euclid(self.length) => {
                let later = known.x.max(point.x);
                if point.carried(self.drift, later) >= known.carried(self.drift, later) {
                    return Insertion::Unchanged;
                }
                *known = point;
                if at + 1 == self.points.len() { Insertion::Newest } else { Insertion::Other }
            }
            _ => {
                self.points.insert(at, point);
                Insertion::Other
            }
        }
    }

    /// Drops every point before `start`.
    pub(super) fn expire(&mut self, start: i64) {
        while self.points.pop_front_if(|point| point.x < start).is_some() {}
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.points.capacity() * size_of::<Point>()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn limit() -> DriftLimit {
        DriftLimit::new(50.0)
    }

    proptest! {
        #[test]
        fn bound_after_all_points_is_that_of_all_points(
            points in proptest::collection::vec((0i64..5_000_000_000, -40_000i64..40_000), 1..200),
            after in 5_000_000_000i64..15_000_000_000,
        ) {
            let points: Vec<Point> = points.into_iter().map(|(x, bound)| Point { x, bound }).collect();
            let mut slots = Slots::new(limit(), 10_000_000_000);
            points.iter().for_each(|point| _ = slots.insert(*point));
            let best = points.iter().map(|point| point.carried(limit(), after)).min().expect("points");
            let known = slots.bound(after, i64::MAX).expect("points");
            prop_assert!(best <= known && known <= best + 2, "{best} {known}");
        }

        #[test]
        fn slots_stay_in_order_and_few(times in proptest::collection::vec(0i64..60_000_000_000, 1..400)) {
            let mut slots = Slots::new(limit(), 10_000_000_000);
            let mut newest = 0;
            for x in times {
                newest = newest.max(x);
                slots.expire(newest - 10_000_000_000);
                slots.insert(Point { x, bound: x % 977 });
                slots.expire(newest - 10_000_000_000);
                prop_assert!(slots.points.len() <= 21, "{}", slots.points.len());
                prop_assert!(slots.points.iter().is_sorted_by_key(|point| point.x));
                prop_assert!(slots.points.iter().all(|point| point.x >= newest - 10_000_000_000));
            }
        }

        #[test]
        fn widening_adds_up_to_within_a_nanosecond(a in 0i64..1 << 60, b in 0i64..1 << 60, ppm in 0.0f64..500.0) {
            let drift = DriftLimit::new(ppm);
            let (parts, whole) = (drift.over(a) + drift.over(b), drift.over(a + b));
            prop_assert!(whole <= parts && parts <= whole + 1);
        }
    }

    #[test]
    fn long_windows_have_longer_slots() {
        let day = 86_400_000_000_000;
        let mut slots = Slots::new(limit(), day);
        for n in 0..86_400 {
            slots.insert(Point { x: n * 1_000_000_000, bound: 0 });
        }
        assert!(slots.points.len() <= 1_201, "{}", slots.points.len());
    }

    #[test]
    fn rounding_is_to_the_safe_side_and_the_limit_holds_by_either_clock() {
        assert_eq!(limit().over(1), 1);
        // By the cloud's clock 50 ppm are 50.0025 ppm of a slow edge's second.
        assert!(limit().over(1_000_000_000) >= 50_003);
        assert!(limit().over(1_000_000_000) <= 50_004);
        assert_eq!(limit().between(i64::MIN, i64::MAX), limit().between(i64::MAX, i64::MIN));
        assert_eq!(DriftLimit::new(f64::NAN), DriftLimit::new(f64::INFINITY));
        assert_eq!(DriftLimit::new(-3.0).over(i64::MAX), 0);
    }
}
