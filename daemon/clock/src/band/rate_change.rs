//! Bounds that follow from the limit of the drift's change. Two exchanges prove a rate at one time. Because the rate
//! changes slowly, the rate at other times is approximately the same.
//!
//! With |θ''| ≤ κ, ψ(x) = θ(x) + κx²/2 is convex and φ(x) = θ(x) − κx²/2 is concave. Hence, for points (a, U_a) from
//! above and (a, L_a) from below and a time q:
//!
//! - between two points of one side, a ≤ q ≤ b, the chord of ψ is above ψ: θ(q) ≤ [(b−q)·U_a + (q−a)·U_b] / (b−a) +
//!   κ(q−a)(b−q)/2;
//! - beyond two points, one of each side, a < b ≤ q, the chord of φ from a to q is below φ(b): θ(q) ≤ U_b +
//!   (q−b)·(U_b − L_a) / (b−a) + κ(q−a)(q−b)/2. A symmetric bound holds before both
//!   points, q ≤ a.
//!
//! Convex hulls select the two points that bound θ(q) best: for the chord of ψ, the hull of the points (x, U + κx²/2);
//! for the chord of φ, the hull of the points (x, U − κx²/2) and the hull of the points (x, L − κx²/2). Lower points
//! are stored with the opposite sign, so the last hull is that of (x, −L + κx²/2). A shift of the origin of x adds a
//! straight line and changes no hull, so one set of hulls serves every q. The selection uses floating point; the bound
//! of the two selected points is an integer that is rounded up. Bounds from below are the same with the opposite sign.
//! `docs/clocks.md` contains the proof.

use super::drift::DriftChangeLimit;
use super::hull;
use super::slots::Point;

/// Maximum number of upper (or lower) points that are used before the time of a bound, and maximum number that are used
/// after this time. The slots of these points cover 12 s before and 12 s after the time.
// At the usual κ, points that are farther away give no better bound.
pub(super) const MAX_POINTS_BEFORE_OR_AFTER: usize = 24;
/// Longest distance in time over which a rate extends bounds: 13 days.
const MAX_LENGTH_NANOS: u64 = 1 << 50;

/// The upper and the lower points that can give a bound.
#[derive(Clone, Debug, Default)]
pub(super) struct Hulls {
    upper: Side,
    /// Points of the lower side with the opposite sign.
    lower: Side,
    /// `true` if the points are those of the slots of both sides.
    pub(super) are_of_slots: bool,
}

/// The points of one side that give the best bound at some time.
#[derive(Clone, Debug, Default)]
struct Side {
    /// Lower hull of the points (x, bound + κx²/2).
    raised: Hull,
    /// Lower hull of the points (x, bound − κx²/2).
    lowered: Hull,
}

/// A lower convex hull whose newest point is replaced often.
#[derive(Clone, Debug, Default)]
struct Hull {
    points: Vec<Point>,
    /// The hull of all points but the newest.
    others: Vec<Point>,
}

/// The two points that a bound follows from.
#[derive(Clone, Copy)]
enum BoundPair {
    /// Two points of one side of the band, the first before the time and the second after it.
    Interpolated(Point, Point),
    /// Two points that are both before the time or both after it. The first is the nearer point, and belongs to the
    /// side of the band that is bounded. The second is the farther point, and belongs to the other side.
    Extrapolated(Point, Point),
}

impl Hulls {
    /// Replaces the points of the upper side; `points` must be in the order of time.
    pub(super) fn set_upper(&mut self, points: impl Iterator<Item = Point>, change: DriftChangeLimit) {
        self.upper.set(points, change);
    }

    /// Replaces the points of the lower side, which have the opposite sign.
    pub(super) fn set_lower(&mut self, points: impl Iterator<Item = Point>, change: DriftChangeLimit) {
        self.lower.set(points, change);
    }

    /// Replaces the newest point of the upper side.
    pub(super) fn replace_upper(&mut self, newest: Point, change: DriftChangeLimit) {
        self.upper.replace(newest, change.half_limit_per_nano());
    }

    /// Replaces the newest point of the lower side, which has the opposite sign.
    pub(super) fn replace_lower(&mut self, newest: Point, change: DriftChangeLimit) {
        self.lower.replace(newest, change.half_limit_per_nano());
    }

    /// Returns the upper bound at `q`; `None` if no two points give a bound.
    pub(super) fn upper_bound(&self, q: i64, change: DriftChangeLimit) -> Option<i64> {
        best_bound(&self.upper, &self.lower, q, change)
    }

    /// Returns the lower bound at `q` with the opposite sign; `None` if no two points give a bound.
    pub(super) fn lower_bound(&self, q: i64, change: DriftChangeLimit) -> Option<i64> {
        best_bound(&self.lower, &self.upper, q, change)
    }

    /// Returns whether both sides have points and all of them lie within `reach` of `q`.
    pub(super) fn are_within(&self, q: i64, reach: i64) -> bool {
        // A hull always contains the first and the last point.
        let ends_are_near = |side: &Side| {
            let is_near = |point: Option<&Point>| {
                point.is_some_and(|point| point.x.abs_diff(q) <= reach.unsigned_abs())
            };
            is_near(side.raised.points.first()) && is_near(side.raised.points.last())
        };
        ends_are_near(&self.upper) && ends_are_near(&self.lower)
    }

    /// Returns whether the points of each hull are in the order of time.
    #[cfg(test)]
    pub(super) fn are_in_order_of_time(&self) -> bool {
        let mut hulls = [&self.upper, &self.lower].into_iter().flat_map(|side| [&side.raised, &side.lowered]);
        hulls.all(|hull| hull.points.is_sorted_by_key(|point| point.x))
    }

    pub(super) fn memory_bytes(&self) -> usize {
        let hulls = [&self.upper, &self.lower].into_iter().flat_map(|side| [&side.raised, &side.lowered]);
        hulls.map(|hull| (hull.points.capacity() + hull.others.capacity()) * size_of::<Point>()).sum()
    }
}

impl Side {
    /// Replaces all points; `points` must be in the order of time.
    fn set(&mut self, points: impl Iterator<Item = Point>, change: DriftChangeLimit) {
        let half_limit = change.half_limit_per_nano();
        self.raised.others.clear();
        self.lowered.others.clear();
        let mut newest: Option<Point> = None;
        for point in points {
            if let Some(other) = newest.replace(point) {
                hull::push(&mut self.raised.others, other, half_limit);
                hull::push(&mut self.lowered.others, other, -half_limit);
            }
        }
        match newest {
            Some(newest) => self.replace(newest, half_limit),
            None => [&mut self.raised, &mut self.lowered].into_iter().for_each(|hull| hull.points.clear()),
        }
    }

    /// Replaces the newest point. `half_limit` is κ / 2 per nanosecond.
    fn replace(&mut self, newest: Point, half_limit: f64) {
        for (hull, half_limit) in [(&mut self.raised, half_limit), (&mut self.lowered, -half_limit)] {
            // The newest point changes with almost every exchange, so the hull of the other points is kept and reused.
            hull.points.clone_from(&hull.others);
            hull::push(&mut hull.points, newest, half_limit);
        }
    }
}

/// Returns the best bound of a side at `q` that follows from two points. `opposite` has the points of the other side.
fn best_bound(side: &Side, opposite: &Side, q: i64, change: DriftChangeLimit) -> Option<i64> {
    let (raised, lowered, opposite_points) =
        (&side.raised.points, &side.lowered.points, &opposite.raised.points);
    // Values are relative to the first bound, because a large offset loses nanoseconds when it becomes a floating-point
    // number.
    let origin = raised.first()?.bound;
    let half_limit = change.half_limit_per_nano();
    let mut best: Option<(f64, BoundPair)> = None;
    let mut consider = |value: f64, pair: BoundPair| {
        if best.is_none_or(|(lowest, _)| value < lowest) {
            best = Some((value, pair));
        }
    };
    let next_index = raised.partition_point(|point| point.x < q);
    if let (Some(a), Some(b)) =
        (next_index.checked_sub(1).and_then(|n| raised.get(n)), raised.get(next_index))
    {
        let (from_a, to_b) = ((q - a.x) as f64, (b.x - q) as f64);
        let chord = ((a.bound - origin) as f64 * to_b + (b.bound - origin) as f64 * from_a) / (from_a + to_b);
        consider(chord + half_limit * from_a * to_b, BoundPair::Interpolated(*a, *b));
    }
    let extrapolated = |b: Point, a: Point| {
        let (near, far) = (q.abs_diff(b.x) as f64, q.abs_diff(a.x) as f64);
        let rate = b.bound.saturating_add(a.bound) as f64 / (far - near);
        (b.bound - origin) as f64 + near * rate + half_limit * near * far
    };
    // Together with b, each further point of the hull gives a smaller value than the point before it, until the line
    // through b is a tangent of the hull. The points after the tangent give greater values.
    let mut consider_tangent = |b: Point, farther: &mut dyn Iterator<Item = &Point>| {
        let mut lowest = f64::INFINITY;
        for a in farther {
            let value = extrapolated(b, *a);
            if value > lowest {
                break;
            }
            lowest = value;
            consider(value, BoundPair::Extrapolated(b, *a));
        }
    };
    for b in &lowered[..lowered.partition_point(|point| point.x <= q)] {
        consider_tangent(*b, &mut opposite_points.iter().take_while(|a| a.x < b.x));
    }
    for b in &lowered[lowered.partition_point(|point| point.x < q)..] {
        consider_tangent(*b, &mut opposite_points.iter().rev().take_while(|a| a.x > b.x));
    }
    match best?.1 {
        BoundPair::Interpolated(a, b) => interpolate(a, b, q, change),
        BoundPair::Extrapolated(b, a) => extrapolate(b, a, q, change),
    }
}

/// Returns the bound at `q` that follows from two points of one side, `a` before `q` and `b` after `q`, rounded up.
fn interpolate(a: Point, b: Point, q: i64, change: DriftChangeLimit) -> Option<i64> {
    let (from_a, to_b) = (q.abs_diff(a.x), q.abs_diff(b.x));
    let change_from_a =
        multiply_divide(from_a, i128::from(b.bound) - i128::from(a.bound), from_a.checked_add(to_b)?)?;
    Some(a.bound.saturating_add(change_from_a).saturating_add(change.max_deviation(from_a, to_b)))
}

/// Returns the bound at `q` that follows from the point `b` of one side and a rate, rounded up. The point `b` and the
/// point `a` of the other side prove this rate.
fn extrapolate(b: Point, a: Point, q: i64, change: DriftChangeLimit) -> Option<i64> {
    let (near, far) = (q.abs_diff(b.x), q.abs_diff(a.x));
    let change_from_b = multiply_divide(near, i128::from(b.bound) + i128::from(a.bound), a.x.abs_diff(b.x))?;
    Some(b.bound.saturating_add(change_from_b).saturating_add(change.max_deviation(near, far)))
}

/// Returns part × value / whole, rounded up; `None` where a length exceeds [`MAX_LENGTH_NANOS`] or the result
/// overflows.
fn multiply_divide(part: u64, value: i128, whole: u64) -> Option<i64> {
    if whole == 0 || part > MAX_LENGTH_NANOS || whole > MAX_LENGTH_NANOS {
        return None;
    }
    // The computation uses integers, because the bound must be rounded up and never down.
    let product = value.checked_mul(i128::from(part))?;
    let quotient = match i64::try_from(product) {
        // Most products fit into 64 bits. The processor divides such numbers with one instruction. The two negations
        // round up, because `div_euclid` rounds down. `i64::MIN` cannot be negated, so the next number replaces it.
        Ok(product) => i128::from(-(-product.max(-i64::MAX)).div_euclid(i64::try_from(whole).ok()?)),
        Err(_) => -(-product).div_euclid(i128::from(whole)),
    };
    i64::try_from(quotient).ok()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::band::DriftLimit;

    const SECOND: i64 = 1_000_000_000;

    fn change() -> DriftChangeLimit {
        DriftChangeLimit::new(1.0, DriftLimit::new(0.0))
    }

    fn hulls(upper: &[Point], lower: &[Point]) -> Hulls {
        let mut hulls = Hulls::default();
        hulls.set_upper(upper.iter().copied(), change());
        hulls.set_lower(lower.iter().copied(), change());
        hulls
    }

    /// Returns the best bound that the rules give over all pairs of points.
    fn best_of_all_pairs(own: &[Point], other: &[Point], q: i64) -> Option<i64> {
        let interpolated = own.iter().flat_map(|a| own.iter().map(move |b| (a, b)));
        let interpolated = interpolated.filter(|(a, b)| a.x < q && q <= b.x);
        let interpolated = interpolated.filter_map(|(a, b)| interpolate(*a, *b, q, change()));
        let extrapolated = own.iter().flat_map(|b| other.iter().map(move |a| (a, b)));
        let extrapolated = extrapolated.filter(|(a, b)| (a.x < b.x && b.x <= q) || (q <= b.x && b.x < a.x));
        let extrapolated = extrapolated.filter_map(|(a, b)| extrapolate(*b, *a, q, change()));
        interpolated.chain(extrapolated).min()
    }

    fn points() -> impl Strategy<Value = Vec<Point>> {
        proptest::collection::btree_map(0..10 * SECOND, 0i64..3_000_000, 2..24)
            .prop_map(|points| points.into_iter().map(|(x, bound)| Point { x, bound }).collect())
    }

    proptest! {
        #[test]
        fn bound_of_hulls_is_not_below_best_pair(upper in points(), lower in points(), q in -SECOND..12 * SECOND) {
            let actual = hulls(&upper, &lower).upper_bound(q, change());
            let best = best_of_all_pairs(&upper, &lower, q);
            // The hulls leave out only pairs of points that are neighbours in time, which give weak bounds. Weak bounds
            // are above 0 here, so that the hulls give a bound whenever the best bound is 0 or less.
            prop_assert!(actual.is_none_or(|actual| best.is_some_and(|best| best <= actual)), "{actual:?} {best:?}");
            prop_assert!(best.is_none_or(|best| best > 0 || actual.is_some()), "{actual:?} {best:?}");
        }

        /// Uses exact bounds of an offset whose rate changes at the limit, first in one direction and then in the
        /// other.
        #[test]
        fn exact_bounds_of_fastest_change_contain_truth(
            times in proptest::collection::btree_set(0..10 * SECOND, 2..24),
            reversal in 0..10 * SECOND,
            forward: bool,
            q in -SECOND..12 * SECOND,
        ) {
            let truth = |x: i64| {
                let away = (x - reversal) as f64;
                let max_deviation = away * away.abs() * 0.5e-15;
                if forward { max_deviation } else { -max_deviation }
            };
            let point = |x: &i64, sign: f64| Point { x: *x, bound: (sign * truth(*x)).ceil() as i64 };
            let upper: Vec<Point> = times.iter().map(|x| point(x, 1.0)).collect();
            let lower: Vec<Point> = times.iter().map(|x| point(x, -1.0)).collect();
            let hulls = hulls(&upper, &lower);
            let (upper_bound, lower_bound) = (hulls.upper_bound(q, change()), hulls.lower_bound(q, change()));
            prop_assert!(upper_bound.is_none_or(|bound| bound as f64 >= truth(q)), "{upper_bound:?} {}", truth(q));
            prop_assert!(lower_bound.is_none_or(|bound| bound as f64 >= -truth(q)), "{lower_bound:?} {}", truth(q));
        }
    }

    #[test]
    fn extreme_points_do_not_panic() {
        // Larger stamps and offsets are refused before they get here.
        let max = 1 << 61;
        let extremes = [(-max, max), (0, -max), (1, max), (max, -max)];
        let points: Vec<Point> = extremes.into_iter().map(|(x, bound)| Point { x, bound }).collect();
        let hulls = hulls(&points, &points);
        for q in [i64::MIN, -1, 0, 1, i64::MAX] {
            let _ = (hulls.upper_bound(q, change()), hulls.lower_bound(q, change()));
        }
    }
}
