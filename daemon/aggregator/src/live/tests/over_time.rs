//! Tests of the charts over time: numbers compared with exact values.

use peernet_logger::stage;
use peernet_statistics::Summary;

use super::{START, Testbed, second};
use crate::live_state::PercentileSeries;

/// Returns the percentiles of a pipeline whose second `n` has iterations with the totals `seconds[n]`. Each second is
/// reported at its end.
fn series(seconds: &[Vec<f64>]) -> PercentileSeries {
    let mut testbed = Testbed::new();
    for (at, totals) in seconds.iter().enumerate() {
        testbed.send(at as f64 + 0.99, vec![second(at as i64, totals, 0)]);
    }
    testbed.snapshot(seconds.len() as f64).pipelines[0].total_p95.clone()
}

/// Returns the exact 95th percentile.
fn exact_p95(mut totals: Vec<f64>) -> f64 {
    totals.sort_by(f64::total_cmp);
    let rank = 0.95 * (totals.len() - 1) as f64;
    let (below, above) = (totals[rank.floor() as usize], totals[rank.ceil() as usize]);
    below + (above - below) * rank.fract()
}

#[test]
fn percentile_covers_all_iterations_of_its_bucket() {
    // Each second has eight iterations of 9 to 13 ms, but one of the iterations in second 25 takes 1.4 s.
    let mut seconds: Vec<Vec<f64>> =
        (0..60).map(|at| (0..8).map(|n| 0.009 + 1e-4 * f64::from((7 * at + 5 * n) % 40)).collect()).collect();
    seconds[25][3] = 1.4;
    let series_of_percentiles = series(&seconds);
    assert_eq!(series_of_percentiles.bucket_s, Some(10), "10 s hold 80 iterations, 5 s would hold 40");
    assert_eq!(START.rem_euclid(10), 0);
    assert_eq!(series_of_percentiles.points.len(), 6);
    for (bucket, point) in series_of_percentiles.points.iter().enumerate() {
        let bucket_totals: Vec<f64> = seconds[10 * bucket..10 * bucket + 10].concat();
        assert_eq!((point.at, point.count), (START + 10 * bucket as i64, 80));
        let exact = exact_p95(bucket_totals);
        assert!((point.p95 - exact).abs() <= 0.0101 * exact, "{point:?}, exact: {exact}");
        assert!(
            point.p95 < 0.014,
            "one slow iteration of 80 must not determine the 95th percentile: {point:?}"
        );
    }
}

#[test]
fn buckets_of_slow_pipeline_hold_sixty_iterations() {
    let bucket = |interval_s: usize, iterations_per_second: usize| {
        let seconds: Vec<Vec<f64>> = (0..600)
            .map(|at| if at % interval_s == 0 { vec![0.010; iterations_per_second] } else { Vec::new() })
            .collect();
        let series_of_percentiles = series(&seconds);
        assert!(
            series_of_percentiles.points.iter().all(|point| point.count >= 60),
            "{series_of_percentiles:?}"
        );
        (series_of_percentiles.bucket_s, series_of_percentiles.points.len())
    };
    assert_eq!(bucket(1, 100), (Some(1), 600));
    assert_eq!(bucket(1, 30), (Some(5), 120), "2 s would hold 60, or 59 by chance");
    assert_eq!(bucket(1, 2), (Some(60), 10));
    assert_eq!(bucket(2, 1), (Some(300), 2));
    assert_eq!(bucket(10, 1), (None, 0), "the longest bucket holds 60, which leaves no margin");
}

#[test]
fn incomplete_bucket_with_sixty_iterations_has_percentile() {
    let mut testbed = Testbed::new();
    for at in 0..25 {
        testbed.send(at as f64 + 0.99, vec![second(at, &[0.010; 8], 0)]);
    }
    let newest =
        |testbed: &mut Testbed, at| testbed.snapshot(at).pipelines[0].total_p95.points.last().copied();
    assert_eq!(
        newest(&mut testbed, 25.0).map(|point| point.at),
        Some(START + 10),
        "the newest bucket holds 40 iterations"
    );
    for at in 25..28 {
        testbed.send(at as f64 + 0.99, vec![second(at, &[0.010; 8], 0)]);
    }
    let point = newest(&mut testbed, 28.0).expect("the newest bucket holds 64 iterations");
    assert_eq!((point.at, point.count), (START + 20, 64));
    // A repeated report of a second replaces the earlier report, also if the bucket has a percentile already.
    testbed.send(28.2, vec![second(12, &[0.050; 8], 0)]);
    let points = testbed.snapshot(28.2).pipelines[0].total_p95.points.clone();
    assert_eq!(points[1].count, 80);
    assert!((points[1].p95 - 0.050).abs() < 0.001, "{points:?}");
}

#[test]
fn percentiles_follow_clock_that_is_set_back() {
    let mut testbed = Testbed::new();
    for at in 0..40 {
        testbed.send(at as f64 + 0.99, vec![second(at, &[0.010; 8], 0)]);
    }
    let host = testbed.host;
    let pipelines = vec![super::pipeline("line", vec![second(15, &[0.010; 8], 0)])];
    testbed.live.apply(super::update(host, super::wall(15.9), pipelines), super::now(40.9));
    let points = testbed.snapshot(40.9).pipelines[0].total_p95.points.clone();
    assert_eq!(
        points.iter().map(|point| point.at - START).collect::<Vec<_>>(),
        [0],
        "the bucket from 10 s on holds 48 iterations"
    );
}

#[test]
fn pause_of_pipeline_does_not_lengthen_buckets() {
    let mut seconds: Vec<Vec<f64>> = vec![vec![0.010; 8]; 100];
    let mut testbed = Testbed::new();
    seconds.extend(vec![vec![0.010; 8]; 100]);
    for (at, totals) in seconds.iter().enumerate() {
        let at = if at < 100 { at } else { at + 300 };
        testbed.send(at as f64 + 0.99, vec![second(at as i64, totals, 0)]);
    }
    let series_of_percentiles = testbed.snapshot(500.0).pipelines[0].total_p95.clone();
    assert_eq!((series_of_percentiles.bucket_s, series_of_percentiles.points.len()), (Some(10), 20));
}

#[test]
fn transfer_speed_is_total_bytes_per_total_time() {
    // Nine messages of 10 kB in 20 µs and one of 122 kB in 3.58 ms.
    let messages = [vec![(10_000.0, 20e-6); 9], vec![(122_000.0, 3.58e-3)]].concat();
    let summary = |value_of: fn(&(f64, f64)) -> f64| {
        let mut summary = Summary::default();
        messages.iter().for_each(|message| summary.record(value_of(message)));
        summary
    };
    let ratios = summary(|(bytes, seconds)| 8.0 * bytes / seconds);
    let mut second_with_transfers = second(0, &[], 0);
    second_with_transfers.values = vec![
        (stage::UPLOAD, summary(|(_, seconds)| *seconds)),
        (stage::UPLOAD_BYTES, summary(|(bytes, _)| *bytes)),
        (stage::UPLOAD_THROUGHPUT, ratios),
    ];
    let mut testbed = Testbed::new();
    testbed.send(0.99, vec![second_with_transfers]);
    let pipeline = &testbed.snapshot(1.0).pipelines[0];
    let exact = 8.0 * 212_000.0 / 3.76e-3;
    for transfers in [pipeline.windows[1].transfers, pipeline.series[0].transfers] {
        let up = transfers.up.expect("something was sent");
        assert!((up.speed().expect("delays are known") / exact - 1.0).abs() < 1e-9, "{up:?}");
        assert!((up.bytes - 212_000.0).abs() < 1e-6 && transfers.down.is_none(), "{up:?}");
    }
    let ratios = pipeline.windows[1].value("upload-throughput").expect("reported").mean;
    assert!(ratios > 8.0 * exact, "the mean of the ratios is more than eight times the speed: {ratios}");
}

#[test]
fn rate_of_new_pipeline_covers_time_since_its_start() {
    let mut testbed = Testbed::new();
    // Half of the last second has passed, with half of its iterations.
    for at in 0..5 {
        testbed.send(at as f64 + 0.5, vec![second(at, &[0.010; 8][..if at == 4 { 4 } else { 8 }], 0)]);
    }
    let windows = &testbed.snapshot(4.5).pipelines[0].windows;
    assert_eq!(windows.each_ref().map(|window| window.covered_s), [1.5, 4.5, 4.5]);
    assert_eq!(windows.each_ref().map(|window| window.rate_hz), [8.0; 3]);
}
