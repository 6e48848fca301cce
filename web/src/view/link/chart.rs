//! The picture of a link over time.

use peernet_clock::{Span, Verdict, WallTime};
use peernet_statistics::number::{SPACE, bound, bound_ms, count, figure, length};
use peernet_store::{ClockPoint, IncidentRow};
use serde::Deserialize;

use super::super::chip::Chip;
use super::super::incidents::IncidentLine;
use super::super::speed::NetworkDirection;
use super::course::Course;
use super::delays::{bounds, of_point};
use super::{Subject, known, offset};
use crate::svg::{Gap, Percent, RailSign, Ruler, Segment, Strip, Track, Tracks, pen};
use crate::zone::Zone;

/// View of an offset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum OffsetView {
    /// Without the part that a steady drift explains.
    #[default]
    Removed,
    /// As measured.
    Measured,
}

impl OffsetView {
    /// Returns the word for an address.
    pub(crate) const fn word(self) -> &'static str {
        match self {
            Self::Removed => "removed",
            Self::Measured => "measured",
        }
    }
}

/// Whiskers over the whole width.
const WHISKERS: f64 = 60.0;
/// Width of a gap from which on its reason is shown above it.
const REASON_FITS: f64 = 8.0;
/// Distance of signs below which they would overlap.
const SIGN_FITS: f64 = 2.2;
/// A value larger than this multiple of the 95th percentile does not extend the scale.
const TAIL: f64 = 3.0;

pub(super) struct Plan<'a> {
    pub(super) course: &'a Course,
    /// The course with few enough points for whiskers.
    coarse: Course,
    gaps: Vec<(WallTime, WallTime)>,
}

impl Plan<'_> {
    fn x(&self, at: WallTime) -> f64 {
        (at - self.course.from).seconds() / self.course.seconds().max(1.0)
    }

    /// Returns a value of each point in milliseconds or another unit, with breaks where points are missing. Where a clock was set
    /// back, seconds come twice: each window is drawn for itself.
    pub(super) fn broken<T>(
        &self,
        points: &[ClockPoint],
        of: impl Fn(f64, &ClockPoint) -> Option<T>,
    ) -> Vec<Option<T>> {
        let mut drawn = Vec::with_capacity(points.len() + self.gaps.len());
        let mut before: Option<&ClockPoint> = None;
        let mut windows: Vec<u64> = Vec::new();
        for point in points {
            if !windows.contains(&point.window) {
                windows.push(point.window);
            }
        }
        let parts =
            windows.iter().flat_map(|window| points.iter().filter(move |point| point.window == *window));
        for point in parts {
            let parted = |before: &ClockPoint| {
                before.window != point.window
                    || self.gaps.iter().any(|(from, to)| before.at <= *from && *to <= point.at)
            };
            if before.is_some_and(parted) {
                drawn.push(None);
            }
            drawn.push(of(self.x(point.at), point));
            before = Some(point);
        }
        drawn
    }
}

/// Returns the largest value, but at most [`TAIL`] times the 95th percentile.
pub(super) fn reach(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let Some(largest) = sorted.last().copied() else { return 0.0 };
    let most = sorted[(sorted.len() - 1) * 19 / 20];
    if most > 0.0 { largest.min(most * TAIL) } else { largest }
}

/// Returns the number of values beyond the end of a scale, in words.
pub(super) fn beyond(values: impl Iterator<Item = f64>, ruler: &Ruler, unit: &str) -> Option<String> {
    let many = values.filter(|value| *value > ruler.end()).count() as u64;
    (many > 0).then(|| format!("{} beyond {}{SPACE}{unit} ↑", count(many), ruler.end_label()))
}

/// Returns the picture of a course.
pub(crate) fn tracks(
    subject: &Subject<'_>,
    course: &Course,
    view: OffsetView,
    incidents: &[IncidentRow],
    zone: Zone,
) -> Tracks {
    let seconds = (course.seconds() / WHISKERS).ceil() as i64;
    let gaps = course.gaps();
    let plan = Plan { course, coarse: course.thinned(seconds), gaps };
    let mut all = Vec::new();
    if !subject.same_clock() {
        all.push(offset::track(&subject.cloud, &plan, view));
    }
    all.push(delays(&plan));
    // Between hosts that read one clock there may be nothing to probe for.
    if !subject.same_clock() || course.probes().sent > 0 {
        all.push(round_trips(&plan));
    }
    Tracks {
        label: finding(subject, &plan, incidents.len()),
        signs: signs(&plan, incidents, zone),
        gaps: plan.gaps.iter().map(|(from, to)| gap(&plan, *from, *to)).collect(),
        strips: [NetworkDirection::Up, NetworkDirection::Down].map(|way| strip(&plan, way)).to_vec(),
        tracks: all,
        times: times(course, zone),
    }
}

fn percent(share: f64) -> Percent {
    Percent((share * 100.0).clamp(0.0, 100.0))
}

fn gap(plan: &Plan<'_>, from: WallTime, to: WallTime) -> Gap {
    let (x, end) = (percent(plan.x(from)), percent(plan.x(to)));
    let width = Percent(end.0 - x.0);
    let text = (width.0 >= REASON_FITS).then_some("no report");
    Gap { x, width, middle: Percent(x.0 + width.0 / 2.0), text }
}

fn signs(plan: &Plan<'_>, incidents: &[IncidentRow], zone: Zone) -> Vec<RailSign> {
    let mut rows: Vec<&IncidentRow> = incidents.iter().collect();
    rows.sort_by_key(|row| row.at);
    let mut last = f64::NEG_INFINITY;
    let signs = rows.into_iter().map(|row| {
        let line = IncidentLine::new(row, zone);
        let x = percent(plan.x(row.at));
        let shown = x.0 - last >= SIGN_FITS;
        if shown {
            last = x.0;
        }
        RailSign { x, sign: line.sign, tone: line.tone.class(), shown }
    });
    signs.collect()
}

fn strip(plan: &Plan<'_>, way: NetworkDirection) -> Strip {
    let half = plan.course.bucket as f64 / plan.course.seconds().max(1.0);
    let mut segments: Vec<(f64, f64, Verdict)> = Vec::new();
    for point in &plan.course.points {
        let Some(verdict) = of_point(point, way).map(|second| second.verdict) else { continue };
        let end = plan.x(point.at);
        let begin = (end - half).max(0.0);
        match segments.last_mut() {
            Some((_, to, same)) if *same == verdict && begin - *to < half * 0.75 => *to = end,
            _ => segments.push((begin, end, verdict)),
        }
    }
    let segments = segments.into_iter().map(|(from, to, verdict)| {
        let (x, width) = (percent(from), Percent((to.min(1.0) - from) * 100.0));
        let text = Some(format!("{} {verdict}", way.delay())).filter(|text| width.0 >= Segment::room(text));
        Segment { x, width, tone: Chip::verdict(verdict).tone.class(), text }
    });
    Strip { segments: segments.collect() }
}

fn delays(plan: &Plan<'_>) -> Track {
    let points = &plan.coarse.points;
    let both = [NetworkDirection::Up, NetworkDirection::Down];
    let upper = || {
        let medians =
            points.iter().flat_map(|point| both.map(|way| of_point(point, way).and_then(|one| one.median)));
        medians.flatten().map(|median| bounds(&median).1 * 1e3)
    };
    let ruler = Ruler::from_zero(reach(upper()), 3);
    let mut track =
        Track::new(format!("one-way delay, median of {}, ms", bucket(plan.coarse.bucket)), &ruler);
    track.note = "whiskers: contain the true value".to_owned();
    track.beyond = beyond(upper(), &ruler, "ms");
    let half = plan.coarse.bucket as f64 / plan.course.seconds().max(1.0) / 2.0;
    for (way, whiskers, dots) in [
        (NetworkDirection::Up, "whiskers up", "dots up"),
        (NetworkDirection::Down, "whiskers down", "dots down"),
    ] {
        let known: Vec<(f64, f64, f64, f64)> = points
            .iter()
            .filter_map(|point| {
                let median = of_point(point, way)?.median.filter(|median| !median.value.is_negative())?;
                let (lo, hi) = bounds(&median);
                let at = |seconds: f64| ruler.below(seconds * 1e3);
                Some(((plan.x(point.at) - half).max(0.0), at(hi), at(lo), at(median.value.seconds())))
            })
            .collect();
        track.draw(whiskers, pen::whiskers(known.iter().map(|(x, hi, lo, _)| (*x, *hi, *lo)), 0.003));
        track.draw(dots, pen::dots(known.iter().map(|(x, _, _, value)| (*x, *value))));
    }
    track
}

fn round_trips(plan: &Plan<'_>) -> Track {
    let points = &plan.course.points;
    let medians =
        || points.iter().filter_map(|point| point.round_trip).map(|trip| trip.median.seconds() * 1e3);
    let ruler = Ruler::from_zero(reach(medians()), 3);
    let mut track = Track::new("probe round trip, ms".to_owned(), &ruler);
    track.note = "strong: smallest · faint: median · ticks: lost probes, by their share".to_owned();
    track.beyond = beyond(medians(), &ruler, "ms");
    let line = |of: fn(&peernet_stream::RoundTrip) -> Span| {
        pen::line(plan.broken(points, |x, point| {
            Some((x, ruler.below(of(point.round_trip.as_ref()?).seconds() * 1e3)))
        }))
    };
    track.draw("faint", line(|trip| trip.median));
    track.draw("strong", line(|trip| trip.min));
    let lost = points.iter().filter(|point| point.probes.lost > 0).map(|point| {
        let share = f64::from(point.probes.lost) / f64::from(point.probes.sent.max(1));
        (plan.x(point.at), 0.03, 0.05 + 0.15 * (share * 5.0).min(1.0))
    });
    track.draw("lost", pen::ticks(lost));
    track
}

/// Returns the width of a bucket in words: `2 s`, `24 min`.
fn bucket(seconds: i64) -> String {
    if seconds < 60 { format!("{seconds}{SPACE}s") } else { length(seconds as f64) }
}

/// Round times of day along the axis.
fn times(course: &Course, zone: Zone) -> Vec<(Percent, String)> {
    const STEPS: [i64; 9] = [60, 120, 300, 600, 1_800, 3_600, 7_200, 14_400, 86_400];
    let seconds = course.seconds();
    let step = STEPS.into_iter().find(|step| seconds / *step as f64 <= 12.0).unwrap_or(86_400);
    let east = i64::from(zone.offset_seconds(course.to));
    let first = (course.from.unix_seconds() + east).div_euclid(step) + 1;
    let ticks = (first..).map(|tick| WallTime::from_unix_nanos((tick * step - east) * 1_000_000_000));
    let ticks = ticks.take_while(|at| *at <= course.to).take(20);
    let ticks =
        ticks.map(|at| (Percent((at - course.from).seconds() / seconds * 100.0), zone.moment(at).minute()));
    // A label at the very end would extend beyond the picture.
    ticks.filter(|(x, _)| (1.5..=98.5).contains(&x.0)).collect()
}

/// Returns the range of some values in words: `0.61 to 0.70 ms`.
fn range(values: impl Iterator<Item = f64>) -> Option<String> {
    let (lo, hi) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), one| (lo.min(one), hi.max(one)));
    lo.is_finite().then(|| format!("{} to {}{SPACE}ms", figure(lo * 1e3), figure(hi * 1e3)))
}

fn finding(subject: &Subject<'_>, plan: &Plan<'_>, incidents: usize) -> String {
    let course = plan.course;
    let mut text = format!("{} over {}.", subject.route(), length(course.seconds()));
    if course.points.is_empty() {
        return format!("{text} Nothing was reported.");
    }
    for way in [NetworkDirection::Up, NetworkDirection::Down] {
        let seconds = plan.coarse.points.iter().filter_map(|point| of_point(point, way));
        let worst = seconds.clone().map(|second| second.verdict).max_by_key(|verdict| verdict.severity());
        if let Some(range) =
            range(seconds.filter_map(|second| second.median).map(|median| median.value.seconds()))
        {
            let worst = worst.map_or_else(String::new, |verdict| format!(", worst verdict {verdict}"));
            text.push_str(&format!(" Median {} {range}{worst}.", way.delay()));
        }
    }
    let widths: Vec<f64> = course
        .points
        .iter()
        .filter_map(|point| known(point.offset.as_ref()?))
        .map(|(_, half)| half)
        .collect();
    if let (Some(least), Some(most), false) = (
        widths.iter().copied().reduce(f64::min),
        widths.iter().copied().reduce(f64::max),
        subject.same_clock(),
    ) {
        text.push_str(&format!(" The offset was known to {} to {}.", bound_ms(least), bound(most)));
    }
    let probes = course.probes();
    text.push_str(&format!(
        " {} of {} probes were lost.",
        count(probes.lost.into()),
        count(probes.sent.into())
    ));
    if !plan.gaps.is_empty() {
        text.push_str(&format!(
            " {} without a report.",
            crate::view::counted(plan.gaps.len(), "stretch", "stretches")
        ));
    }
    if incidents > 0 {
        text.push_str(&format!(" {}.", crate::view::counted(incidents, "incident", "incidents")));
    }
    text
}
