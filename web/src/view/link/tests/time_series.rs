//! Tests of the points of a chart, and of the trend of the offset.

use peernet_analysis::offset_trend::OffsetTrend;
use peernet_stream::RoundTrip;

use super::super::time_series::{LinkTimeSeries, live_probes};
use super::super::*;
use crate::tests::samples::{NOW, clock_point};

#[test]
fn chart_removes_steady_drift_and_breaks_at_step() {
    let at = |ago: i64| WallTime::from_unix_nanos((NOW.unix_seconds() - ago) * 1_000_000_000);
    let mut points: Vec<ClockPoint> =
        (0..100).rev().map(|ago| clock_point(at(ago), u64::from(ago < 50), Some(0.0005))).collect();
    points[50..].iter_mut().filter_map(|point| point.offset.as_mut()).for_each(|offset| {
        offset.estimate += Span::from_seconds(3);
    });
    let trend = OffsetTrend::of(&points);
    for point in &points {
        let estimate = point.offset.as_ref().expect("known").estimate.seconds();
        assert!((estimate - trend.at(point.relation_period, point.at)).abs() < 1e-9);
    }
}

#[test]
fn merged_points_keep_widest_bounds_and_all_probes() {
    let at = |second: i64| WallTime::from_unix_nanos(second * 1_000_000_000);
    let points = vec![
        clock_point(at(11), 1, Some(0.0005)),
        clock_point(at(12), 1, Some(0.0020)),
        clock_point(at(20), 1, Some(0.0005)),
        clock_point(at(21), 1, Some(0.0005)),
    ];
    let whole = LinkTimeSeries { from: at(10), to: at(30), bucket: 1, points };
    let thin = whole.merged(10);
    assert_eq!(thin.points.iter().map(|point| point.at).collect::<Vec<_>>(), [at(20), at(21)]);
    let first = &thin.points[0];
    let width = first.offset.as_ref().expect("known").bounds.width().seconds();
    assert!((width - 0.004).abs() < 1e-6, "{width}");
    assert_eq!(first.probes.sent, 30);
    assert_eq!(first.up.expect("data").count, 90);
    assert_eq!(whole.gaps(), [(at(12), at(20)), (at(21), at(30))]);
}

#[test]
fn list_of_links_and_page_have_equal_probes() {
    let at = |second: i64| WallTime::from_unix_nanos(second * 1_000_000_000);
    let history: Vec<Arc<ClockPoint>> = (1..=701)
        .map(|second| {
            let mut point = clock_point(at(second), 1, Some(0.0005));
            point.round_trip = (second < 690)
                .then(|| RoundTrip { min: Span::from_millis(second), median: Span::from_millis(2 * second) });
            Arc::new(point)
        })
        .collect();
    for end in [600, 700, 701] {
        let live = LinkTimeSeries::live(&history, at(end), 600);
        let newest = live.points.iter().rev().find_map(|point| point.round_trip);
        assert!(newest.is_some());
        assert_eq!(live_probes(&history, at(end)), (live.probes(), newest), "{end}");
    }
}

#[test]
fn cloud_times_are_converted_by_offset_of_their_time() {
    let at = |ago: i64| WallTime::from_unix_nanos((NOW.unix_seconds() - ago) * 1_000_000_000);
    let mut points: Vec<ClockPoint> =
        (0..60).rev().map(|ago| clock_point(at(ago), 1, Some(0.0005))).collect();
    // Half a minute ago the edge was set forward by three seconds.
    for point in &mut points[30..] {
        let offset = point.offset.as_mut().expect("known");
        offset.estimate = offset.estimate - Span::from_seconds(3);
    }
    let time_series = LinkTimeSeries { from: at(60), to: at(0), bucket: 1, points };
    for ago in [50, 10] {
        let estimate = time_series.points[59 - ago as usize].offset.as_ref().expect("known").estimate;
        let placed = time_series.edge_time_at(at(ago) + estimate);
        assert!((placed - at(ago)).abs() < Span::from_millis(1), "{ago}");
    }
}
