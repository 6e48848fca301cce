//! Links in a list.

use peernet_aggregator::{LinkSnapshot, LiveState};
use peernet_clock::Verdict;
use peernet_statistics::number::{self, bound_ms, offset_ms, percent, trip_ms};
use peernet_store::LinkRow;

use super::super::chip::Chip;
use super::super::clock_fault::FaultyClocks;
use super::super::pipeline_table::Cell;
use super::stats::ppm;
use super::time_series::live_probes;
use super::{CONTRADICTION, Subject, estimate_and_max_error, is_live, is_young, panels};
use crate::zone::{Zone, ZonedTime};

/// Current state of a link.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LinkLine {
    pub name: String,
    pub href: String,
    pub chip: Option<Chip>,
    /// Meaning of the verdict; empty without a verdict.
    pub meaning: &'static str,
    /// Time of the last report, for a link whose edge does not report now.
    pub away: Option<ZonedTime>,
    pub clock_fault: Option<Chip>,
    pub network: String,
    pub bound: Cell,
    pub offset: Cell,
    /// Drift of the cloud's clock against the edge's clock, ppm.
    pub drift: Cell,
    pub round_trip: Cell,
    /// Share of lost probes, percent.
    pub lost: Cell,
    pub probing: String,
    /// Name of each pipeline that uses the link, and the address of its page.
    pub pipelines: Vec<(String, String)>,
}

/// A link that is stored but not in the live state.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PastLine {
    pub name: String,
    pub href: String,
    /// Time of the last report.
    pub last: ZonedTime,
}

/// Returns a cell with a value, or with a dash and the reason for its absence.
fn cell(value: Option<String>, why: &str) -> Cell {
    value.map_or_else(|| Cell::none(why), Cell::new)
}

impl LinkLine {
    /// Returns the first `limit` links of the live state.
    pub(crate) fn first(limit: usize, snapshot: &LiveState, zone: Zone) -> Vec<Self> {
        let faulty = FaultyClocks::of(snapshot);
        snapshot.links.iter().take(limit).map(|link| Self::new(link, &faulty, zone)).collect()
    }

    fn new(link: &LinkSnapshot, faulty_clocks: &FaultyClocks, zone: Zone) -> Self {
        let subject = Subject::live(link);
        let verdict = subject.verdict();
        let offset = subject.offset();
        let (probes, newest_trip) = live_probes(&link.history, subject.end);
        let why = missing_offset_reason(&subject);
        let clock_cell = |value: Result<String, &str>| match value {
            _ if subject.same_clock() => {
                Cell { text: "0".into(), title: Some("both hosts read one clock".into()) }
            }
            Ok(text) => Cell::new(text),
            Err(why) => Cell::none(why),
        };
        Self {
            name: subject.route(),
            href: subject.href(),
            chip: verdict.map(Chip::verdict),
            meaning: match (verdict, offset) {
                (Some(Verdict::Stale), Some(offset)) if is_young(offset) => TOO_YOUNG,
                (verdict, _) => verdict.map_or("", super::super::clocks::meaning),
            },
            away: (!link.connected).then(|| zone.moment(link.last_seen)),
            clock_fault: faulty_clocks.chip(&[&subject.edge, &subject.cloud]),
            network: link.live.network().to_string(),
            bound: clock_cell(subject.bound().map(bound_ms).ok_or(why)),
            offset: clock_cell(
                offset
                    .and_then(estimate_and_max_error)
                    .map(|(estimate, max_error)| offset_ms(estimate, max_error))
                    .ok_or(why),
            ),
            drift: clock_cell(subject.drift().map(ppm)),
            round_trip: cell(
                newest_trip.map(|trip| trip_ms(trip.median.seconds())),
                "no probe came back in ten minutes",
            ),
            lost: cell(probes.lost_share().map(percent), "no probes in ten minutes"),
            probing: panels::probing(&link.live.probing),
            pipelines: subject.pipelines(),
        }
    }
}

/// Returns the reason why no offset is shown.
pub(super) fn missing_offset_reason(subject: &Subject<'_>) -> &'static str {
    match (subject.contradicts(), subject.was_related()) {
        (true, _) => CONTRADICTION,
        (false, Some(true)) => "no exchange has finished since a clock was stepped",
        (false, Some(false)) => "the two clocks were never related",
        (false, None) => "no offset was stored in this time",
    }
}

/// Explanation of the verdict `stale` while the link is young.
pub(super) const TOO_YOUNG: &str =
    "too few exchanges yet: fewer than three since the link came up or a clock was stepped";

impl PastLine {
    /// Returns the stored links that are not in the live state.
    pub(crate) fn all(rows: &[LinkRow], snapshot: &LiveState, zone: Zone) -> Vec<Self> {
        let past = rows.iter().filter(|row| !is_live(snapshot, row)).map(|row| {
            let subject = Subject::past(row);
            Self { name: subject.route(), href: subject.href(), last: zone.moment(row.last) }
        });
        past.collect()
    }
}

/// Returns the title of the list: whether one-way delays can be trusted.
pub(crate) fn title(snapshot: &LiveState) -> String {
    let links: Vec<Subject<'_>> = snapshot.links.iter().map(|link| Subject::live(link)).collect();
    let verdicts: Vec<Verdict> = links.iter().filter_map(Subject::verdict).collect();
    let count_of = |wanted: Verdict| verdicts.iter().filter(|verdict| **verdict == wanted).count();
    let (good, limited) = (count_of(Verdict::Ok), count_of(Verdict::Limited));
    let bad = verdicts.len() - good - limited;
    let subject = number::counted(links.len() as u64, "link");
    match links.len() {
        0 => "No link yet: one-way delays are measured once a pipeline sends to another host".to_owned(),
        1 if good == 1 => format!("{subject}: its one-way delays can be trusted"),
        1 if limited == 1 => format!("{subject}: some of its delays are known only as intervals"),
        1 => format!("{subject}: some or all of its one-way delays cannot be trusted at present"),
        all if all == good => format!("{subject}: one-way delays can be trusted on all of them"),
        _ => {
            let mut parts = Vec::new();
            for (link_count, what) in [
                (good, "can be trusted"),
                (limited, "with some delays known only as intervals"),
                (bad, "cannot be trusted"),
            ] {
                if link_count > 0 {
                    parts.push(format!("{} {what}", number::count(link_count as u64)));
                }
            }
            format!("{subject}: {}", parts.join(", "))
        }
    }
}
