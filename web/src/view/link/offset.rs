//! The clock offset of a link over time: the certain band, the estimate in it, and the intervals of other sources.

use peernet_clock::{DelaySource, Interval, RelatedClocks, Span};
use peernet_figures::plot::Path;
use peernet_figures::scale::Scale;
use peernet_store::ClockPoint;

use super::chart::{OffsetView, Plan, below, beyond, reach};
use super::known;
use super::tracks::Track;
use super::trend::Trend;

/// Another source that is wider than the band by this factor does not extend the scale.
const WIDER: f64 = 4.0;
/// Room around the bands that nine of ten stay within.
const ROOM: f64 = 1.5;

/// Lower and upper end in ms, as drawn.
type Ends = (f64, f64);

fn larger((lo, hi): Ends) -> f64 {
    lo.abs().max(hi.abs())
}

/// Returns the scale for most bands. Bands that are wide right after a step, or that belong to the time before it, may exceed it.
fn usual(sizes: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = sizes.filter(|size| size.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let most = sorted.len().saturating_sub(1) * 9 / 10;
    sorted.get(most).map_or(0.0, |most| sorted.last().map_or(*most, |last| last.min(most * ROOM)))
}

/// Returns the track of the offset of `cloud`.
pub(super) fn track(cloud: &str, plan: &Plan<'_>, view: OffsetView) -> Track {
    let points = &plan.course.points;
    let trend = match view {
        OffsetView::Removed => Trend::of(points),
        OffsetView::Measured => Trend::default(),
    };
    // Of a bucket the offset is that of one moment in it: the trend is taken out there.
    let shown = |point: &ClockPoint, span: Span| {
        let at = point.offset.as_ref().map_or(point.at, |offset| offset.at);
        (span.seconds() - trend.at(point.window, at)) * 1e3
    };
    let ends =
        |point: &ClockPoint, interval: Interval| (shown(point, interval.lo), shown(point, interval.hi));
    // Where sources contradict each other there is no band; the intervals of other sources are drawn nevertheless.
    let offset = |point: &ClockPoint| point.offset.clone().filter(|offset| known(offset).is_some());
    let band = |point: &ClockPoint| Some(ends(point, offset(point)?.bounds));
    let said = |point: &ClockPoint, source: DelaySource| {
        let (_, interval) = point.offset.as_ref()?.sources.iter().find(|(from, _)| *from == source)?;
        Some(ends(point, *interval))
    };

    let certain: Vec<Ends> = points.iter().filter_map(band).collect();
    let others = [DelaySource::Kernel, DelaySource::Chrony]
        .map(|source| (source, points.iter().filter_map(|point| said(point, source)).collect::<Vec<Ends>>()));
    let scale = match view {
        OffsetView::Removed => {
            let own = usual(certain.iter().copied().map(larger));
            let sizes = others.iter().map(|(_, said)| reach(said.iter().copied().map(larger)));
            let most = sizes.filter(|size| *size <= own * WIDER).fold(own, f64::max);
            Scale::linear((-most, most)).widened(6).signed()
        }
        OffsetView::Measured => {
            let span = |(lo, hi): Ends, one: &Ends| (lo.min(one.0), hi.max(one.1));
            let (lo, hi) = certain.iter().fold((f64::INFINITY, f64::NEG_INFINITY), span);
            Scale::linear((lo, hi)).widened(5).signed()
        }
    };

    let what = if view == OffsetView::Removed { ", drift removed" } else { "" };
    let of = match points.last().map(|point| point.clocks) {
        Some(RelatedClocks::Raw) => "offset of the free-running clock of",
        Some(RelatedClocks::RawToWall) => "offset, free-running clock to wall clock of",
        Some(RelatedClocks::Wall) | None => "clock offset of",
    };
    let mut track = Track::new(format!("{of} {cloud}{what}, ms"), scale);
    track.class = "tall";
    let filled = plan.broken(points, |x, point| {
        let (lo, hi) = band(point)?;
        Some((x, below(&scale, hi), below(&scale, lo)))
    });
    track.draw("band", Path::band(filled));
    let mut note = vec!["filled: certain".to_owned()];
    for (source, said_by) in &others {
        if said_by.is_empty() {
            continue;
        }
        for end in [|ends: Ends| ends.0, |ends: Ends| ends.1] {
            // Values beyond the axis are left out, not drawn along its end.
            let at = |point: &ClockPoint| said(point, *source).map(end).filter(|value| scale.has(*value));
            let line = plan.broken(points, |x, point| Some((x, below(&scale, at(point)?))));
            track.draw("dashed", Path::line(line));
        }
        let seen = said_by.iter().any(|(lo, hi)| scale.has(*lo) || scale.has(*hi));
        let name = source.name();
        note.push(if seen { format!("dashed: {name}") } else { format!("{name}: wider than the axis") });
    }
    let estimate = |point: &ClockPoint| Some(shown(point, offset(point)?.estimate));
    let line = plan.broken(points, |x, point| Some((x, below(&scale, estimate(point)?))));
    track.draw("strong", Path::line(line));
    note.push("line: estimate".to_owned());
    track.note = note.join(" · ");
    if view == OffsetView::Removed {
        track.beyond = beyond(certain.into_iter().map(larger), &scale, "ms");
    }
    track
}
