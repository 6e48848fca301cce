//! Counts of a host's events on their way from the measurement to the database. Each produced event is acknowledged,
//! waiting or dropped.

use std::cmp::Reverse;

use peernet_aggregator::{HostSnapshot, RejectedBatches};
use peernet_clock::Span;
use peernet_figures::drawing;
use peernet_statistics::number::{
    self, NONE, SPACE, bytes, count, estimated_duration, figure, fixed, long_duration, percent,
};
use peernet_store::StoredCounts;
use peernet_stream::Accounting;

use super::chip::{Chip, Tone};
use crate::picture::Picture;
use crate::zone::Zone;

/// A remark is made if storage lags behind measurement by more than this.
pub(crate) const FAR_BEHIND: Span = Span::from_seconds(5);
/// A spool is reported as nearly full if at least this share of its limit is used.
const NEARLY_FULL: f64 = 0.95;
/// Possible reasons why events were lost. The gaps of a run name the actual reason.
const LOST: &str = "dropped because the agent's spool was full, or lost when the agent was killed";
/// Explanation of the chip `compressed`. The agent does not report which of the two reasons applies.
const COMPRESSED: &str = "batches wait for the link or the aggregator";

/// A whole sentence with its chip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Remark {
    pub chip: Chip,
    pub text: String,
}

impl Remark {
    fn new(tone: Tone, sign: &'static str, word: &'static str, text: impl Into<String>) -> Self {
        Self { chip: Chip::new(tone, sign, word), text: text.into() }
    }
}

/// One step on the way of events to the database.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Step {
    pub name: &'static str,
    pub number: String,
    /// Note below the number. For all steps but the first, the number of events that have not reached this step yet.
    pub note: String,
}

/// Counts of the agent's events, as the page of its host shows them.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Events {
    pub remarks: Vec<Remark>,
    /// The steps produced, spooled, sent and acknowledged.
    pub flow: Vec<Step>,
    pub waiting: String,
    pub dropped: String,
    pub gaps: String,
    /// Possible reasons why events were lost; `None` if no event was lost.
    pub loss_reasons: Option<&'static str>,
    pub spool: Spool,
    /// Lag of storage with its unit, and an explanation.
    pub behind: (String, String),
}

/// Fill level of a spool.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Spool {
    /// Used share of the limit, percent.
    pub percent: String,
    /// `312 MB of 1.07 GB`.
    pub words: String,
    pub meter: Picture,
}

impl Spool {
    fn of(name: &str, accounting: &Accounting) -> Self {
        let (used, limit) = (accounting.spool_bytes as f64, accounting.spool_limit_bytes as f64);
        let tone = spool_chip(accounting).map_or(Tone::Ok, |chip| chip.tone);
        let meter = |share: f64, label: String| {
            Picture::of_items(&drawing::meter(share), &format!("meter {}", tone.class()), &label)
        };
        if accounting.spool_limit_bytes == 0 {
            let meter = meter(0.0, format!("the spool of {name} is not known"));
            return Self { percent: NONE.to_owned(), words: "not known yet".to_owned(), meter };
        }
        let share = used / limit;
        let percent = percent(share);
        let meter = meter(share, format!("{percent}{SPACE}% of the spool of {name} is used"));
        Self { percent, words: format!("{} of {}", bytes(used), bytes(limit)), meter }
    }
}

impl Events {
    pub(crate) fn of(host: &HostSnapshot) -> Self {
        let account = &host.accounting;
        let name = host.description.name.as_str();
        let in_memory = account.produced.saturating_sub(account.dropped).saturating_sub(account.spooled);
        let unsent = account.spooled.saturating_sub(account.sent);
        let unacknowledged = account.sent.saturating_sub(account.stored);
        let memory = match account.memory_bytes {
            0 => format!("{} in memory", count(in_memory)),
            size => format!("{} in memory, {}", count(in_memory), bytes(size as f64)),
        };
        let step = |name, number, note| Step { name, number: count(number), note };
        Self {
            remarks: remarks(host),
            flow: vec![
                step("Produced", account.produced, "since the spool was made".to_owned()),
                step("Spooled", account.spooled, memory),
                step("Sent", account.sent, format!("{} not yet", count(unsent))),
                step("Acknowledged", account.stored, format!("{} under way", count(unacknowledged))),
            ],
            waiting: count(account.waiting),
            dropped: count(account.dropped),
            gaps: number::counted(account.gaps, "gap"),
            loss_reasons: loss_reasons(account),
            spool: Spool::of(name, account),
            behind: (
                host.behind.map_or_else(|| format!("0{SPACE}s"), |behind| long_duration(behind.seconds())),
                match host.catching_up {
                    Some(progress) => {
                        format!("about {} left", estimated_duration(progress.remaining.seconds()))
                    }
                    None if account.waiting == 0 => "nothing waits".to_owned(),
                    None => format!("{} wait", counted_events(account.waiting)),
                },
            ),
        }
    }
}

/// Returns the possible reasons why events were lost; `None` if no event was lost.
fn loss_reasons(account: &Accounting) -> Option<&'static str> {
    (account.dropped > 0).then_some(LOST)
}

fn counted_events(number: u64) -> String {
    number::counted(number, "event")
}

/// Returns the chip of a spool that is full or nearly full.
fn spool_chip(account: &Accounting) -> Option<Chip> {
    let (used, limit) = (account.spool_bytes, account.spool_limit_bytes);
    if limit == 0 || (used as f64) < limit as f64 * NEARLY_FULL {
        return None;
    }
    let (tone, word) =
        if used >= limit { (Tone::Bad, "spool full") } else { (Tone::Warn, "spool nearly full") };
    Some(Chip::new(tone, "gap", word))
}

/// Returns all remarks on a host's events.
pub(crate) fn remarks(host: &HostSnapshot) -> Vec<Remark> {
    let account = &host.accounting;
    let mut remarks = Vec::new();
    if let Some(trouble) = &account.trouble {
        let text = format!(
            "the spool cannot be used: {trouble}. Events wait in memory, which has room for fewer events."
        );
        remarks.push(Remark::new(Tone::Bad, "failed", "spool fails", text));
    }
    if let Some(chip) = spool_chip(account) {
        // Events are dropped when their batch does not fit, which can happen slightly below the limit. Both chips
        // therefore have the same text.
        let used = percent(account.spool_bytes as f64 / account.spool_limit_bytes as f64);
        let text = format!(
            "{used}{SPACE}% of the spool is used. Events that no longer fit are dropped and counted in gaps."
        );
        remarks.push(Remark { chip, text });
    }
    if let Some(behind) = host.behind.filter(|behind| *behind > FAR_BEHIND) {
        let behind = long_duration(behind.seconds());
        remarks.push(match host.catching_up {
            Some(progress) => {
                let (left, rate) =
                    (estimated_duration(progress.remaining.seconds()), figure(progress.events_per_second));
                let text = format!(
                    "{behind} behind, about {left} left at {rate} events/s. Live figures are not affected."
                );
                Remark::new(Tone::Quiet, "reconnect", "catching up", text)
            }
            None => {
                let text = format!("storing is {behind} behind measuring. Live figures are not affected.");
                Remark::new(Tone::Warn, "stale", "behind", text)
            }
        });
    }
    let missing = host.missing_events();
    if !missing.is_zero() {
        // If the agent dropped fewer events than are missing, some events were lost in another way, for example because
        // the spool was deleted.
        let are_dropped = !missing.is_incomplete && account.dropped == missing.known;
        let why = loss_reasons(account).filter(|_| are_dropped).unwrap_or("missing");
        let text = format!(
            "{} {why}; the gaps of its runs, or incidents of the kind gap, say why.",
            missing.events()
        );
        remarks.push(Remark::new(Tone::Warn, "gap", "lost", text));
    }
    if account.compressed {
        remarks.push(Remark::new(Tone::Quiet, "slow", "compressed", COMPRESSED));
    }
    remarks
}

/// Returns the most severe remark on a host's events; of equally severe remarks the first one.
fn most_severe_remark(host: &HostSnapshot) -> Option<Remark> {
    // `max_by_key` would return the last one of equally severe remarks.
    remarks(host).into_iter().min_by_key(|remark| Reverse(remark.chip.tone))
}

/// Returns the aggregator's counts of a host's data, as pairs of name and text. `rejected` is `None` for a host that is
/// not in the live state.
pub(crate) fn stored_count_pairs(
    stored: &StoredCounts,
    rejected: Option<&RejectedBatches>,
    newest: Option<peernet_clock::WallTime>,
    zone: Zone,
) -> Vec<(&'static str, String)> {
    let in_other_database = match stored.in_other_database {
        0 => String::new(),
        number => format!(", {} of them in another database", count(number)),
    };
    let missing = stored.missing_count().events();
    let mut pairs = vec![
        ("Stored", format!("{} events, {} nodes", count(stored.events), count(stored.nodes))),
        ("Gaps", format!("{}, {missing} missing{in_other_database}", count(stored.gaps))),
        ("Quarantined", format!("{} batches that could not be stored", count(stored.quarantined))),
    ];
    // These counts begin at the start of the aggregator, so they say nothing about a host that has not reported since
    // then.
    if let Some(rejected) = rejected {
        pairs.extend([
            ("Duplicates", format!("{} batches, stored once", count(stored.duplicates))),
            (
                "Deferred",
                format!("{} batches while the queue was full, requested again", count(rejected.deferred)),
            ),
            ("Damaged", format!("{} batches, requested again", count(rejected.damaged))),
        ]);
    }
    pairs.extend(newest.map(|newest| {
        let newest = zone.moment(newest);
        ("Stored up to", format!("{}, {} by the host's clock", newest.date(), newest.time_of_day()))
    }));
    pairs
}

/// Event counts of one host as a row of a table. The texts have no units, because the header of the table shows them.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct EventLine {
    pub name: String,
    pub produced: String,
    pub spooled: String,
    pub sent: String,
    pub acknowledged: String,
    pub waiting: String,
    pub dropped: String,
    pub gaps: String,
    /// Possible reasons why events were lost; `None` if no event was lost.
    pub loss_reasons: Option<&'static str>,
    pub spool: Spool,
    pub behind: String,
    /// Most severe remark.
    pub remark: Option<Remark>,
}

impl EventLine {
    pub(crate) fn new(host: &HostSnapshot) -> Self {
        let account = &host.accounting;
        let name = host.description.name.to_string();
        Self {
            produced: count(account.produced),
            spooled: count(account.spooled),
            sent: count(account.sent),
            acknowledged: count(account.stored),
            waiting: count(account.waiting),
            dropped: count(account.dropped),
            gaps: count(account.gaps),
            loss_reasons: loss_reasons(account),
            spool: Spool::of(&name, account),
            behind: host.behind.map_or_else(|| "0".to_owned(), |behind| fixed(behind.seconds(), 1)),
            remark: most_severe_remark(host),
            name,
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_aggregator::CatchingUp;

    use super::*;
    use crate::tests::samples;

    fn host() -> HostSnapshot {
        let mut host = samples::host("cam-1", "Orin");
        host.accounting = samples::accounting();
        host
    }

    #[test]
    fn events_between_steps_add_up_to_waiting_events() {
        let host = host();
        let account = &host.accounting;
        assert_eq!(account.produced, account.stored + account.waiting + account.dropped);
        let events = Events::of(&host);
        let steps: Vec<(&str, &str)> =
            events.flow.iter().map(|step| (step.number.as_str(), step.note.as_str())).collect();
        assert_eq!(
            steps,
            [
                ("1,204,500", "since the spool was made"),
                ("1,204,370", "80 in memory, 21.2\u{202f}kB"),
                ("1,203,000", "1,370 not yet"),
                ("1,202,988", "12 under way"),
            ]
        );
        assert_eq!(80 + 1_370 + 12, account.waiting);
        assert_eq!(
            (events.spool.percent.as_str(), events.spool.words.as_str()),
            ("29", "312\u{202f}MB of 1.07\u{202f}GB")
        );
    }

    #[test]
    fn catching_up_remark_has_remaining_time_and_rate() {
        let mut host = host();
        host.accounting.dropped = 0;
        host.behind = Some(Span::from_seconds(11_520));
        let texts = |host: &HostSnapshot| -> Vec<String> {
            remarks(host).into_iter().map(|remark| remark.text).collect()
        };
        assert_eq!(
            texts(&host),
            ["storing is 3\u{202f}h 12\u{202f}min behind measuring. Live figures are not affected."]
        );
        host.catching_up =
            Some(CatchingUp { rate: 48.0, events_per_second: 20_100.0, remaining: Span::from_seconds(240) });
        assert_eq!(
            texts(&host),
            [
                "3\u{202f}h 12\u{202f}min behind, about 4\u{202f}min left at 20,100 events/s. Live figures are not affected."
            ]
        );
        host.behind = Some(Span::from_millis(400));
        host.catching_up = None;
        assert!(texts(&host).is_empty(), "a lag of less than 5 s has no remark");
    }

    #[test]
    fn remarks_about_spool_come_first() {
        let mut host = host();
        host.accounting.trouble = Some("no space left on device".into());
        host.accounting.spool_bytes = host.accounting.spool_limit_bytes;
        host.accounting.compressed = true;
        let words: Vec<&str> = remarks(&host).iter().map(|remark| remark.chip.word).collect();
        assert_eq!(words, ["spool fails", "spool full", "lost", "compressed"]);
        let line = EventLine::new(&host);
        assert_eq!(line.remark.expect("the spool has a remark").chip.tone, Tone::Bad);
    }

    #[test]
    fn spool_is_nearly_full_below_its_limit() {
        let mut host = host();
        (host.accounting.spool_bytes, host.accounting.spool_limit_bytes) = (96, 100);
        let remark = remarks(&host).remove(0);
        assert_eq!((remark.chip.word, remark.chip.tone), ("spool nearly full", Tone::Warn));
        assert!(remark.text.starts_with("96\u{202f}% of the spool is used."), "{}", remark.text);
        host.accounting.spool_bytes = 94;
        assert!(remarks(&host).iter().all(|remark| !remark.chip.word.starts_with("spool")));
    }

    #[test]
    fn spool_meter_has_tone_of_spool_remark() {
        let mut host = host();
        host.accounting.spool_limit_bytes = 100;
        for used in [92, 96, 100] {
            host.accounting.spool_bytes = used;
            let remark = remarks(&host).into_iter().find(|remark| remark.chip.word.starts_with("spool"));
            let tone = remark.map_or(Tone::Ok, |remark| remark.chip.tone);
            let meter = Spool::of("cam-1", &host.accounting).meter.to_string();
            assert!(meter.contains(&format!("meter {}\"", tone.class())), "{used}: {meter}");
        }
    }

    #[test]
    fn lost_events_have_chip_and_possible_reasons() {
        let mut host = host();
        let dropped = most_severe_remark(&host).expect("50 were dropped");
        assert_eq!((dropped.chip.word, dropped.chip.tone), ("lost", Tone::Warn));
        assert_eq!(
            dropped.text,
            "50 events dropped because the agent's spool was full, or lost when the agent was killed; the gaps of its runs, or incidents of the kind gap, say why."
        );
        assert_eq!(Events::of(&host).loss_reasons, Some(LOST));
        host.accounting.dropped = 0;
        assert_eq!((most_severe_remark(&host), EventLine::new(&host).loss_reasons), (None, None));
        // Another database stored these events before the host connected to this one.
        (host.stored.missing, host.stored.in_other_database) = (849, 849);
        assert_eq!(most_severe_remark(&host), None);
        host.stored.missing = 2 * 849;
        assert_eq!(
            most_severe_remark(&host).expect("batches are missing").text,
            "849 events missing; the gaps of its runs, or incidents of the kind gap, say why."
        );
    }

    #[test]
    fn gap_of_unknown_size_makes_number_lower_bound() {
        let texts = |missing: u64| {
            let mut host = samples::host("cam-1", "Orin");
            (host.stored.gaps, host.stored.unknown_gaps, host.stored.missing) = (2, 1, missing);
            let remark = most_severe_remark(&host).expect("events are missing").text;
            let (rejected, newest) = (None, None);
            let gaps = stored_count_pairs(&host.stored, rejected, newest, Zone::Utc)[1].1.clone();
            (remark, gaps)
        };
        let expected = |number: &str| {
            let remark = "the gaps of its runs, or incidents of the kind gap, say why.";
            (format!("{number} missing; {remark}"), format!("2, {number} missing"))
        };
        assert_eq!(texts(0), expected("an unknown number of events"));
        assert_eq!(texts(849), expected("at least 849 events"));
    }

    #[test]
    fn spool_without_report_is_not_known_yet() {
        let spool = Events::of(&samples::host("cam-1", "Orin")).spool;
        assert_eq!((spool.percent.as_str(), spool.words.as_str()), ("—", "not known yet"));
    }
}
