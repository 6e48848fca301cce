//! One side of the band: everything that bounds the offset from above.
//!
//! A point (x, U) says that the offset is at most U at the edge's time x. Because it drifts no faster than ρ, it is at
//! most U + w(|q − x|) at any time q, where w(d) is ρ·d rounded up: a cone that opens upwards. The bound at q is the
//! lowest of all cones, their lower envelope. Bounds from below are the same with the sign turned.
//!
//! A point is *dominated* when another cone passes at or below it; by w(a + b) ≤ w(a) + w(b) that cone is then at or
//! below its whole cone, for ever. The chain holds the points that are not dominated, by time. Three facts make it
//! fast, each from w(a + b) ≥ w(a) + w(b) − 1 and from "not dominated" meaning "by at least one nanosecond":
//!
//! 1. *The best cone at q belongs to a neighbour of q.* For x_j < x_i ≤ q, i is not dominated by j, so
//!    U_j + w(x_i − x_j) ≥ U_i + 1, so U_j + w(q − x_j) ≥ U_j + w(x_i − x_j) + w(q − x_i) − 1 ≥ U_i + w(q − x_i).
//! 2. Hence a new point is dominated by any point only if it is by one of its neighbours.
//! 3. *What a new point dominates is next to it.* If it spares its neighbour r, then at any k beyond r its cone is, by
//!    the same line, at or above that of r, which spares k. So points are only ever taken from beside it: from the end,
//!    when it is the last, and each point is taken once.

use std::collections::VecDeque;

use super::drift::DriftLimit;

/// A bound of the offset that holds exactly at one time; nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Point {
    pub(super) x: i64,
    pub(super) bound: i64,
}

/// The chain of points that are not dominated, by time.
#[derive(Clone, Debug)]
pub(super) struct Side {
    drift: DriftLimit,
    /// From so many points on, a new one must be an improvement by more than `worthwhile`.
    dense: usize,
    worthwhile: i64,
    chain: VecDeque<Point>,
}

impl Side {
    /// A side that never holds more than `capacity` points (at least 8) of a window so long.
    ///
    /// Memory is bounded by refusing points, never by dropping them, so that no bound ever widens. Up to half the
    /// capacity everything is kept that narrows. Beyond, a point must lie below the bound at its time by more than
    /// ε = 2·w(g), g = window / half the capacity. Such a point is further than g from each point that stays: for a
    /// neighbour n at distance d that it neither dominates nor is dominated by, U_n − w(d) < U < U_n + w(d) − ε, so
    /// w(d) > w(g). Points taken so are therefore more than g from each other, in whatever order they came, and there are
    /// at most half the capacity of them in a window; points may vanish in between, which only adds to the distances.
    /// Those taken freely were never more than the other half. What is given up is at most ε: 7.4 µs at 50 ppm,
    /// 10 minutes and 16,384 points.
    pub(super) fn new(drift: DriftLimit, window: i64, capacity: usize) -> Self {
        let half = (capacity / 2).max(4);
        let gap = window.max(0) / half as i64 + 1;
        // Two places: for a point older than the window, and for one more that is being put in.
        Self { drift, dense: half - 2, worthwhile: drift.over(gap).saturating_mul(2), chain: VecDeque::new() }
    }

    /// The bound at a time; `None` without any point.
    #[inline]
    pub(super) fn bound(&self, q: i64) -> Option<i64> {
        self.bound_beside(self.place(q), q)
    }

    /// Takes a point if it narrows the bound by enough, and drops what it dominates.
    pub(super) fn insert(&mut self, point: Point) {
        let at = self.place(point.x);
        let least = if self.chain.len() < self.dense { 0 } else { self.worthwhile };
        if self.bound_beside(at, point.x).is_some_and(|known| point.bound.saturating_add(least) >= known) {
            return;
        }
        let spared =
            |other: &Point| point.bound.saturating_add(self.drift.between(point.x, other.x)) > other.bound;
        let left = self.chain.range(..at).rev().position(spared).unwrap_or(at);
        let right = self.chain.range(at..).position(spared).unwrap_or(self.chain.len() - at);
        if at + right == self.chain.len() {
            self.chain.truncate(at - left);
            self.chain.push_back(point);
        } else {
            self.chain.drain(at - left..at + right);
            self.chain.insert(at - left, point);
        }
    }

    /// Forgets what no time from `start` on needs: a point goes only when the next one is not after `start` either, by
    /// fact 1.
    pub(super) fn expire(&mut self, start: i64) {
        while self.chain.get(1).is_some_and(|next| next.x <= start) {
            self.chain.pop_front();
        }
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.chain.capacity() * size_of::<Point>()
    }

    /// How many points are before a time: mostly all.
    #[inline]
    fn place(&self, x: i64) -> usize {
        match self.chain.back() {
            Some(last) if last.x >= x => self.chain.partition_point(|point| point.x < x),
            _ => self.chain.len(),
        }
    }

    #[inline]
    fn bound_beside(&self, at: usize, q: i64) -> Option<i64> {
        let before = at.checked_sub(1).and_then(|index| self.chain.get(index));
        let cone = |point: &Point| point.bound.saturating_add(self.drift.between(point.x, q));
        match (before.map(cone), self.chain.get(at).map(cone)) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (one, other) => one.or(other),
        }
    }
}

#[cfg(test)]
mod tests;
