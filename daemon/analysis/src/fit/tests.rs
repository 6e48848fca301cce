use proptest::prelude::*;

use super::*;

/// NIST StRD "Norris", calibration of an ozone monitor: y, x.
const NORRIS: [(f64, f64); 36] = [
    (0.1, 0.2),
    (338.8, 337.4),
    (118.1, 118.2),
    (888.0, 884.6),
    (9.2, 10.1),
    (228.1, 226.5),
    (668.5, 666.3),
    (998.5, 996.3),
    (449.1, 448.6),
    (778.9, 777.0),
    (559.2, 558.2),
    (0.3, 0.4),
    (0.1, 0.6),
    (778.1, 775.5),
    (668.8, 666.9),
    (339.3, 338.0),
    (448.9, 447.5),
    (10.8, 11.6),
    (557.7, 556.0),
    (228.3, 228.1),
    (998.0, 995.8),
    (888.8, 887.6),
    (119.6, 120.2),
    (0.3, 0.3),
    (0.6, 0.3),
    (557.6, 556.8),
    (339.3, 339.1),
    (888.0, 887.2),
    (998.5, 999.0),
    (778.9, 779.0),
    (10.2, 11.1),
    (117.6, 118.3),
    (228.9, 229.2),
    (668.4, 669.1),
    (449.2, 448.9),
    (0.2, 0.5),
];

/// Anscombe 1973: the third set, a line with one outlier.
const ANSCOMBE_X: [f64; 11] = [10., 8., 13., 9., 11., 14., 6., 4., 12., 7., 5.];
const ANSCOMBE_THIRD: [f64; 11] = [7.46, 6.77, 12.74, 7.11, 7.81, 8.84, 6.08, 5.39, 8.15, 6.42, 5.73];

fn points(x: &[f64], y: &[f64]) -> Vec<Point> {
    x.iter().zip(y).map(|(&x, &y)| Point { x, y }).collect()
}

fn norris() -> Vec<Point> {
    NORRIS.iter().map(|&(y, x)| Point { x, y }).collect()
}

fn unweighted(points: &[Point]) -> Option<Fit> {
    least_squares(&points.iter().copied().map(WeightedPoint::from).collect::<Vec<_>>())
}

#[track_caller]
fn assert_near(value: f64, expected: f64) {
    assert!((value - expected).abs() <= 1e-9 * expected.abs().max(1e-3), "{value} is not {expected}");
}

#[track_caller]
fn assert_interval(estimate: Estimate, expected: (f64, f64)) {
    let (lo, hi) = estimate.interval.expect("enough points");
    assert_near(lo, expected.0);
    assert_near(hi, expected.1);
}

#[test]
fn least_squares_gives_certified_values() {
    let fit = unweighted(&norris()).expect("a line");
    assert_near(fit.intercept.value, -0.262323073774029);
    assert_near(fit.intercept.standard_error.expect("given"), 0.232818234301152);
    assert_near(fit.slope.value, 1.00211681802045);
    assert_near(fit.slope.standard_error.expect("given"), 0.429796848199937E-03);
    // Student's t, 34 degrees of freedom: 2.0322445093.
    let margin = 2.0322445093177186 * 0.429796848199937E-03;
    assert_interval(fit.slope, (1.00211681802045 - margin, 1.00211681802045 + margin));
}

/// The expected values are the exact solution of the weighted normal equations, in rational
/// numbers.
#[test]
fn weighted_fit_matches_normal_equations() {
    let y = [1.1, 1.9, 3.2, 3.9, 5.3];
    let weights = [4.0, 1.0, 9.0, 1.0, 0.25];
    let points = points(&[1., 2., 3., 4., 5.], &y);
    let weighted: Vec<WeightedPoint> =
        points.iter().zip(weights).map(|(&point, weight)| WeightedPoint { point, weight }).collect();
    let fit = least_squares(&weighted).expect("a line");
    assert!((fit.intercept.value - 0.07537473).abs() < 1e-8 && (fit.slope.value - 1.024197).abs() < 1e-6);
    let errors = [fit.intercept, fit.slope].map(|estimate| estimate.standard_error.expect("given"));
    assert!((errors[0] - 0.15496036).abs() < 1e-8 && (errors[1] - 0.05737273).abs() < 1e-8, "{errors:?}");
}

/// Values of SciPy's `theilslopes`; intercept as the median of y − slope · x.
#[test]
fn theil_sen_matches_reference_implementation() {
    let fit = theil_sen(&norris()).expect("a line");
    assert_near(fit.slope.value, 1.0021968365553604);
    assert_interval(fit.slope, (1.0011153245594469, 1.0030534351145037));

    let fit = theil_sen(&points(&ANSCOMBE_X, &ANSCOMBE_THIRD)).expect("a line");
    assert_near(fit.slope.value, 0.3455555555555555);
    assert_near(fit.intercept.value, 4.004444444444445);
    assert_interval(fit.slope, (0.345, 0.3475));

    // The example of Sen 1968.
    let fit = theil_sen(&points(&[1., 2., 3., 4., 10., 12., 18.], &[9., 15., 19., 20., 45., 55., 78.]));
    let fit = fit.expect("a line");
    assert_near(fit.slope.value, 4.0);
    assert_near(fit.intercept.value, 6.0);
    assert_interval(fit.slope, (3.7142857142857144, 4.375));

    // Several points at each x.
    let x = [1., 1., 1., 2., 2., 2., 3., 3., 3., 5., 5., 5.];
    let y = [1.0, 1.4, 0.7, 2.1, 2.6, 1.8, 3.3, 2.9, 3.6, 5.2, 4.7, 9.0];
    let fit = theil_sen(&points(&x, &y)).expect("a line");
    assert_near(fit.slope.value, 1.1);
    assert_near(fit.intercept.value, -0.1);
    assert_interval(fit.slope, (0.8666666666666667, 1.5));
}

#[test]
fn outlier_moves_least_squares_only() {
    let points = points(&ANSCOMBE_X, &ANSCOMBE_THIRD);
    let (least_squares_fit, theil_sen_fit) =
        (unweighted(&points).expect("a line"), theil_sen(&points).expect("a line"));
    assert!((least_squares_fit.slope.value - 0.4997).abs() < 1e-4);
    assert!((theil_sen_fit.slope.value - 0.3456).abs() < 1e-4);
}

#[test]
fn too_few_points_have_no_line_or_interval() {
    let two = points(&[1., 2.], &[1., 2.]);
    let one_x = points(&[1., 1., 1., 1.], &[1., 2., 3., 4.]);
    let not_a_number = points(&[1., 2., 3.], &[1., f64::NAN, 3.]);
    for points in [two, one_x, not_a_number, Vec::new()] {
        assert_eq!((unweighted(&points), theil_sen(&points)), (None, None));
    }
    let few = theil_sen(&points(&[1., 2., 3.], &[1., 2., 3.])).expect("a line");
    assert_eq!((few.slope.interval, few.intercept.interval), (None, None));
}

proptest! {
    #[test]
    fn exact_line_is_recovered(a in -1e3..1e3_f64, b in -1e3..1e3_f64, xs in prop::collection::vec(0.0..1e3_f64, 4..40)) {
        prop_assume!(xs.iter().any(|x: &f64| (x - xs[0]).abs() > 1.0));
        let points: Vec<Point> = xs.iter().map(|&x| Point { x, y: a + b * x }).collect();
        for fit in [unweighted(&points).expect("a line"), theil_sen(&points).expect("a line")] {
            prop_assert!((fit.slope.value - b).abs() < 1e-6, "{fit:?}");
            prop_assert!((fit.intercept.value - a).abs() < 1e-4, "{fit:?}");
        }
    }

    /// Compares the bisection with the definition: the median of the sorted slopes of all pairs.
    #[test]
    fn slope_equals_median_of_sorted_slopes(coordinates in prop::collection::vec((0_u8..6, -1e2..1e2_f64), 4..40)) {
        let points: Vec<Point> = coordinates.iter().map(|&(x, y)| Point { x: f64::from(x), y }).collect();
        let pair = |a: &Point, b: &Point| (a.x != b.x).then(|| (b.y - a.y) / (b.x - a.x));
        let slopes = points.iter().enumerate().flat_map(|(i, a)| points[i + 1..].iter().filter_map(move |b| pair(a, b)));
        let expected = slopes.collect::<crate::order::SortedValues>().median();
        let found = theil_sen(&points).map(|fit| fit.slope.value);
        match (expected, found) {
            (Some(expected), Some(found)) => prop_assert!((expected - found).abs() < 1e-9, "{expected} {found}"),
            other => prop_assert_eq!(other.0, other.1),
        }
    }

    /// A quarter of the points are late by an arbitrary time.
    #[test]
    fn late_quarter_of_points_does_not_move_theil_sen(late in 1.0..1e6_f64) {
        let y = |k: usize| 5.0 + 2.0 * k as f64 + if k % 4 == 1 { late * (k as f64).sqrt() } else { 0.0 };
        let points: Vec<Point> = (0..40).map(|k| Point { x: k as f64, y: y(k) }).collect();
        let fit = theil_sen(&points).expect("a line");
        prop_assert!((fit.slope.value - 2.0).abs() < 1e-6 && (fit.intercept.value - 5.0).abs() < 1e-6, "{fit:?}");
    }
}

#[test]
fn rate_is_given_if_interval_is_narrow() {
    let slope = |value: f64, interval| Estimate { value, standard_error: None, interval };
    // 10 ns per byte are 800 Mbit/s.
    let (value, margin) = rate(slope(1e-8, Some((0.8e-8, 1.2e-8)))).expect("a narrow interval");
    assert!((value - 8e8).abs() < 1.0 && (margin - 2e8).abs() < 1.0, "{value} {margin}");
    for interval in [None, Some((0.0, 2e-8)), Some((-1e-9, 2.1e-8)), Some((0.7e-8, 1.3e-8))] {
        assert_eq!(rate(slope(1e-8, interval)), None, "{interval:?}");
    }
}
