//! Tests of the summaries of columns.

use super::*;
use crate::testing::{rows, to_rows};

#[test]
fn quantity_matches_reference_statistics() {
    // Python: v = [n**1.5 for n in range(1, 301)]; fmean(v), stdev(v), median(v), quantiles(v, n=100,
    // method="inclusive")[94::4], max(v); numpy's mean, std(ddof=1) and percentile are the same.
    const PYTHON: [f64; 6] = [
        2087.128355048523,
        1564.3296713356758,
        1846.318185965752,
        4812.621015329932,
        5118.664040859593,
        5196.152422706632,
    ];
    let quantity =
        Quantity::from_values("x".into(), (1..=300).map(|n| f64::from(n).powf(1.5))).expect("numbers");
    let close = |value: f64, expected: f64| (value - expected).abs() < 1e-9 * expected;
    assert!(close(quantity.mean, PYTHON[0]), "{}", quantity.mean);
    assert!(close(quantity.std.expect("many numbers"), PYTHON[1]), "{:?}", quantity.std);
    assert!(close(quantity.median, PYTHON[2]), "{}", quantity.median);
    assert!(close(quantity.p95.expect("many numbers"), PYTHON[3]), "{:?}", quantity.p95);
    assert!(close(quantity.p99.expect("many numbers"), PYTHON[4]), "{:?}", quantity.p99);
    assert!(close(quantity.max, PYTHON[5]), "{}", quantity.max);
}

#[test]
fn extreme_numbers_are_left_out_of_mean() {
    let values = [1.0, f64::MAX, -f64::MAX, f64::INFINITY, f64::NAN, 3.0];
    let quantity = Quantity::from_values("x".into(), values).expect("numbers");
    assert_eq!((quantity.count, quantity.mean, quantity.max), (2, 2.0, 3.0));
    assert!(quantity.std.is_some_and(f64::is_finite), "{quantity:?}");
}

#[test]
fn percentiles_need_enough_numbers() {
    let available = |count: u32| {
        let quantity = Quantity::from_values("x".into(), (0..count).map(f64::from)).expect("numbers");
        (quantity.std.is_some(), quantity.p95.is_some(), quantity.p99.is_some())
    };
    assert_eq!(
        [1, 59, 60, 299, 300].map(available),
        [
            (false, false, false),
            (true, false, false),
            (true, true, false),
            (true, true, false),
            (true, true, true),
        ]
    );
    assert_eq!(Quantity::from_values("x".into(), [f64::NAN, f64::INFINITY]), None);
}

#[test]
fn warm_up_and_lost_rows_are_excluded() {
    let summary = Summary::from_rows(&to_rows(&rows(10)));
    let upload = summary.quantity("upload").expect("measured");
    assert_eq!((upload.count, upload.max), (7, 0.01701));
    // The median is the delay of iteration 7, which is 17,007 ± 10 µs.
    assert_eq!(upload.bounds, Some((0.016997, 0.017017)));
    assert_eq!(summary.quantity("upload-throughput").expect("measured").bounds, Some((4e8, f64::INFINITY)));
    assert_eq!(summary.counts, Counts { ok: 7, lost: 1, warm_up: 2, ..Counts::default() });
}
