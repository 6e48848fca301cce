use proptest::prelude::*;

use super::*;

const WINDOW: i64 = 600_000_000_000;

fn limit() -> DriftLimit {
    DriftLimit::new(50.0)
}

fn points(times: impl Strategy<Value = i64>) -> impl Strategy<Value = Vec<Point>> {
    let point = (times, -40_000i64..40_000).prop_map(|(x, bound)| Point { x, bound });
    proptest::collection::vec(point, 1..200)
}

/// The lowest of all cones, by looking at each.
fn lowest(points: &[Point], q: i64) -> i64 {
    points.iter().map(|point| point.bound + limit().between(point.x, q)).min().expect("at least one point")
}

proptest! {
    #[test]
    fn the_chain_says_what_all_points_say(points in points(0i64..5_000_000_000), q in -1_000_000_000i64..9_000_000_000) {
        let mut side = Side::new(limit(), WINDOW, 16_384);
        for (count, point) in points.iter().enumerate() {
            side.insert(*point);
            prop_assert_eq!(side.bound(q), Some(lowest(&points[..=count], q)));
            for other in &points {
                prop_assert_eq!(side.bound(other.x), Some(lowest(&points[..=count], other.x)));
            }
        }
    }

    #[test]
    fn nanoseconds_apart_nothing_is_lost_to_rounding(points in points(0i64..300_000), q in -100_000i64..400_000) {
        let points: Vec<Point> = points.iter().map(|point| Point { bound: point.bound % 12, ..*point }).collect();
        let mut side = Side::new(limit(), WINDOW, 16_384);
        points.iter().for_each(|point| side.insert(*point));
        prop_assert_eq!(side.bound(q), Some(lowest(&points, q)));
    }

    #[test]
    fn expiry_widens_no_time_from_its_start_on(
        points in points(0i64..5_000_000_000),
        start in 0i64..5_000_000_000,
        q in 0i64..9_000_000_000,
    ) {
        let mut side = Side::new(limit(), WINDOW, 16_384);
        points.iter().for_each(|point| side.insert(*point));
        let before = (side.bound(start), side.bound(start + q));
        side.expire(start);
        prop_assert_eq!((side.bound(start), side.bound(start + q)), before);
    }

    #[test]
    fn a_small_chain_gives_up_no_more_than_it_says(points in points(0i64..WINDOW), q in 0i64..WINDOW) {
        // Bounds far enough apart that many of them narrow.
        let points: Vec<Point> = points.iter().map(|point| Point { bound: point.bound * 500, ..*point }).collect();
        let mut side = Side::new(limit(), WINDOW, 32);
        for point in &points {
            side.insert(*point);
            prop_assert!(side.chain.len() <= 32);
        }
        let (best, known) = (lowest(&points, q), side.bound(q).expect("has points"));
        prop_assert!(best <= known && known <= best + side.worthwhile, "{best} {known} {}", side.worthwhile);
    }
}

/// Offsets that rise and fall by just less than the limit allows: no point dominates another.
fn zigzag(count: i64, window: i64) -> Vec<Point> {
    let step = window / count;
    let height = limit().over(step) - 1;
    (0..count).map(|n| Point { x: n * step, bound: if n % 2 == 0 { 0 } else { height } }).collect()
}

#[test]
fn no_order_of_points_fills_a_chain_beyond_its_capacity() {
    let sorted = zigzag(60_000, WINDOW);
    let reversed: Vec<Point> = sorted.iter().rev().copied().collect();
    let strided: Vec<Point> = (0..60_000).map(|n| sorted[n * 7919 % 60_000]).collect();
    for (order, points) in [sorted, reversed, strided].iter().enumerate() {
        let mut side = Side::new(limit(), WINDOW, 1024);
        let mut most = 0;
        for point in points {
            side.insert(*point);
            most = most.max(side.chain.len());
        }
        assert!((510..=1024).contains(&most), "order {order}: {most}");
    }
}

#[test]
fn a_chain_that_goes_on_for_ever_stays_within_its_capacity() {
    let mut side = Side::new(limit(), WINDOW, 1024);
    let step = WINDOW / 20_000;
    // Falling by more than the limit every now and then, so that points are also taken from the end.
    for n in 0..200_000i64 {
        let x = n * step;
        side.expire(x - WINDOW);
        side.insert(Point { x, bound: if n % 3 == 0 { -(n % 1000) * 20 } else { limit().over(step) - 1 } });
        assert!(side.chain.len() <= 1024);
    }
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

proptest! {
    #[test]
    fn widening_adds_up_to_within_a_nanosecond(a in 0i64..1 << 60, b in 0i64..1 << 60, ppm in 0.0f64..500.0) {
        let drift = DriftLimit::new(ppm);
        let (parts, whole) = (drift.over(a) + drift.over(b), drift.over(a + b));
        prop_assert!(whole <= parts && parts <= whole + 1);
    }
}
