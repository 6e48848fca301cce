//! Tests of the chart of offset and delays.

use peernet_analysis::offset_trend::OffsetTrend;
use peernet_clock::Interval;

use super::super::chart::{OffsetView, tracks};
use super::super::time_series::LinkTimeSeries;
use super::super::tracks::TrackPicture;
use super::super::*;
use super::time_series;
use crate::tests::samples::{NOW, clock_point, link};
use crate::zone::Zone;

/// Returns the path with a CSS class in a track; `None` if the track has no such path.
pub(super) fn path(track: &TrackPicture, class: &str) -> Option<String> {
    let html = track.plot.to_string();
    let path = html.split(&format!("<path class=\"{class}\" d=\"")).nth(1)?;
    path.split('"').next().map(str::to_owned)
}

#[test]
fn gap_interrupts_lines_and_is_hatched() {
    let gap: Vec<i64> = (40..60).collect();
    let link = link(Some(0.00065), &gap);
    let subject = Subject::live(&link);
    let picture = tracks(&subject, &time_series(&link), OffsetView::DriftRemoved, &[], Zone::Utc);
    let offset = &picture.tracks[0];
    assert_eq!(offset.plot.to_string().matches("class=\"hatch\"").count(), 1);
    let band = path(offset, "band").expect("a band");
    assert_eq!(band.matches('Z').count(), 2, "{band}");
    assert!(path(offset, "dashed").is_some());
    assert!(picture.label.contains("1 stretch without a report"), "{}", picture.label);
    let strips = [0, 1].map(|at| picture.strips[at].to_string());
    assert!(
        strips[0].matches("<rect class=\"v-").count() == 2 && strips[1].contains("<rect class=\"v-warn\"")
    );
    let html = picture.to_string();
    assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
}

#[test]
fn chart_without_data_renders() {
    let mut empty = link(None, &[]);
    empty.history.clear();
    let subject = Subject::live(&empty);
    for view in [OffsetView::DriftRemoved, OffsetView::Measured] {
        let picture = tracks(&subject, &time_series(&empty), view, &[], Zone::Utc);
        assert!(picture.label.contains("Nothing was reported"), "{}", picture.label);
        assert!(!picture.to_string().contains("NaN"));
    }
}

#[test]
fn clock_step_outliers_change_neither_trend_nor_scale() {
    let mut link = link(Some(0.000_01), &[]);
    // A clock was set back by five seconds. The first second after the step still has the offset from before the step,
    // and the band of the next second is wide.
    for (index, point) in link.history.iter_mut().enumerate().skip(60) {
        let point = Arc::make_mut(point);
        point.relation_period = 2;
        let offset = point.offset.as_mut().expect("known");
        let step = if index == 60 { Span::ZERO } else { Span::from_seconds(5) };
        offset.estimate += step;
        let half = if index == 61 { Span::from_millis(40) } else { Span::from_micros(10) };
        offset.bounds = Interval { lo: offset.estimate - half, hi: offset.estimate + half };
    }
    let points: Vec<ClockPoint> = link.history.iter().map(|point| (**point).clone()).collect();
    let trend = OffsetTrend::of(&points);
    for point in &points[62..] {
        let residual = point.offset.as_ref().expect("known").estimate.seconds() - trend.at(2, point.at);
        assert!(residual.abs() < 1e-6, "{residual}");
    }
    let picture =
        tracks(&Subject::live(&link), &time_series(&link), OffsetView::DriftRemoved, &[], Zone::Utc);
    let axis = picture.tracks[0].axis.to_string();
    // The scale shows the usual bounds of ±0.01 ms, not the wide bounds of ±40 ms.
    assert!(axis.ends_with(">+0.015</text></svg>"), "{axis}");
}

#[test]
fn repeated_seconds_are_drawn_per_relation_period() {
    let at = |half_seconds: i64| WallTime::from_unix_nanos(NOW.unix_nanos() + half_seconds * 500_000_000);
    // A clock was set back, so each second is in two relation periods.
    let points: Vec<ClockPoint> = (0..40).map(|n| clock_point(at(n), (n % 2) as u64, Some(0.0005))).collect();
    let whole = LinkTimeSeries { from: at(0), to: at(40), bucket: 1, points };
    let mut subject_link = link(Some(0.0005), &[]);
    subject_link.history.clear();
    let picture = tracks(&Subject::live(&subject_link), &whole, OffsetView::DriftRemoved, &[], Zone::Utc);
    let band = path(&picture.tracks[0], "band").expect("a band");
    assert_eq!(band.matches('Z').count(), 2, "{band}");
}
