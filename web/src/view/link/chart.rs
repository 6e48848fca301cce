//! The chart of a link over time.

use peernet_analysis::order::SortedValues;
use peernet_analysis::transfer::DirectionNodes;
use peernet_clock::{Direction, Span, Verdict, WallTime};
use peernet_figures::look::{Style, TextStyle};
use peernet_figures::plot::{At, Item, Label, Path};
use peernet_figures::scale::{Scale, Tick, times_of_day};
use peernet_statistics::number::{self, SPACE, bound, bound_ms, count, figure, long_duration};
use peernet_store::{ClockPoint, IncidentRow};
use serde::Deserialize;

use super::super::chip::{Chip, Tone};
use super::super::incidents::IncidentLine;
use super::delays::{delays_of_point, non_negative_bounds};
use super::time_series::LinkTimeSeries;
use super::tracks::{AxisPosition, IncidentSign, Track, Tracks, span};
use super::{Subject, estimate_and_max_error, offset};
use crate::picture::Picture;
use crate::zone::Zone;

/// View of an offset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum OffsetView {
    /// The offset minus the part that a steady drift explains.
    #[default]
    #[serde(rename = "removed")]
    DriftRemoved,
    /// The offset as measured.
    Measured,
}

impl OffsetView {
    /// Returns the word for an address.
    pub(crate) const fn word(self) -> &'static str {
        match self {
            Self::DriftRemoved => "removed",
            Self::Measured => "measured",
        }
    }
}

/// Approximate maximum number of whiskers of one direction over the whole time axis.
const MAX_WHISKERS: f64 = 60.0;
/// A gap has a label if it is at least this wide, as a share of the time axis.
const MIN_LABELLED_GAP: f64 = 0.08;
/// Minimum distance between two signs, as a share of the time axis; closer signs would overlap.
const MIN_SIGN_DISTANCE: f64 = 0.022;
/// Approximate number of ticks of a scale.
const TICKS: usize = 3;
/// Width of a whisker's cap to each side, as a share of the time axis.
const CAP_WIDTH: f64 = 0.003;
/// A scale ends at the largest value, but at most at this multiple of the 95th percentile.
const MAX_OUTLIER_RATIO: f64 = 3.0;

/// Data from which a chart is drawn: the time series of a link, and its gaps.
pub(super) struct ChartInput<'a> {
    pub(super) time_series: &'a LinkTimeSeries,
    /// The time series, merged so that it has few enough points for whiskers.
    coarse: LinkTimeSeries,
    /// Beginning and end of each gap.
    gaps: Vec<(WallTime, WallTime)>,
}

impl ChartInput<'_> {
    /// Returns the position of a time on the time axis, as a share of the axis.
    fn x(&self, at: WallTime) -> f64 {
        (at - self.time_series.from).seconds() / self.time_series.seconds().max(1.0)
    }

    /// Returns the position of a time, limited to the time axis.
    fn clamped_x(&self, at: WallTime) -> f64 {
        self.x(at).clamp(0.0, 1.0)
    }

    /// Returns the result of `value_of` for the position and the data of each point. `None` separates two points with a
    /// gap or a clock step between them.
    pub(super) fn with_breaks<T>(
        &self,
        points: &[ClockPoint],
        value_of: impl Fn(f64, &ClockPoint) -> Option<T>,
    ) -> Vec<Option<T>> {
        let mut values = Vec::with_capacity(points.len() + self.gaps.len());
        let mut previous: Option<&ClockPoint> = None;
        // If a clock was set back, the times of two relation periods overlap, so the points of each
        // relation period are drawn separately.
        let mut periods: Vec<u64> = Vec::new();
        for point in points {
            if !periods.contains(&point.relation_period) {
                periods.push(point.relation_period);
            }
        }
        let sorted_by_period = periods
            .iter()
            .flat_map(|period| points.iter().filter(move |point| point.relation_period == *period));
        for point in sorted_by_period {
            let is_separate = |previous: &ClockPoint| {
                previous.relation_period != point.relation_period
                    || self.gaps.iter().any(|(from, to)| previous.at <= *from && *to <= point.at)
            };
            if previous.is_some_and(is_separate) {
                values.push(None);
            }
            values.push(value_of(self.x(point.at), point));
            previous = Some(point);
        }
        values
    }
}

/// Returns the largest value, but at most [`MAX_OUTLIER_RATIO`] times the 95th percentile.
pub(super) fn reach(values: impl Iterator<Item = f64>) -> f64 {
    values.collect::<SortedValues>().scale_end(0.95, MAX_OUTLIER_RATIO).unwrap_or(0.0)
}

/// Returns the number of values beyond the end of a scale, in words; `None` if there are no such values.
pub(super) fn beyond(values: impl Iterator<Item = f64>, scale: &Scale, unit: &str) -> Option<String> {
    let number = values.filter(|value| *value > scale.ends().1).count() as u64;
    // The last tick of a widened scale is its end, for any maximum number of ticks.
    let max_ticks = 1;
    let end = scale.ticks(max_ticks).pop().filter(|_| number > 0)?.text;
    Some(format!("{} beyond {}{SPACE}{unit} ↑", count(number), end.trim_start_matches('+')))
}

/// Returns the distance of a value from the top of its track, as a share of the height. A value
/// beyond the scale lies slightly outside the track.
pub(super) fn distance_from_top(scale: &Scale, value: f64) -> f64 {
    1.0 - scale.at_or_outside(value)
}

/// Draws the time series of a link.
pub(crate) fn tracks(
    subject: &Subject<'_>,
    time_series: &LinkTimeSeries,
    view: OffsetView,
    incidents: &[IncidentRow],
    zone: Zone,
) -> Tracks {
    let coarse_bucket_s = (time_series.seconds() / MAX_WHISKERS).ceil() as i64;
    let gaps = time_series.gaps();
    let input = ChartInput { time_series, coarse: time_series.merged(coarse_bucket_s), gaps };
    let mut all = Vec::new();
    if !subject.same_clock() {
        all.push(offset::track(&subject.cloud, &input, view));
    }
    all.push(delays(&input));
    // Between hosts that read one clock there may be no probes.
    if !subject.same_clock() || time_series.probes().sent > 0 {
        all.push(round_trips(&input));
    }
    let gaps: Vec<(f64, f64)> =
        input.gaps.iter().map(|(from, to)| (input.clamped_x(*from), input.clamped_x(*to))).collect();
    let labelled_gaps = gaps.iter().filter(|(from, to)| to - from >= MIN_LABELLED_GAP);
    let hatches: Vec<Item> = gaps.iter().map(|gap| span(*gap, "hatch")).collect();
    let signs = signs(&input, incidents, zone);
    let incident_lines = signs
        .iter()
        .map(|sign| Item::line(At::new(sign.x.0, 0.0), At::new(sign.x.0, 1.0), Style::of_page("incident")));
    let background: Vec<Item> = hatches.iter().cloned().chain(incident_lines).collect();
    Tracks {
        label: finding(subject, &input, incidents.len()),
        gap_labels: labelled_gaps
            .map(|(from, to)| (AxisPosition(f64::midpoint(*from, *to)), "no report"))
            .collect(),
        strips: Direction::ALL.map(|direction| strip(&input, direction, &hatches)).to_vec(),
        tracks: all.into_iter().map(|track| track.picture(&background)).collect(),
        signs,
        times: time_labels(time_series, zone),
    }
}

fn signs(input: &ChartInput<'_>, incidents: &[IncidentRow], zone: Zone) -> Vec<IncidentSign> {
    let mut rows: Vec<&IncidentRow> = incidents.iter().collect();
    rows.sort_by_key(|row| row.at);
    let mut last_x = f64::NEG_INFINITY;
    let signs = rows.into_iter().map(|row| {
        let line = IncidentLine::new(row, zone);
        let x = input.clamped_x(row.at);
        let is_shown = x - last_x >= MIN_SIGN_DISTANCE;
        if is_shown {
            last_x = x;
        }
        IncidentSign { x: AxisPosition(x), sign: line.sign, tone: line.tone.class(), is_shown }
    });
    signs.collect()
}

/// Draws the verdicts of a direction over time. Gaps are hatched.
fn strip(input: &ChartInput<'_>, direction: Direction, hatches: &[Item]) -> Picture {
    let bucket_width = input.time_series.bucket as f64 / input.time_series.seconds().max(1.0);
    let mut segments: Vec<(f64, f64, Verdict)> = Vec::new();
    for point in &input.time_series.points {
        let Some(verdict) = delays_of_point(point, direction).map(|delays| delays.verdict) else { continue };
        let end = input.x(point.at);
        let begin = (end - bucket_width).max(0.0);
        // A point continues the segment of the previous point if it has the same verdict and no bucket is missing
        // between the two.
        match segments.last_mut() {
            Some((_, to, last_verdict)) if *last_verdict == verdict && begin - *to < bucket_width * 0.75 => {
                *to = end;
            }
            _ => segments.push((begin, end, verdict)),
        }
    }
    let segments = segments.into_iter().map(|(from, to, verdict)| (from, to.min(1.0), verdict));
    let (mut items, mut texts) = (Vec::new(), Vec::new());
    for (from, to, verdict) in segments {
        let class = strip_class(Chip::verdict(verdict).tone);
        items.push(span((from, to), class));
        let words = format!("{} {verdict}", DirectionNodes::of(direction).delay);
        let label = Label::new(At::new(from, 0.5), words, TextStyle { class, ..TextStyle::AXIS });
        texts.push(Item::Text(label.shifted(0.4, 0.36).with_max_width(to - from)));
    }
    items.extend(texts);
    items.extend(hatches.iter().cloned());
    Picture::of_items(&items, "strip", "")
}

/// Returns the class of a state's area and of the text on it.
const fn strip_class(tone: Tone) -> &'static str {
    match tone {
        Tone::Ok => "v-ok",
        Tone::Quiet => "v-quiet",
        Tone::Warn => "v-warn",
        Tone::Bad => "v-bad",
    }
}

fn delays(input: &ChartInput<'_>) -> Track {
    let points = &input.coarse.points;
    let upper_bounds = || {
        let medians = points.iter().flat_map(|point| {
            Direction::ALL.map(|direction| delays_of_point(point, direction).and_then(|one| one.median))
        });
        medians.flatten().map(|median| non_negative_bounds(&median).1 * 1e3)
    };
    let scale = Scale::up_to(reach(upper_bounds()), TICKS);
    let mut track =
        Track::new(format!("one-way delay, median of {}, ms", bucket_text(input.coarse.bucket)), scale);
    track.note = "whiskers: contain the true value".to_owned();
    track.beyond = beyond(upper_bounds(), &scale, "ms");
    // The time of a point is the end of its bucket. The whisker and the dot are drawn in the middle of the bucket.
    let half_bucket = input.coarse.bucket as f64 / input.time_series.seconds().max(1.0) / 2.0;
    for (direction, whiskers, dots) in
        [(Direction::Up, "whiskers up", "dots up"), (Direction::Down, "whiskers down", "dots down")]
    {
        // For each point its position on the time axis, and the positions of the upper bound, the lower bound and the
        // median.
        let marks: Vec<(f64, f64, f64, f64)> = points
            .iter()
            .filter_map(|point| {
                let median = delays_of_point(point, direction)?.median?;
                let (lo, hi) = non_negative_bounds(&median);
                let at = |seconds: f64| distance_from_top(&scale, seconds * 1e3);
                Some(((input.x(point.at) - half_bucket).max(0.0), at(hi), at(lo), at(median.value.seconds())))
            })
            .collect();
        track.draw(whiskers, Path::whiskers(marks.iter().map(|(x, hi, lo, _)| (*x, *hi, *lo)), CAP_WIDTH));
        track.draw(dots, Path::dots(marks.iter().map(|(x, _, _, value)| (*x, *value))));
    }
    track
}

fn round_trips(input: &ChartInput<'_>) -> Track {
    let points = &input.time_series.points;
    let medians =
        || points.iter().filter_map(|point| point.round_trip).map(|trip| trip.median.seconds() * 1e3);
    let scale = Scale::up_to(reach(medians()), TICKS);
    let mut track = Track::new("probe round trip, ms".to_owned(), scale);
    track.note = "strong: smallest · faint: median · ticks: lost probes, by their share".to_owned();
    track.beyond = beyond(medians(), &scale, "ms");
    let line = |time_of: fn(&peernet_stream::RoundTrip) -> Span| {
        Path::line(input.with_breaks(points, |x, point| {
            Some((x, distance_from_top(&scale, time_of(point.round_trip.as_ref()?).seconds() * 1e3)))
        }))
    };
    track.draw("faint", line(|trip| trip.median));
    track.draw("strong", line(|trip| trip.min));
    // A tick is longer for a larger share of lost probes; its length is the same for all shares from 20 % on.
    let lost = points.iter().filter_map(|point| {
        let share = point.probes.lost_share().filter(|share| *share > 0.0)?;
        let (upper_end, lower_end) = (0.03, 0.05 + 0.15 * (share * 5.0).min(1.0));
        Some((input.x(point.at), upper_end, lower_end))
    });
    track.draw("lost", Path::ticks(lost));
    track
}

/// Returns the width of a bucket in words: `2 s`, `24 min`.
fn bucket_text(seconds: i64) -> String {
    if seconds < 60 { format!("{seconds}{SPACE}s") } else { long_duration(seconds as f64) }
}

/// Draws labels with round times of day along the axis.
fn time_labels(time_series: &LinkTimeSeries, zone: Zone) -> Picture {
    let from = time_series.from.unix_nanos() as f64 / 1e9;
    let time_ticks =
        times_of_day(from, time_series.seconds(), i64::from(zone.offset_seconds(time_series.to)));
    let tick = |(seconds, at): (i64, f64)| {
        let time = WallTime::from_unix_nanos(seconds * 1_000_000_000);
        Tick { value: seconds as f64, at, text: zone.moment(time).axis_label() }
    };
    Picture::labels_below("times", &time_ticks.into_iter().map(tick).collect::<Vec<_>>())
}

/// Returns the range of values, seconds, in words: `0.61 to 0.70 ms`. `None` without values.
fn range(values: impl Iterator<Item = f64>) -> Option<String> {
    let (lo, hi) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), one| (lo.min(one), hi.max(one)));
    lo.is_finite().then(|| format!("{} to {}{SPACE}ms", figure(lo * 1e3), figure(hi * 1e3)))
}

/// Returns the description of the whole chart in words, for its label.
fn finding(subject: &Subject<'_>, input: &ChartInput<'_>, incidents: usize) -> String {
    let time_series = input.time_series;
    let mut text = format!("{} over {}.", subject.route(), long_duration(time_series.seconds()));
    if time_series.points.is_empty() {
        return format!("{text} Nothing was reported.");
    }
    for direction in Direction::ALL {
        let delays = input.coarse.points.iter().filter_map(|point| delays_of_point(point, direction));
        let worst = Verdict::worst(delays.clone().map(|one| one.verdict));
        if let Some(range) = range(delays.filter_map(|one| one.median).map(|median| median.value.seconds())) {
            let worst = worst.map_or_else(String::new, |verdict| format!(", worst verdict {verdict}"));
            text.push_str(&format!(" Median {} {range}{worst}.", DirectionNodes::of(direction).delay));
        }
    }
    let max_errors: Vec<f64> = time_series
        .points
        .iter()
        .filter_map(|point| estimate_and_max_error(point.offset.as_ref()?))
        .map(|(_, max_error)| max_error)
        .collect();
    if let (Some(least), Some(most), false) = (
        max_errors.iter().copied().reduce(f64::min),
        max_errors.iter().copied().reduce(f64::max),
        subject.same_clock(),
    ) {
        text.push_str(&format!(" The offset was known to {} to {}.", bound_ms(least), bound(most)));
    }
    let probes = time_series.probes();
    text.push_str(&format!(
        " {} of {} probes were lost.",
        count(probes.lost.into()),
        count(probes.ended().into())
    ));
    if !input.gaps.is_empty() {
        text.push_str(&format!(
            " {} without a report.",
            number::counted_with_plural(input.gaps.len() as u64, "stretch", "stretches")
        ));
    }
    if incidents > 0 {
        text.push_str(&format!(" {}.", number::counted(incidents as u64, "incident")));
    }
    text
}
