//! The clock offset of a link over time: the band of its bounds, the estimate in the band, and the
//! intervals of other sources.

use peernet_analysis::offset_trend::OffsetTrend;
use peernet_analysis::order::SortedValues;
use peernet_clock::{DelaySource, Interval, RelatedClocks, Span};
use peernet_figures::plot::Path;
use peernet_figures::scale::Scale;
use peernet_store::ClockPoint;

use super::chart::{ChartInput, OffsetView, beyond, distance_from_top, reach};
use super::tracks::Track;

/// If there are bands, an interval of another source extends the scale only if its size is at most
/// this multiple of the size of the bands.
const MAX_OTHER_RATIO: f64 = 4.0;
/// The scale ends at the widest band, but at most at this multiple of the 90th percentile of all bands.
const MAX_OUTLIER_RATIO: f64 = 1.5;

/// Lower and upper end of an interval in ms, as drawn.
type Ends = (f64, f64);

/// Returns the distance from zero of the end that is further away from zero.
fn larger_end((lo, hi): Ends) -> f64 {
    lo.abs().max(hi.abs())
}

/// Returns the end of a scale that shows most bands, from the size of each band. The bands right
/// after a clock step are wide, and may exceed the scale.
fn usual_size(sizes: impl Iterator<Item = f64>) -> f64 {
    sizes.collect::<SortedValues>().scale_end(0.9, MAX_OUTLIER_RATIO).unwrap_or(0.0)
}

/// Draws the offset of the clock of `cloud` from the clock of the edge.
pub(super) fn track(cloud: &str, input: &ChartInput<'_>, view: OffsetView) -> Track {
    let points = &input.time_series.points;
    let trend = match view {
        OffsetView::DriftRemoved => OffsetTrend::of(points),
        OffsetView::Measured => OffsetTrend::default(),
    };
    // The offset of a bucket is the offset at one time within the bucket, so the trend at that time is subtracted.
    let without_trend = |point: &ClockPoint, span: Span| {
        let at = point.offset.as_ref().map_or(point.at, |offset| offset.at);
        (span.seconds() - trend.at(point.relation_period, at)) * 1e3
    };
    let ends = |point: &ClockPoint, interval: Interval| {
        (without_trend(point, interval.lo), without_trend(point, interval.hi))
    };
    // If sources contradict each other, there is no band. The intervals of the other sources are drawn nevertheless.
    let offset = |point: &ClockPoint| point.offset.clone().filter(|offset| offset.is_consistent());
    let band = |point: &ClockPoint| Some(ends(point, offset(point)?.bounds));
    let interval_by = |point: &ClockPoint, source: DelaySource| {
        let (_, interval) = point.offset.as_ref()?.sources.iter().find(|(other, _)| *other == source)?;
        Some(ends(point, *interval))
    };

    let bands: Vec<Ends> = points.iter().filter_map(band).collect();
    let others = [DelaySource::Kernel, DelaySource::Chrony].map(|source| {
        (source, points.iter().filter_map(|point| interval_by(point, source)).collect::<Vec<Ends>>())
    });
    // Without bands, the intervals of the other sources alone determine the scale.
    let scale = match view {
        OffsetView::DriftRemoved => {
            let own = usual_size(bands.iter().copied().map(larger_end));
            let sizes = others.iter().map(|(_, intervals)| reach(intervals.iter().copied().map(larger_end)));
            let may_extend_scale = |size: &f64| bands.is_empty() || *size <= own * MAX_OTHER_RATIO;
            let most = sizes.filter(may_extend_scale).fold(own, f64::max);
            let ticks = 6;
            Scale::linear((-most, most)).widened(ticks).signed()
        }
        OffsetView::Measured => {
            let drawn: Vec<Ends> = if bands.is_empty() {
                others.iter().flat_map(|(_, intervals)| intervals.iter().copied()).collect()
            } else {
                bands.clone()
            };
            let hull = drawn.into_iter().reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
            let ticks = 5;
            Scale::linear(hull.unwrap_or_default()).widened(ticks).signed()
        }
    };

    let suffix = if view == OffsetView::DriftRemoved { ", drift removed" } else { "" };
    let quantity = match points.last().map(|point| point.clocks) {
        Some(RelatedClocks::Raw) => "offset of the free-running clock of",
        Some(RelatedClocks::RawToWall) => "offset, free-running clock to wall clock of",
        Some(RelatedClocks::Wall) | None => "clock offset of",
    };
    let mut track = Track::new(format!("{quantity} {cloud}{suffix}, ms"), scale);
    track.class = "tall";
    let band_path = input.with_breaks(points, |x, point| {
        let (lo, hi) = band(point)?;
        Some((x, distance_from_top(&scale, hi), distance_from_top(&scale, lo)))
    });
    track.draw("band", Path::band(band_path));
    let mut note = vec!["filled: bounds".to_owned()];
    for (source, intervals) in &others {
        if intervals.is_empty() {
            continue;
        }
        for end in [|ends: Ends| ends.0, |ends: Ends| ends.1] {
            // Values beyond the axis are left out, not drawn along its end.
            let at =
                |point: &ClockPoint| interval_by(point, *source).map(end).filter(|value| scale.has(*value));
            let line = input.with_breaks(points, |x, point| Some((x, distance_from_top(&scale, at(point)?))));
            track.draw("dashed", Path::line(line));
        }
        let is_on_scale = intervals.iter().any(|(lo, hi)| scale.has(*lo) || scale.has(*hi));
        let name = source.name();
        note.push(if is_on_scale {
            format!("dashed: {name}")
        } else {
            format!("{name}: wider than the axis")
        });
    }
    let estimate = |point: &ClockPoint| Some(without_trend(point, offset(point)?.estimate));
    let line = input.with_breaks(points, |x, point| Some((x, distance_from_top(&scale, estimate(point)?))));
    track.draw("strong", Path::line(line));
    note.push("line: estimate".to_owned());
    track.note = note.join(" · ");
    // The scale of the other view contains all bands.
    if view == OffsetView::DriftRemoved {
        track.beyond = beyond(bands.into_iter().map(larger_end), &scale, "ms");
    }
    track
}
