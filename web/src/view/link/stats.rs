//! The current figures of a link.

use peernet_clock::RelatedClocks;
use peernet_statistics::number::{
    NONE, SPACE, bound, count, figure, fixed, length, offset_ms, percent, trip_ms,
};
use peernet_stream::ProbeCounts;

use super::super::chip::Chip;
use super::super::speed::NetworkDirection;
use super::course::Course;
use super::list::no_offset;
use super::{CONTRADICTION, Subject, known};

/// A figure with its name, its unit and a line of explanation.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Stat {
    pub name: String,
    pub number: String,
    /// Unit of the number; empty without a number.
    pub unit: &'static str,
    /// Explanation of the number, or the reason for its absence.
    pub title: String,
    pub line: String,
    pub chip: Option<Chip>,
}

impl Stat {
    fn new(name: &str, known: Option<String>, unit: &'static str, line: String) -> Self {
        let unit = if known.is_some() { unit } else { "" };
        let title = if known.is_some() { String::new() } else { line.clone() };
        Self {
            name: name.to_owned(),
            number: known.unwrap_or_else(|| NONE.to_owned()),
            unit,
            title,
            line,
            chip: None,
        }
    }
}

/// Returns all figures.
pub(crate) fn all(subject: &Subject<'_>, course: &Course) -> Vec<Stat> {
    let mut stats = vec![delay(subject, NetworkDirection::Up), delay(subject, NetworkDirection::Down)];
    if !subject.same_clock() {
        stats.extend([offset(subject), drift(subject)]);
    }
    if !subject.same_clock() || course.probes().sent > 0 {
        stats.extend([round_trip(course), lost(course)]);
    }
    stats
}

fn delay(subject: &Subject<'_>, way: NetworkDirection) -> Stat {
    let delays = subject.delays(way);
    let known = delays.median.is_some().then(|| delays.value());
    let line = match delays.interval() {
        Some(interval) => interval,
        None if delays.verdict.is_some() => String::new(),
        None => "nothing sent".to_owned(),
    };
    let name = format!("{}, median of 10{SPACE}s", delays.title());
    let title = if known.is_some() { String::new() } else { delays.reason().to_owned() };
    Stat { chip: delays.chip(), title, ..Stat::new(&name, known, "ms", line) }
}

fn offset(subject: &Subject<'_>) -> Stat {
    let name = match subject.clocks() {
        RelatedClocks::Wall => "Clock offset",
        RelatedClocks::Raw => "Offset of the free-running clocks",
        RelatedClocks::RawToWall => "Offset, free-running to wall clock",
    };
    let Some((estimate, half)) = subject.offset().and_then(known) else {
        return Stat::new(name, None, "ms", no_offset(subject).to_owned());
    };
    let then = if subject.connected { "" } else { ", when last reported" };
    if subject.clocks() != RelatedClocks::Wall {
        // A free-running clock counts from the start of its machine: which one is ahead says nothing about the time of day.
        let line = format!("free-running clocks count from the machine's start, {}{then}", bound(half));
        return Stat::new(name, Some(offset_ms(estimate, half)), "ms", line);
    }
    // If zero lies within the bounds, neither clock is known to be ahead.
    let who = if estimate.abs() <= half {
        "level".to_owned()
    } else if estimate > 0.0 {
        format!("{} is ahead", subject.cloud)
    } else {
        format!("{} is behind", subject.cloud)
    };
    let line = format!("{who}, {}{then}", bound(half));
    Stat::new(name, Some(offset_ms(estimate, half)), "ms", line)
}

/// Formats parts per million with a sign: `+12.4`.
pub(crate) fn ppm(value: f64) -> String {
    let text = fixed(value, 1);
    if value > 0.0 && text != "0.0" { format!("+{text}") } else { text }
}

fn drift(subject: &Subject<'_>) -> Stat {
    let consistent = subject.offset().filter(|offset| known(offset).is_some());
    let skew = consistent.and_then(|offset| offset.skew_ppm);
    let none = || if subject.contradicts() { CONTRADICTION } else { "too few exchanges yet" }.to_owned();
    let line = skew.map_or_else(none, |skew| {
        let a_day = skew.abs() * 1e-6 * 86_400.0;
        let verb = if skew < 0.0 { "loses" } else { "gains" };
        if a_day < 0.005 {
            "both run alike".to_owned()
        } else {
            format!("{} {verb} {}{SPACE}s a day", subject.cloud, figure(a_day))
        }
    });
    Stat::new("Drift", skew.map(ppm), "ppm", line)
}

fn round_trip(course: &Course) -> Stat {
    let line = course.round_trips().map_or_else(
        || "no probe came back".to_owned(),
        |(min, _)| format!("smallest {}{SPACE}ms", trip_ms(min)),
    );
    let newest = course.points.iter().rev().find_map(|point| point.round_trip);
    Stat::new("Probe round trip", newest.map(|trip| trip_ms(trip.median.seconds())), "ms", line)
}

fn lost(course: &Course) -> Stat {
    let ProbeCounts { sent, lost, .. } = course.probes();
    let share = (sent > 0).then(|| percent(f64::from(lost) / f64::from(sent)));
    let line = if sent > 0 {
        format!("{} of {} in {}", count(lost.into()), count(sent.into()), length(course.seconds()))
    } else {
        "no probes".to_owned()
    };
    Stat::new("Probes lost", share, "%", line)
}
