//! Convex hulls of the points of one side of the band. A hull contains the points that give the best bounds, and one of
//! its edges gives the skew that fits best.

use super::slots::Point;

/// Appends a point to the lower convex hull of points to which `half_limit` × x² was added. The point must not be
/// earlier than the last point of the hull. The origin of x is arbitrary: another origin only adds a straight line to
/// all points, which does not change which points are on the hull.
#[inline]
pub(super) fn push(hull: &mut Vec<Point>, next: Point, half_limit: f64) {
    // Height of a later point above an earlier point, with the earlier point as the origin of x.
    let rise =
        |from: Point, to: Point, dx: f64| to.bound.saturating_sub(from.bound) as f64 + half_limit * dx * dx;
    while let [.., a, b] = hull[..] {
        let (near, far) = ((b.x - a.x) as f64, (next.x - a.x) as f64);
        if rise(a, b, near) * far < rise(a, next, far) * near {
            break;
        }
        hull.pop();
    }
    match hull.last() {
        // Two points at one time would make the slope of their edge infinite.
        Some(last) if last.x == next.x && last.bound <= next.bound => return,
        Some(last) if last.x == next.x => _ = hull.pop(),
        _ => {}
    }
    hull.push(next);
}

/// Returns the slope of the line below all points that minimises the sum of the points' distances to the line; `None`
/// for fewer than two points. `points` must be in the order of time.
///
/// This is the problem of Moon, Skelly and Towsley ("Estimation and removal of clock skew from network delay
/// measurements", INFOCOM 1999). Its solution is the edge of the lower convex hull that spans the mean time (Zhang, Liu
/// and Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002), which takes one pass.
pub(super) fn slope_below(points: impl Iterator<Item = Point>) -> Option<f64> {
    let mut hull: Vec<(f64, f64)> = Vec::with_capacity(16);
    let mut origin = None;
    let (mut sum, mut count) = (0.0, 0u32);
    for point in points {
        let first: Point = *origin.get_or_insert(point);
        let next = ((point.x - first.x) as f64, (point.bound.saturating_sub(first.bound)) as f64);
        while let [.., a, b] = hull[..] {
            // b stays only if it is below the line from a to the next point.
            if (b.1 - a.1) * (next.0 - a.0) < (next.1 - a.1) * (b.0 - a.0) {
                break;
            }
            hull.pop();
        }
        hull.push(next);
        sum += next.0;
        count += 1;
    }
    let mean = sum / f64::from(count);
    // The edge of the hull that spans the mean time minimises the sum of the distances.
    let edge = hull.windows(2).find(|edge| edge[1].0 >= mean)?;
    Some((edge[1].1 - edge[0].1) / (edge[1].0 - edge[0].0))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Returns the sum of the points' distances to the highest line with this slope that is below all points.
    fn distances(points: &[Point], slope: f64) -> f64 {
        let above = |point: &Point| point.bound as f64 - slope * point.x as f64;
        let height = points.iter().map(above).fold(f64::INFINITY, f64::min);
        points.iter().map(|point| above(point) - height).sum()
    }

    proptest! {
        #[test]
        fn no_other_line_below_points_is_nearer(
            steps in proptest::collection::vec((1i64..2_000, -1_000i64..1_000), 2..24),
        ) {
            let mut x = 0;
            let points: Vec<Point> = steps
                .into_iter()
                .map(|(step, bound)| {
                    x += step;
                    Point { x, bound }
                })
                .collect();
            let distances_of_result = distances(&points, slope_below(points.iter().copied()).expect("two points"));
            for (n, a) in points.iter().enumerate() {
                for b in &points[n + 1..] {
                    let other_slope = (b.bound - a.bound) as f64 / (b.x - a.x) as f64;
                    prop_assert!(distances_of_result <= distances(&points, other_slope) + 1e-6);
                }
            }
        }
    }

    #[test]
    fn one_point_has_no_slope() {
        assert_eq!(slope_below([Point { x: 3, bound: 4 }].into_iter()), None);
        assert_eq!(slope_below(std::iter::empty()), None);
    }
}
