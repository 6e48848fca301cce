//! The current numbers of a link.

use peernet_clock::{Direction, RelatedClocks, Span};
use peernet_statistics::number::{
    NONE, SPACE, bound, count, figure, long_duration, offset_ms, percent, signed, trip_ms,
};

use super::super::chip::Chip;
use super::list::missing_offset_reason;
use super::time_series::LinkTimeSeries;
use super::{Subject, estimate_and_max_error};

/// A number with its name, its unit and a line of explanation.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Stat {
    pub name: String,
    pub number: String,
    /// Unit of the number; empty without a number.
    pub unit: &'static str,
    /// Tooltip of the number: the reason why the number is missing; empty if it is not missing.
    pub title: String,
    /// Line below the number.
    pub line: String,
    pub chip: Option<Chip>,
}

impl Stat {
    fn new(name: &str, number: Option<String>, unit: &'static str, line: String) -> Self {
        let unit = if number.is_some() { unit } else { "" };
        let title = if number.is_some() { String::new() } else { line.clone() };
        Self {
            name: name.to_owned(),
            number: number.unwrap_or_else(|| NONE.to_owned()),
            unit,
            title,
            line,
            chip: None,
        }
    }
}

/// Returns the numbers in their order on the page.
pub(crate) fn all(subject: &Subject<'_>, time_series: &LinkTimeSeries) -> Vec<Stat> {
    let mut stats = vec![delay(subject, Direction::Up), delay(subject, Direction::Down)];
    if !subject.same_clock() {
        stats.extend([offset(subject), drift(subject)]);
    }
    if !subject.same_clock() || time_series.probes().sent > 0 {
        stats.extend([round_trip(time_series), lost(time_series)]);
    }
    stats
}

fn delay(subject: &Subject<'_>, direction: Direction) -> Stat {
    let delays = subject.delays(direction);
    let number = delays.median.is_some().then(|| delays.value());
    let line = match delays.interval() {
        Some(interval) => interval,
        None if delays.verdict.is_some() => String::new(),
        None => "nothing sent".to_owned(),
    };
    let name = format!("{}, median of the last 10{SPACE}seconds' medians", delays.title());
    let title = if number.is_some() { String::new() } else { delays.reason().to_owned() };
    Stat { chip: delays.chip(), title, ..Stat::new(&name, number, "ms", line) }
}

fn offset(subject: &Subject<'_>) -> Stat {
    let name = match subject.clocks() {
        RelatedClocks::Wall => "Clock offset",
        RelatedClocks::Raw => "Offset of the free-running clocks",
        RelatedClocks::RawToWall => "Offset, free-running to wall clock",
    };
    let known = subject.offset().and_then(|offset| Some((offset.bounds, estimate_and_max_error(offset)?)));
    let Some((bounds, (estimate, max_error))) = known else {
        return Stat::new(name, None, "ms", missing_offset_reason(subject).to_owned());
    };
    let suffix = if subject.connected { "" } else { ", when last reported" };
    if subject.clocks() != RelatedClocks::Wall {
        // Free-running clocks count from the start of their machines, so which clock is ahead says nothing about the
        // time of day.
        let line =
            format!("free-running clocks count from the machine's start, {}{suffix}", bound(max_error));
        return Stat::new(name, Some(offset_ms(estimate, max_error)), "ms", line);
    }
    // If zero lies within the bounds, neither clock is known to be ahead.
    let comparison = if bounds.contains(Span::ZERO) {
        "neither clock is known to be ahead".to_owned()
    } else if estimate > 0.0 {
        format!("{} is ahead", subject.cloud)
    } else {
        format!("{} is behind", subject.cloud)
    };
    let line = format!("{comparison}, {}{suffix}", bound(max_error));
    Stat::new(name, Some(offset_ms(estimate, max_error)), "ms", line)
}

/// Formats parts per million with a sign: `+12.4`.
pub(crate) fn ppm(value: f64) -> String {
    signed(value, 1)
}

fn drift(subject: &Subject<'_>) -> Stat {
    let drift = subject.drift();
    let line = drift.map_or_else(str::to_owned, |drift| {
        let seconds_per_day = drift.abs() * 1e-6 * 86_400.0;
        let verb = if drift < 0.0 { "loses" } else { "gains" };
        // Two decimals would show such a drift as 0.00 s.
        if seconds_per_day < 0.005 {
            "both run equally fast".to_owned()
        } else {
            format!("{} {verb} {}{SPACE}s a day", subject.cloud, figure(seconds_per_day))
        }
    });
    Stat::new("Drift", drift.ok().map(ppm), "ppm", line)
}

fn round_trip(time_series: &LinkTimeSeries) -> Stat {
    let line = time_series.round_trips().map_or_else(
        || "no probe came back".to_owned(),
        |(min, _)| format!("smallest {}{SPACE}ms", trip_ms(min)),
    );
    let newest = time_series.points.iter().rev().find_map(|point| point.round_trip);
    Stat::new("Probe round trip", newest.map(|trip| trip_ms(trip.median.seconds())), "ms", line)
}

fn lost(time_series: &LinkTimeSeries) -> Stat {
    let probes = time_series.probes();
    let (lost, ended) = (count(probes.lost.into()), count(probes.ended().into()));
    let share = probes.lost_share().map(percent);
    let line = match share {
        Some(_) => format!("{lost} of {ended} in {}", long_duration(time_series.seconds())),
        None => "no probes".to_owned(),
    };
    Stat::new("Probes lost", share, "%", line)
}
