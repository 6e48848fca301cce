//! Bounds that rest on a rate which changes slowly: the rate that two exchanges prove holds nearly at other times, too.
//!
//! With |θ''| ≤ κ, ψ(x) = θ(x) + κx²/2 is convex and φ(x) = θ(x) − κx²/2 is concave. Hence, for points (a, U_a) from above
//! and (a, L_a) from below and a time q:
//!
//! - between two points of one side, a ≤ q ≤ b, the chord of ψ is above it:
//!   θ(q) ≤ [(b−q)·U_a + (q−a)·U_b] / (b−a) + κ(q−a)(b−q)/2;
//! - beyond two points of both sides, a < b ≤ q, the chord of φ from a to q is below φ(b):
//!   θ(q) ≤ U_b + (q−b)·(U_b − L_a) / (b−a) + κ(q−a)(q−b)/2, and likewise before them.
//!
//! Which two points bound θ(q) best is asked of convex hulls: of one side the points (x, U + κx²/2), of the other
//! (x, U − κx²/2). A shift of the origin of x adds a straight line and changes no hull, so that one set of hulls
//! serves every q. The choice is made in floating point; the bound of the chosen two is an integer that is rounded up. Bounds
//! from below are the same with the sign turned. `docs/clocks.md` has the proof.

use super::drift::DriftChangeLimit;
use super::hull;
use super::slots::Point;

/// Most points of one side before a time, and as many after it: older ones than 12 s add nothing at the usual κ.
pub(super) const MOST: usize = 24;
/// Bounds are not carried over longer times by their rate (13 days).
const LONGEST: u64 = 1 << 50;

/// The points of both sides that the rules can use.
#[derive(Clone, Debug, Default)]
pub(super) struct Hulls {
    upper: Side,
    /// With the sign turned.
    lower: Side,
}

/// The points of one side that can be the best for some time.
#[derive(Clone, Debug, Default)]
struct Side {
    /// Of the hull below (x, bound + κx²/2).
    raised: Hull,
    /// Of the hull below (x, bound − κx²/2).
    lowered: Hull,
}

/// A lower convex hull whose newest point is often replaced.
#[derive(Clone, Debug, Default)]
struct Hull {
    points: Vec<Point>,
    /// The hull of all points but the newest.
    others: Vec<Point>,
}

/// Two points and what they say.
#[derive(Clone, Copy)]
enum Pair {
    /// Of one side, on both sides of the time.
    Around(Point, Point),
    /// The nearer one of the side, the farther one of the other side.
    Beyond(Point, Point),
}

impl Hulls {
    /// Takes other points, in the order of time.
    pub(super) fn set_upper(&mut self, points: impl Iterator<Item = Point>, change: DriftChangeLimit) {
        self.upper.set(points, change);
    }

    /// The same for the lower side, with the sign turned.
    pub(super) fn set_lower(&mut self, points: impl Iterator<Item = Point>, change: DriftChangeLimit) {
        self.lower.set(points, change);
    }

    /// Takes another newest point instead of the one before.
    pub(super) fn replace_upper(&mut self, newest: Point, change: DriftChangeLimit) {
        self.upper.replace(newest, change.half_per_nano());
    }

    /// The same for the lower side, with the sign turned.
    pub(super) fn replace_lower(&mut self, newest: Point, change: DriftChangeLimit) {
        self.lower.replace(newest, change.half_per_nano());
    }

    /// The upper bound at a time; `None` where no two points say anything of it.
    pub(super) fn above(&self, q: i64, change: DriftChangeLimit) -> Option<i64> {
        bound(&self.upper, &self.lower, q, change)
    }

    /// The lower bound at a time, with the sign turned.
    pub(super) fn below(&self, q: i64, change: DriftChangeLimit) -> Option<i64> {
        bound(&self.lower, &self.upper, q, change)
    }

    /// Whether there are points on both sides, and all are within a distance of a time.
    pub(super) fn are_within(&self, q: i64, reach: i64) -> bool {
        // The hulls begin and end with the first and the last point.
        let ends = |side: &Side| {
            let near = |point: Option<&Point>| {
                point.is_some_and(|point| point.x.abs_diff(q) <= reach.unsigned_abs())
            };
            near(side.raised.points.first()) && near(side.raised.points.last())
        };
        ends(&self.upper) && ends(&self.lower)
    }

    pub(super) fn memory_bytes(&self) -> usize {
        let hulls = [&self.upper, &self.lower].into_iter().flat_map(|side| [&side.raised, &side.lowered]);
        hulls.map(|hull| (hull.points.capacity() + hull.others.capacity()) * size_of::<Point>()).sum()
    }
}

impl Side {
    fn set(&mut self, points: impl Iterator<Item = Point>, change: DriftChangeLimit) {
        let half = change.half_per_nano();
        self.raised.others.clear();
        self.lowered.others.clear();
        let mut newest: Option<Point> = None;
        for point in points {
            if let Some(other) = newest.replace(point) {
                hull::push(&mut self.raised.others, other, half);
                hull::push(&mut self.lowered.others, other, -half);
            }
        }
        match newest {
            Some(newest) => self.replace(newest, half),
            None => [&mut self.raised, &mut self.lowered].into_iter().for_each(|hull| hull.points.clear()),
        }
    }

    fn replace(&mut self, newest: Point, half: f64) {
        for (hull, half) in [(&mut self.raised, half), (&mut self.lowered, -half)] {
            hull.points.clone_from(&hull.others);
            hull::push(&mut hull.points, newest, half);
        }
    }
}

/// The bound of `own` side at a time by two points.
fn bound(own: &Side, other: &Side, q: i64, change: DriftChangeLimit) -> Option<i64> {
    let (raised, lowered, others) = (&own.raised.points, &own.lowered.points, &other.raised.points);
    let origin = raised.first()?.bound;
    let half = change.half_per_nano();
    let mut best: Option<(f64, Pair)> = None;
    let mut offer = |value: f64, pair: Pair| {
        if best.is_none_or(|(least, _)| value < least) {
            best = Some((value, pair));
        }
    };
    let after = raised.partition_point(|point| point.x < q);
    if let (Some(a), Some(b)) = (after.checked_sub(1).and_then(|n| raised.get(n)), raised.get(after)) {
        let (from_a, to_b) = ((q - a.x) as f64, (b.x - q) as f64);
        let chord = ((a.bound - origin) as f64 * to_b + (b.bound - origin) as f64 * from_a) / (from_a + to_b);
        offer(chord + half * from_a * to_b, Pair::Around(*a, *b));
    }
    let beyond = |b: Point, a: Point| {
        let (near, far) = (q.abs_diff(b.x) as f64, q.abs_diff(a.x) as f64);
        let rate = b.bound.saturating_add(a.bound) as f64 / (far - near);
        (b.bound - origin) as f64 + near * rate + half * near * far
    };
    // Seen from b, the hull comes nearer up to the tangent and goes away after it.
    let mut tangent = |b: Point, farther: &mut dyn Iterator<Item = &Point>| {
        let mut least = f64::INFINITY;
        for a in farther {
            let value = beyond(b, *a);
            if value > least {
                break;
            }
            least = value;
            offer(value, Pair::Beyond(b, *a));
        }
    };
    for b in &lowered[..lowered.partition_point(|point| point.x <= q)] {
        tangent(*b, &mut others.iter().take_while(|a| a.x < b.x));
    }
    for b in &lowered[lowered.partition_point(|point| point.x < q)..] {
        tangent(*b, &mut others.iter().rev().take_while(|a| a.x > b.x));
    }
    match best?.1 {
        Pair::Around(a, b) => between(a, b, q, change),
        Pair::Beyond(b, a) => carried(b, a, q, change),
    }
}

/// What two points of one side on both sides of a time say of it, rounded up.
fn between(a: Point, b: Point, q: i64, change: DriftChangeLimit) -> Option<i64> {
    let (from_a, to_b) = (q.abs_diff(a.x), q.abs_diff(b.x));
    let share = share(from_a, i128::from(b.bound) - i128::from(a.bound), from_a.checked_add(to_b)?)?;
    Some(a.bound.saturating_add(share).saturating_add(change.bend(from_a, to_b)))
}

/// What a point of one side says of a time beyond it, by the rate that it and a point `a` of the other side prove, rounded up.
fn carried(b: Point, a: Point, q: i64, change: DriftChangeLimit) -> Option<i64> {
    let (near, far) = (q.abs_diff(b.x), q.abs_diff(a.x));
    let share = share(near, i128::from(b.bound) + i128::from(a.bound), a.x.abs_diff(b.x))?;
    Some(b.bound.saturating_add(share).saturating_add(change.bend(near, far)))
}

/// part × value / whole, rounded up; `None` where it is no sensible time.
fn share(part: u64, value: i128, whole: u64) -> Option<i64> {
    if whole == 0 || part > LONGEST || whole > LONGEST {
        return None;
    }
    let product = value.checked_mul(i128::from(part))?;
    let quotient = match i64::try_from(product) {
        // Most are short times and narrow bounds, for which the hardware divides.
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

    /// The best that the rules make of all pairs.
    fn of_all_pairs(own: &[Point], other: &[Point], q: i64) -> Option<i64> {
        let around = own.iter().flat_map(|a| own.iter().map(move |b| (a, b)));
        let around = around.filter(|(a, b)| a.x < q && q <= b.x);
        let around = around.filter_map(|(a, b)| between(*a, *b, q, change()));
        let beyond = own.iter().flat_map(|b| other.iter().map(move |a| (a, b)));
        let beyond = beyond.filter(|(a, b)| (a.x < b.x && b.x <= q) || (q <= b.x && b.x < a.x));
        let beyond = beyond.filter_map(|(a, b)| carried(*b, *a, q, change()));
        around.chain(beyond).min()
    }

    fn points() -> impl Strategy<Value = Vec<Point>> {
        proptest::collection::btree_map(0..10 * SECOND, 0i64..3_000_000, 2..24)
            .prop_map(|points| points.into_iter().map(|(x, bound)| Point { x, bound }).collect())
    }

    proptest! {
        #[test]
        fn hulls_find_about_the_best_of_all_pairs(upper in points(), lower in points(), q in -SECOND..12 * SECOND) {
            let known = hulls(&upper, &lower).above(q, change());
            let best = of_all_pairs(&upper, &lower, q);
            // A pair that is left out is one of neighbours in time, which say little.
            prop_assert!(known.is_none_or(|known| best.is_some_and(|best| best <= known)), "{known:?} {best:?}");
            prop_assert!(best.is_none_or(|best| best > 0 || known.is_some()), "{known:?} {best:?}");
        }

        /// A rate that changes as fast as it may, first one way and then the other, and bounds that are exact.
        #[test]
        fn exact_bounds_of_the_fastest_change_contain_the_truth(
            times in proptest::collection::btree_set(0..10 * SECOND, 2..24),
            turn in 0..10 * SECOND,
            forward: bool,
            q in -SECOND..12 * SECOND,
        ) {
            let truth = |x: i64| {
                let away = (x - turn) as f64;
                let bend = away * away.abs() * 0.5e-15;
                if forward { bend } else { -bend }
            };
            let point = |x: &i64, sign: f64| Point { x: *x, bound: (sign * truth(*x)).ceil() as i64 };
            let upper: Vec<Point> = times.iter().map(|x| point(x, 1.0)).collect();
            let lower: Vec<Point> = times.iter().map(|x| point(x, -1.0)).collect();
            let hulls = hulls(&upper, &lower);
            let (above, below) = (hulls.above(q, change()), hulls.below(q, change()));
            prop_assert!(above.is_none_or(|bound| bound as f64 >= truth(q)), "{above:?} {}", truth(q));
            prop_assert!(below.is_none_or(|bound| bound as f64 >= -truth(q)), "{below:?} {}", truth(q));
        }
    }

    #[test]
    fn no_points_can_panic() {
        // Stamps and offsets beyond are refused.
        let most = 1 << 61;
        let wild = [(-most, most), (0, -most), (1, most), (most, -most)];
        let points: Vec<Point> = wild.into_iter().map(|(x, bound)| Point { x, bound }).collect();
        let hulls = hulls(&points, &points);
        for q in [i64::MIN, -1, 0, 1, i64::MAX] {
            let _ = (hulls.above(q, change()), hulls.below(q, change()));
        }
    }
}
