//! Origin of the bounds of an offset, and advice to narrow the bounds.

use peernet_clock::{ClockClaim, DelaySource, Interval, Offset, RelatedClocks, Span};
use peernet_statistics::number::{NONE, SPACE, count, interval_ms, trip_ms};
use peernet_stream::{HostClock, Probing};

use super::list::TOO_YOUNG;
use super::time_series::LinkTimeSeries;
use super::{Subject, is_young};

/// The interval of the offset by one source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SourceRow {
    pub name: String,
    /// Ends of the interval, ms.
    pub between: String,
    pub width: String,
    /// `true` for the row of the bound that results from all sources.
    pub is_result: bool,
}

/// The sources of the bounds of an offset, the reasons for their width, and advice.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Origin {
    /// `Where the bounds come from`.
    pub title: String,
    pub rows: Vec<SourceRow>,
    /// Reasons for the width of the bounds, or for the absence of bounds, in sentences.
    pub why: Vec<String>,
    /// Purpose of the hints: `To narrow the bounds`.
    pub hint_title: &'static str,
    /// Advice, most promising first.
    pub hints: Vec<String>,
}

/// Returns the row of a source.
fn row(name: String, interval: Interval) -> SourceRow {
    let between = interval_ms(interval.lo.seconds(), interval.hi.seconds());
    SourceRow { name, between, width: trip_ms(interval.width().seconds()), is_result: false }
}

/// Number of exchanges for [`source`] if the source is not in-band.
const NO_EXCHANGES: u64 = 0;

/// Returns a source in words. Only the words for in-band offsets have the number of exchanges.
pub(crate) fn source(source: DelaySource, exchanges: u64) -> String {
    match source {
        DelaySource::InBand => format!("in-band, {} exchanges", count(exchanges)),
        DelaySource::Kernel => "as claimed by the kernels of both hosts".to_owned(),
        DelaySource::Chrony => "as claimed by chrony on both hosts".to_owned(),
        DelaySource::SameClock => "one clock".to_owned(),
        DelaySource::Intersection => "intersection".to_owned(),
        DelaySource::None => "none".to_owned(),
    }
}

impl Origin {
    /// Describes the origin of the bounds of a link's offset.
    pub(crate) fn of(subject: &Subject<'_>, time_series: &LinkTimeSeries) -> Self {
        let Some(offset) = subject.offset() else {
            let why = match subject.was_related() {
                Some(true) => {
                    "No exchange has finished since a clock was stepped: earlier exchanges do not bound the present offset."
                }
                Some(false) => {
                    "No exchange between the two hosts has finished yet. A data message and its answer are an exchange, and so are a \
                     probe and its answer."
                }
                None => "No offset of the two clocks was stored in this time.",
            };
            return Self {
                title: "Why there is no bound".to_owned(),
                why: vec![why.to_owned()],
                hint_title: "To get one",
                hints: hints(subject, None),
                ..Self::default()
            };
        };
        let mut rows: Vec<SourceRow> = offset
            .sources
            .iter()
            .map(|(name, interval)| row(source(*name, offset.exchanges), *interval))
            .collect();
        let has_several = offset.sources.len() > 1;
        if !offset.is_consistent() {
            // The bounds of such an offset span intervals that exclude each other, and say nothing about the offset.
            // They are not shown.
            let name = if has_several { "no common interval" } else { "not to be trusted" };
            let none = || NONE.to_owned();
            rows.push(SourceRow { name: name.to_owned(), between: none(), width: none(), is_result: true });
            let (why, hint) = if has_several { CONTRADICTING_SOURCES } else { CONTRADICTING_EXCHANGES };
            return Self {
                title: "Why there is no value".to_owned(),
                rows,
                why: vec![why.to_owned()],
                hint_title: "To find out",
                hints: vec![hint.to_owned()],
            };
        }
        rows.extend(unused_claims(subject, offset));
        let result_name = if has_several { "intersection" } else { "used" };
        rows.push(SourceRow { is_result: true, ..row(result_name.to_owned(), offset.bounds) });
        let verb = if subject.connected { "come" } else { "came" };
        Self {
            title: format!("Where the bounds {verb} from"),
            rows,
            why: explain_bound(offset, time_series),
            hint_title: "To narrow the bounds",
            hints: hints(subject, Some(offset)),
        }
    }
}

/// Returns the row of the offset that follows from the present claims of both hosts' time daemons;
/// `None` if delays depend on claims, or a host reports no claim.
fn unused_claims(subject: &Subject<'_>, offset: &Offset) -> Option<SourceRow> {
    let (claim_source, interval) = claimed_offset(subject)?;
    let is_unused = offset.sources.iter().all(|(source, _)| *source == DelaySource::InBand);
    // Claims are about wall clocks, so the offset that follows from two claims is an offset of wall clocks.
    let clocks = if subject.clocks() == RelatedClocks::Wall { "" } else { ", of the wall clocks" };
    is_unused.then(|| row(format!("{}{clocks}, not used", source(claim_source, NO_EXCHANGES)), interval))
}

/// Returns the offset of the wall clocks that follows from the present claims of both hosts' time daemons.
fn claimed_offset(subject: &Subject<'_>) -> Option<(DelaySource, Interval)> {
    let link = subject.live?;
    let claim = |clock: &Option<HostClock>| clock.as_ref()?.claim;
    let (edge, cloud) = (claim(&link.live.edge)?, claim(&link.live.cloud)?);
    Some(ClockClaim::offset(&edge, &cloud))
}

/// The key that lets claims of time daemons narrow a bound.
const TRUST_KEY: &str = "[clock] trust_time_daemons";

/// Explanation and advice for sources that exclude each other.
const CONTRADICTING_SOURCES: (&str, &str) = (
    "The sources above exclude each other: at least one of them is wrong, and which one cannot be told from here. The \
     exchanges are valid whatever the clocks show, as long as neither host reports wrong stamps. A time daemon is \
     wrong about its clock if its servers are wrong, or if it steers a different clock than the one that stamps messages.",
    "see on both hosts what the time daemon follows (chronyc sources, chronyc tracking) and compare both with a third \
     clock; look for a clock that clock fault injection, a container or libfaketime changes without its daemon's knowledge",
);
/// Explanation and advice for exchanges that contradict each other.
const CONTRADICTING_EXCHANGES: (&str, &str) = (
    "The exchanges contradict each other again and again: the clocks drift apart faster than [clock] max_drift_ppm \
     allows or change their drift faster than max_drift_change_ppm_per_s allows, or one of the hosts reports wrong stamps.",
    "read the incidents of the link, which name the limit that is broken, and raise it on the edge ([clock] max_drift_ppm or \
     max_drift_change_ppm_per_s) above what the clocks really do",
);

/// Returns the reasons for the width of the bounds, in sentences.
fn explain_bound(offset: &Offset, time_series: &LinkTimeSeries) -> Vec<String> {
    let mut why = Vec::new();
    let half = offset.bounds.width().seconds() / 2.0;
    if is_young(offset) {
        why.push(format!("There are {TOO_YOUNG}."));
    }
    if let Some((min, _)) = time_series.round_trips() {
        let best = min / 2.0;
        let smallest = format!("The smallest probe round trip took {}{SPACE}ms", trip_ms(min));
        let general = "A round trip cannot tell how its time splits between the directions.".to_owned();
        // A deviation of less than 30 % from the width that the smallest round trip gives needs no
        // explanation.
        why.push(if half > best * 1.3 {
            format!(
                "{general} {smallest}, so at best the bounds of the offset are that far apart; since then they move apart with \
                 the drift that two clocks may have."
            )
        } else if half < best * 0.7 {
            format!("{general} {smallest}, and alone it gives bounds that are that far apart; {}.", describe_narrowing(offset))
        } else {
            format!("{general} {smallest}, so the bounds of the offset are about that far apart.")
        });
    } else {
        why.push(
            "No probe came back in this time: the bound rests on the data messages, whose round trips are longer, so it is \
             wider than it could be."
                .to_owned(),
        );
    }
    if let Some(age) = offset.age.filter(|age| age.seconds() > 5.0) {
        why.push(format!(
            "The newest exchange is {} old.",
            peernet_statistics::number::long_duration(age.seconds())
        ));
    }
    why
}

/// Returns the reason why the bounds are narrower than the best round trip alone can make them.
fn describe_narrowing(offset: &Offset) -> String {
    let others = offset.sources.iter().filter(|(origin, _)| *origin != DelaySource::InBand);
    let others: Vec<String> = others.map(|(origin, _)| source(*origin, NO_EXCHANGES)).collect();
    if others.is_empty() {
        return "the fastest way there and the fastest way back, of different exchanges, narrow the bounds \
                together"
            .to_owned();
    }
    format!("the offset {} narrows the bounds", others.join(" and "))
}

/// Smallest error that a time daemon usually claims. A time daemon is recommended only if half the width of the bounds
/// is larger.
const BEST_CLAIM: Span = Span::from_micros(50);

/// Returns advice to narrow the bounds of a link, most promising first; empty for a link that is not in the live state.
fn hints(subject: &Subject<'_>, offset: Option<&Offset>) -> Vec<String> {
    let mut hints = Vec::new();
    let Some(link) = subject.live else { return hints };
    match &link.live.probing {
        Probing::Off(reason) => hints.push(format!("let probes through: {reason}")),
        Probing::Unanswered { reason: Some(reason), .. } => hints.push(format!("get probes answered: {reason}")),
        Probing::Unanswered { address, reason: None } => hints.push(format!(
            "open {address} for UDP, and give both ends the same key ([probes] key_file) or none: probes go there and none \
             comes back"
        )),
        // Stamps of the program contain the time that the message waits between program and kernel.
        Probing::On { stamps, .. } if stamps.contains("program") => {
            hints.push("kernel stamps instead of the program's".to_owned());
        }
        Probing::On { .. } => {}
    }
    let has_no_claim = |clock: &Option<HostClock>| clock.as_ref().is_none_or(|clock| clock.claim.is_none());
    let hosts_without_daemon: Vec<&str> =
        [(&link.live.edge, &subject.edge), (&link.live.cloud, &subject.cloud)]
            .into_iter()
            .filter(|(clock, _)| has_no_claim(clock))
            .map(|(_, name)| name.as_str())
            .collect();
    let width = |wanted: fn(DelaySource) -> bool| {
        let entry = offset?.sources.iter().find(|(source, _)| wanted(*source));
        entry.map(|(_, interval)| interval.width())
    };
    let in_band_width = width(|source| source == DelaySource::InBand);
    let claim_width = width(DelaySource::is_claim);
    let is_wide = offset.is_none_or(|offset| offset.bounds.width() > BEST_CLAIM + BEST_CLAIM);
    let claimed_interval = claimed_offset(subject).map(|(_, interval)| interval);
    if !is_wide {
        // The bounds are already narrower than the claim of most time daemons, so a daemon would not help.
    } else if !hosts_without_daemon.is_empty() {
        let hosts = hosts_without_daemon.join(" and ");
        hints.push(format!("PTP or chrony on {hosts}, which gives a second source where {TRUST_KEY} is set"));
    } else if let Some(offset) = offset
        && unused_claims(subject, offset).is_some()
    {
        if claimed_interval.is_some_and(|claimed| claimed.width() >= offset.bounds.width()) {
            hints.push(
                "PTP on both hosts; what their time daemons claim now is wider and does not help".to_owned(),
            );
        } else {
            let edge = &subject.edge;
            hints.push(format!("{TRUST_KEY} = true on {edge}, where both time daemons can be relied on"));
        }
    } else if let Some((in_band, claim)) = in_band_width.zip(claim_width)
        && claim >= in_band
    {
        hints.push(
            "PTP on both hosts; what their time daemons claim now is wider and does not help".to_owned(),
        );
    }
    hints.push("a shorter path between the hosts".to_owned());
    hints
}
