//! Panels of a link: probes, the clocks of both hosts with the claims of time daemons, the configured reflector, and
//! counts of exchanges.

use peernet_clock::Verdict;
use peernet_statistics::number::{self, NONE, SPACE, bound, count, offset_ms, rate, trip_ms};
use peernet_stream::{HostClock, ProbeCounts, Probing};

use super::super::clock_fault::FaultyClocks;
use super::time_series::LinkTimeSeries;
use super::{CONTRADICTION, Subject, estimate_and_max_error};

/// Pairs of a name and a text.
pub(crate) type Pairs = Vec<(&'static str, String)>;

/// The clock of a host, as the host reports it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct HostRow {
    pub name: String,
    pub role: &'static str,
    /// Synchronisation of the clock in words.
    pub text: String,
    /// Error bound that the host's time daemon claims.
    pub claims: String,
    /// Number of detected steps, slews and sleeps of the clock. Each of these begins a new epoch.
    pub steps: String,
    pub clock_fault: Option<String>,
}

/// Returns the bounds of the clock's error that a time daemon claims, in words: `within ±0.42 ms of true
/// time`, `+4,001.08 ms from true time, ±0.04 ms`.
pub(crate) fn reported_error_bounds(clock: &HostClock) -> String {
    let Some(claim) = clock.claim else { return NONE.to_owned() };
    let (lo, hi) = (claim.error.lo.seconds(), claim.error.hi.seconds());
    if lo <= 0.0 && hi >= 0.0 {
        return format!("within {} of true time", bound(hi.max(-lo)));
    }
    let half = (hi - lo) / 2.0;
    format!("{}{SPACE}ms from true time, {}", offset_ms(lo + half, half), bound(half))
}

/// Clock sources that read the counter of the processor.
const PROCESSOR_COUNTERS: [&str; 2] = ["tsc", "arch_sys_counter"];
/// Clock sources that read another counter of a machine or of its kernel. A clock source in neither list counts as
/// one of a hypervisor, which may change the rate of a clock that the guest considers free-running.
const OTHER_COUNTERS: [&str; 4] = ["hpet", "acpi_pm", "jiffies", "refined-jiffies"];

/// Describes how a clock is synchronised, and whether the hypervisor supplies it.
pub(crate) fn describe_synchronisation(clock: &HostClock) -> String {
    let text = match (clock.text.is_empty(), clock.claim) {
        (false, _) => clock.text.clone(),
        (true, Some(claim)) => claim.source.name().to_owned(),
        (true, None) => "not reported".to_owned(),
    };
    match clock.clocksource.as_deref() {
        Some(source) if OTHER_COUNTERS.contains(&source) => {
            format!("{text}; clock source {source} instead of the processor's counter")
        }
        Some(source) if !PROCESSOR_COUNTERS.contains(&source) => {
            format!("{text}; clock supplied by the hypervisor ({source})")
        }
        _ => text,
    }
}

/// Returns the rows of both hosts; empty for a link that is not in the live state.
pub(crate) fn hosts(subject: &Subject<'_>, faulty_clocks: &FaultyClocks) -> Vec<HostRow> {
    let Some(link) = subject.live else { return Vec::new() };
    let row = |name: &str, role, clock: Option<&HostClock>| HostRow {
        name: name.to_owned(),
        // A host may have the name `edge` or `cloud`. Then the role would repeat the name.
        role: if role == name { "" } else { role },
        text: clock.map_or_else(|| "has not reported yet".to_owned(), describe_synchronisation),
        claims: clock.map_or_else(|| NONE.to_owned(), reported_error_bounds),
        steps: clock.map_or_else(|| NONE.to_owned(), |clock| count(clock.epoch.into())),
        clock_fault: faulty_clocks.0.get(name).cloned(),
    };
    vec![
        row(&subject.edge, "edge", link.live.edge.as_ref()),
        row(&subject.cloud, "cloud", link.live.cloud.as_ref()),
    ]
}

/// Returns the state of the probing: `10 probes/s, stamps: kernel`, `probes unanswered` or `no probes`.
pub(crate) fn probing(probing: &Probing) -> String {
    match probing {
        Probing::On { rate_hz, stamps, .. } => format!("{}{SPACE}probes/s, stamps: {stamps}", rate(*rate_hz)),
        Probing::Unanswered { .. } => "probes unanswered".to_owned(),
        Probing::Off(_) => "no probes".to_owned(),
    }
}

/// Returns the panel about probes.
pub(crate) fn probes(subject: &Subject<'_>, time_series: &LinkTimeSeries) -> Pairs {
    let mut pairs: Pairs = match subject.live.map(|link| &link.live.probing) {
        Some(Probing::On { address, rate_hz, stamps }) => vec![
            ("Sent to", address.clone()),
            ("Rate", format!("{}{SPACE}/s", rate(*rate_hz))),
            ("Stamps", stamps.clone()),
        ],
        Some(Probing::Unanswered { address, reason }) => {
            let why = reason.as_deref().unwrap_or(
                "the port is blocked, the reflector is gone, or the two ends do not have the same key ([probes] key_file)",
            );
            let answers = format!("none lately: {why}; data messages still bound the offset");
            vec![("Sent to", address.clone()), ("Answers", answers)]
        }
        Some(Probing::Off(reason)) => vec![("Off", reason.clone())],
        None => vec![("Now", "the edge is not connected".to_owned())],
    };
    let counts = time_series.probes();
    if counts != ProbeCounts::default() {
        pairs.push(("In this time", format_counts(&counts)));
    }
    if let Some((min, median)) = time_series.round_trips() {
        pairs.push(("Round trip", format_round_trip(min, median)));
    }
    pairs
}

/// Returns `1,200 sent, 1,198 answered, 2 lost`, and the number of refused packets unless it is zero.
fn format_counts(counts: &ProbeCounts) -> String {
    let [sent, answered, lost, refused] =
        [counts.sent, counts.answered, counts.lost, counts.refused].map(|one| count(one.into()));
    let refused = if counts.refused > 0 { format!(", {refused} refused") } else { String::new() };
    format!("{sent} sent, {answered} answered, {lost} lost{refused}")
}

fn format_round_trip(min: f64, median: f64) -> String {
    format!("{}{SPACE}ms at least, {}{SPACE}ms median", trip_ms(min), trip_ms(median))
}

/// Returns the panel about the configured reflector; empty without one.
pub(crate) fn reflector(subject: &Subject<'_>) -> Pairs {
    let Some(reflector) = subject.live.and_then(|link| link.live.reflector.as_ref()) else {
        return Vec::new();
    };
    let state = match &reflector.probing {
        Probing::On { address, rate_hz, stamps } => {
            ("Sent to", format!("{address}, {}{SPACE}/s, stamps: {stamps}", rate(*rate_hz)))
        }
        Probing::Unanswered { address, reason } => {
            let why = reason.as_deref().unwrap_or("the port is blocked, or no reflector is there");
            ("Answers", format!("none lately from {address}: {why}"))
        }
        Probing::Off(reason) => ("Off", reason.clone()),
    };
    let mut pairs = vec![("Configured", reflector.address.clone()), state];
    pairs.push(("In all", format_counts(&reflector.probes)));
    if let Some(trip) = reflector.round_trip {
        pairs.push(("Round trip", format_round_trip(trip.min.seconds(), trip.median.seconds())));
    }
    let offset = reflector.offset.as_ref().map(|offset| match estimate_and_max_error(offset) {
        Some((estimate, max_error)) => {
            let words = format!("{}{SPACE}ms, {}", offset_ms(estimate, max_error), bound(max_error));
            if offset.verdict == Verdict::Stale { format!("{words}, stale") } else { words }
        }
        None => CONTRADICTION.to_owned(),
    });
    let words = offset.map_or_else(
        || "not known yet".to_owned(),
        |words| format!("{words}: its wall clock minus {}'s", subject.edge),
    );
    pairs.push(("Offset", words));
    pairs.push((
        "Tied to",
        format!(
            "no host: it is not proven that the reflector reads the clock of {}, so no delay is computed with it",
            subject.cloud
        ),
    ));
    pairs
}

/// Returns the panel with the counts of the exchanges; empty for a link that is not in the live state.
pub(crate) fn exchanges(subject: &Subject<'_>) -> Pairs {
    let Some(link) = subject.live else { return Vec::new() };
    let counts = link.live.latest_sample.exchanges;
    vec![
        ("Used", format!("{} exchanges", count(counts.accepted))),
        ("Impossible", format!("{}, refused: no two clocks can show them", count(counts.impossible))),
        ("Outliers", format!("{}, refused: they contradict all others", count(counts.outliers))),
        ("Stepped", format!("{}, refused: a clock was stepped meanwhile", count(counts.stepped))),
        (
            "Estimate restarted",
            format!("{} after a clock step", number::counted(counts.restarts.into(), "time")),
        ),
    ]
}
