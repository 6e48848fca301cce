//! Title of a link's page, and the meaning of the verdict on each direction.

use peernet_clock::{Direction, Verdict};
use peernet_statistics::number::{SPACE, bound, ends_ms, interval_ms};

use super::super::chip::Chip;
use super::super::clocks;
use super::delays::{Delays, format_delay, non_negative_bounds};
use super::list::{TOO_YOUNG, missing_offset_reason};
use super::{CONTRADICTION, Subject, is_young};
use crate::zone::Zone;

/// Returns the title: how far upload and download times of the link can be trusted.
pub(crate) fn title(subject: &Subject<'_>, zone: Zone) -> String {
    let route = subject.route();
    if subject.same_clock() {
        return format!(
            "{} and {} read one clock: delays between them are exact",
            subject.edge, subject.cloud
        );
    }
    if !subject.connected {
        let seen = zone.moment(subject.end);
        return format!(
            "{route}: {} last reported this link on {}, {}",
            subject.edge,
            seen.date(),
            seen.time_of_day()
        );
    }
    if subject.contradicts() {
        return format!("{route}: {CONTRADICTION}, so no one-way delay can be trusted");
    }
    let (Some(max_error), Some(offset)) = (subject.bound(), subject.offset()) else {
        return format!("{route}: {}, so one-way delays are not known", missing_offset_reason(subject));
    };
    let bound = bound(max_error);
    match offset.verdict {
        Verdict::Stale if is_young(offset) => return format!("{route}: {TOO_YOUNG}"),
        Verdict::Stale => {
            return format!(
                "{route}: the clocks were not compared lately, or the newest exchanges contradict the others; the bound is {bound}"
            );
        }
        _ => {}
    }
    let [up, down] = Direction::ALL.map(|direction| subject.delays(direction).verdict);
    let trusted = |directions: &str| format!("{route}: {directions} times can be trusted to {bound}");
    match (up, down) {
        (None, None) => {
            format!("{route}: the clocks are known to {bound}; nothing was sent in the last 10{SPACE}s")
        }
        (Some(Verdict::Ok), Some(Verdict::Ok)) => trusted("upload and download"),
        (Some(Verdict::Ok), None) => trusted("upload"),
        (None, Some(Verdict::Ok)) => trusted("download"),
        (Some(Verdict::Ok), Some(Verdict::Limited)) => {
            format!("{}; read download times as intervals", trusted("upload"))
        }
        (Some(Verdict::Limited), Some(Verdict::Ok)) => {
            format!("{}; read upload times as intervals", trusted("download"))
        }
        (Some(Verdict::Ok), Some(_)) => format!("{}, download times cannot", trusted("upload")),
        (Some(_), Some(Verdict::Ok)) => format!("{}, upload times cannot", trusted("download")),
        (Some(Verdict::Limited) | None, Some(Verdict::Limited) | None) => {
            format!("{route}: the clocks are known to {bound}; read delays as intervals")
        }
        (Some(Verdict::Stepped), _) | (_, Some(Verdict::Stepped)) => {
            format!(
                "{route}: a clock was stepped a moment ago; delays can be trusted again when the bound has settled"
            )
        }
        _ => format!("{route}: one-way delays cannot be trusted at present"),
    }
}

/// Meaning of a verdict for one direction, with its numbers.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Meaning {
    pub chip: Option<Chip>,
    /// Direction at the start of the sentence: `Upload` or `Download`.
    pub subject: &'static str,
    /// The rest of the sentence.
    pub text: String,
}

/// Returns the meaning of the verdict of each direction.
pub(crate) fn meanings(subject: &Subject<'_>) -> Vec<Meaning> {
    let is_young_link = subject.offset().is_some_and(is_young);
    Direction::ALL
        .map(|direction| subject.delays(direction))
        .iter()
        .map(|delays| meaning(delays, is_young_link))
        .collect()
}

fn meaning(delays: &Delays, is_young_link: bool) -> Meaning {
    let text = match (delays.verdict, &delays.median) {
        (None, _) => format!("was not used in the last 10{SPACE}s: without data there is nothing to judge."),
        (Some(Verdict::Ok), Some(point)) => {
            let (lo, hi) = non_negative_bounds(point);
            let takes = format!("takes {}{SPACE}ms", format_delay(point));
            let half = (hi - lo) / 2.0;
            if half > 0.0 {
                let ratio = point.value.seconds() / half;
                format!(
                    "{takes}, {} times half the width of its interval. The true value lies between {}{SPACE}ms.",
                    format_ratio(ratio),
                    ends_ms(lo, hi).join(" and ")
                )
            } else {
                format!("{takes}, exactly.")
            }
        }
        (Some(Verdict::Limited), Some(point)) => {
            let (lo, hi) = non_negative_bounds(point);
            let reason = if point.bounds.is_wide_for(point.value) {
                "too little for the width of its interval"
            } else {
                "but some delays have wider intervals, or a jump of a clock was suspected a moment ago"
            };
            format!(
                "takes about {}{SPACE}ms, {reason}. Read it as {}{SPACE}ms: the true value can be anywhere in it.",
                format_delay(point),
                interval_ms(lo, hi)
            )
        }
        (Some(Verdict::Stale), _) if is_young_link => {
            format!("is known only within a wide interval: {TOO_YOUNG}.")
        }
        (Some(verdict), _) => format!("cannot be trusted: {}.", clocks::meaning(verdict)),
    };
    Meaning { chip: delays.chip(), subject: delays.title(), text }
}

/// Formats a ratio, with one decimal if it is small: `4.2`, `12`.
fn format_ratio(ratio: f64) -> String {
    peernet_statistics::number::fixed(ratio, usize::from(ratio < 9.95))
}
