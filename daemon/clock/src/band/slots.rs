//! One side of the band: the best upper bound of the offset from each short slot of time.
//!
//! A point (x, U) says that the offset is at most U at the edge's time x. Because the offset drifts no faster than ρ,
//! it is at most U + w(|q − x|) at any time q, where w(d) is ρ·d rounded up: a cone that opens upwards. The bound at q
//! is the lowest of all cones. Bounds from below are the same with the opposite sign.
//!
//! A slot keeps only one of its points. Of two points, it keeps the one whose cone is lower at the time of the later
//! point. Because w(a + b) ≥ w(a) + w(b) − 1, this cone is, to a nanosecond, also the lower one at every time after the
//! slot. A query about the present therefore gets the bound that all exchanges together give. The removal of the other
//! points has two costs: the oldest slot of the window expires as a whole, and the bound at a time within a slot may be
//! wider by ρ × twice the slot's length. The removal never makes an interval wrong, because any subset of valid bounds
//! is valid.

use std::collections::VecDeque;

use super::drift::DriftLimit;

/// Usual length of a slot. With this length, the default window has 20 slots.
const DEFAULT_SLOT_NANOS: i64 = 500_000_000;
/// Maximum number of slots. If the retention is so long that there would be more, the slots are longer instead.
const MAX_SLOTS: i64 = 1_200;

/// An upper bound of the offset (`bound`, nanoseconds) at one time of the edge's clock (`x`, nanoseconds).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Point {
    pub(super) x: i64,
    pub(super) bound: i64,
}

impl Point {
    /// Returns the bound at another time `q` that follows from this point.
    #[inline]
    pub(super) fn bound_at(self, drift: DriftLimit, q: i64) -> i64 {
        self.bound.saturating_add(drift.max_change_between(self.x, q))
    }

    /// Returns whether the bound at time `q` that follows from this point is lower than `bound`.
    #[inline]
    pub(super) fn is_below(self, bound: i64, drift: DriftLimit, q: i64) -> bool {
        // The first comparison is cheap and decides most cases.
        self.bound < bound && self.bound_at(drift, q) < bound
    }
}

/// Returns the lowest bound at time `q` that a point gives; `None` without points.
#[inline]
pub(super) fn lowest_bound(
    points: impl DoubleEndedIterator<Item = Point>,
    drift: DriftLimit,
    q: i64,
) -> Option<i64> {
    // The last points are usually the nearest to `q`. Their bounds rule out most of the other points without a
    // multiplication.
    points.rev().fold(None, |best, point| match best {
        Some(best) if point.bound >= best => Some(best),
        Some(best) => Some(point.bound_at(drift, q).min(best)),
        None => Some(point.bound_at(drift, q)),
    })
}

/// Result of the insertion of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Insertion {
    /// The point was not inserted: its slot has a better point.
    Unchanged,
    /// The point replaced the best point of the newest slot.
    Newest,
    /// The point is the first of its slot, or replaced the best point of an older slot.
    Other,
}

/// The best point of each slot, in the order of time.
#[derive(Clone, Debug)]
pub(super) struct Slots {
    drift: DriftLimit,
    length: i64,
    points: VecDeque<Point>,
}

impl Slots {
    /// Creates slots for points that are kept for `retention` nanoseconds.
    pub(super) fn new(drift: DriftLimit, retention: i64) -> Self {
        Self { drift, length: DEFAULT_SLOT_NANOS.max(retention / MAX_SLOTS), points: VecDeque::new() }
    }

    /// Returns the lowest bound at time `q` that the points within `reach` of `q` give; `None` without such points.
    #[inline]
    pub(super) fn bound(&self, q: i64, reach: i64) -> Option<i64> {
        let is_near = |point: &&Point| point.x.abs_diff(q) <= reach.unsigned_abs();
        lowest_bound(self.points.iter().filter(is_near).copied(), self.drift, q)
    }

    /// Returns the newest point.
    pub(super) fn newest(&self) -> Option<Point> {
        self.points.back().copied()
    }

    /// Returns the points within `reach` of `q` in the order of time: at most `max_before_or_after` points up to
    /// `q`, and at most `max_before_or_after` points after `q`.
    pub(super) fn points_around(
        &self,
        q: i64,
        reach: i64,
        max_before_or_after: usize,
    ) -> impl Iterator<Item = Point> + Clone + '_ {
        let split = self.points.partition_point(|point| point.x <= q);
        let range = split.saturating_sub(max_before_or_after)
            ..split.saturating_add(max_before_or_after).min(self.points.len());
        self.points.range(range).copied().filter(move |point| point.x.abs_diff(q) <= reach.unsigned_abs())
    }

    /// Removes every point after `end`.
    pub(super) fn truncate(&mut self, end: i64) {
        self.points.truncate(self.points.partition_point(|point| point.x <= end));
    }

    /// Returns whether the bound at time `q` that follows from any point is lower than `bound`.
    #[inline]
    pub(super) fn is_below(&self, bound: i64, q: i64) -> bool {
        self.points.iter().any(|point| point.is_below(bound, self.drift, q))
    }

    /// Inserts a point if it is the best of its slot.
    pub(super) fn insert(&mut self, point: Point) -> Insertion {
        let slot = |point: &Point| point.x.div_euclid(self.length);
        let index = match self.points.back() {
            // Most points belong to the newest slot.
            Some(last) if slot(last) == slot(&point) => self.points.len() - 1,
            Some(last) if slot(last) < slot(&point) => self.points.len(),
            _ => self.points.partition_point(|other| slot(other) < slot(&point)),
        };
        match self.points.get_mut(index) {
            Some(best) if best.x.div_euclid(self.length) == point.x.div_euclid(self.length) => {
                // The bounds are compared at the later time, because queries are mostly about times after the slot.
                let later = best.x.max(point.x);
                if point.bound_at(self.drift, later) >= best.bound_at(self.drift, later) {
                    return Insertion::Unchanged;
                }
                *best = point;
                if index + 1 == self.points.len() { Insertion::Newest } else { Insertion::Other }
            }
            _ => {
                self.points.insert(index, point);
                Insertion::Other
            }
        }
    }

    /// Removes every point before `start`.
    pub(super) fn remove_before(&mut self, start: i64) {
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
        fn bound_of_slots_equals_bound_of_all_points(
            points in proptest::collection::vec((0i64..5_000_000_000, -40_000i64..40_000), 1..200),
            after in 5_000_000_000i64..15_000_000_000,
        ) {
            let points: Vec<Point> = points.into_iter().map(|(x, bound)| Point { x, bound }).collect();
            let mut slots = Slots::new(limit(), 10_000_000_000);
            points.iter().for_each(|point| _ = slots.insert(*point));
            let best = points.iter().map(|point| point.bound_at(limit(), after)).min().expect("points");
            let actual = slots.bound(after, i64::MAX).expect("points");
            prop_assert!(best <= actual && actual <= best + 2, "{best} {actual}");
        }

        #[test]
        fn slots_stay_sorted_and_few(times in proptest::collection::vec(0i64..60_000_000_000, 1..400)) {
            let mut slots = Slots::new(limit(), 10_000_000_000);
            let mut newest = 0;
            for x in times {
                newest = newest.max(x);
                slots.remove_before(newest - 10_000_000_000);
                slots.insert(Point { x, bound: x % 977 });
                slots.remove_before(newest - 10_000_000_000);
                prop_assert!(slots.points.len() <= 21, "{}", slots.points.len());
                prop_assert!(slots.points.iter().is_sorted_by_key(|point| point.x));
                prop_assert!(slots.points.iter().all(|point| point.x >= newest - 10_000_000_000));
            }
        }

        #[test]
        fn drift_over_parts_adds_up_within_a_nanosecond(a in 0i64..1 << 60, b in 0i64..1 << 60, ppm in 0.0f64..500.0) {
            let drift = DriftLimit::new(ppm);
            let (parts, whole) = (drift.max_change_over(a) + drift.max_change_over(b), drift.max_change_over(a + b));
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
    fn limit_is_rounded_up_for_either_clock() {
        assert_eq!(limit().max_change_over(1), 1);
        // If the edge's clock is the slower clock, 50 ppm by the cloud's clock are 50.0025 ppm by the edge's clock.
        assert!(limit().max_change_over(1_000_000_000) >= 50_003);
        assert!(limit().max_change_over(1_000_000_000) <= 50_004);
        assert_eq!(
            limit().max_change_between(i64::MIN, i64::MAX),
            limit().max_change_between(i64::MAX, i64::MIN)
        );
        assert_eq!(DriftLimit::new(f64::NAN), DriftLimit::new(f64::INFINITY));
        assert_eq!(DriftLimit::new(-3.0).max_change_over(i64::MAX), 0);
    }
}
