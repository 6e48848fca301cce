//! Hosts in a table, and the notes on them.

use std::cmp::Reverse;

use peernet_aggregator::{HostSnapshot, LiveState, MetricsPoint};
use peernet_clock::{ClockIdentity, Span, WallTime};
use peernet_figures::drawing::sparkline;
use peernet_statistics::number::{NONE, SPACE, count, fixed, gigabytes, long_duration, whole_percent};
use peernet_stream::{Hardware, HostMetrics};

use super::chip::{Chip, Tone};
use super::clock_fault::FaultyClocks;
use super::events::{self, FAR_BEHIND, Remark};
use super::link::panels::describe_synchronisation;
use super::notes::Note;
use super::warnings;
use crate::config::WarnConfig;
use crate::picture::Picture;
use crate::zone::{Zone, ZonedTime};

/// Current state of one host. The texts have no units, because the header of the table shows them.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct HostLine {
    pub name: String,
    /// Tone of the most severe of the [`notes`] on the host.
    pub tone: Tone,
    /// Most severe remark; `None` if there is nothing to remark.
    pub remark: Option<Remark>,
    /// Time of the last report, for a host that does not report now.
    pub away: Option<ZonedTime>,
    /// Chip of a host whose agent said goodbye before it stopped; `None` for any other host.
    pub ended: Option<Chip>,
    /// Accelerator of the host, or the processor of a host without an accelerator.
    pub hardware: String,
    /// Busy share of the cores, percent.
    pub cpu: String,
    /// Curve of `cpu` over the last ten minutes.
    pub cpu_spark: Picture,
    /// Used memory, GB.
    pub memory: String,
    /// Installed memory, GB.
    pub memory_of: String,
    /// Busy share of the GPU, percent.
    pub gpu: String,
    pub gpu_spark: Option<Picture>,
    pub temperature: String,
    pub power: String,
    /// Number of events that wait on the host.
    pub waiting: String,
    /// Lag of storage behind measurement, seconds.
    pub behind: String,
    /// Relation of the host's wall clock to the wall clock of the aggregator.
    pub clock: String,
    /// Explanation of `clock`, and how the clock is synchronised.
    pub clock_title: String,
    pub clock_fault: Option<Chip>,
}

/// A host whose connection was refused.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RefusedLine {
    /// Name that the host sent, with its address if the address is known.
    pub who: String,
    pub why: String,
    pub at: ZonedTime,
}

impl RefusedLine {
    pub(crate) fn all(snapshot: &LiveState, zone: Zone) -> Vec<Self> {
        let lines = snapshot.refused.iter().map(|refused_host| Self {
            who: match &refused_host.address {
                Some(address) => format!("{} ({address})", refused_host.name),
                None => refused_host.name.to_string(),
            },
            why: refused_host.reason.clone(),
            at: zone.moment(refused_host.at),
        });
        lines.collect()
    }
}

/// Chip of a host that said goodbye.
const ENDED: Chip = Chip::new(Tone::Quiet, "ok", "ended");
/// Number of points of a sparkline: one every five seconds for ten minutes.
const POINTS: usize = 120;
const POINT_INTERVAL_S: f64 = 5.0;
/// If two points are further apart than this, the host counts as absent between them.
const MIN_ABSENCE: Span = Span::from_seconds(15);

/// Returns the notes on everything about a host that needs attention.
pub(crate) fn notes(host: &HostSnapshot, now: WallTime, zone: Zone, warn: &WarnConfig) -> Vec<Note> {
    let name = host.description.name.as_str();
    let note = |subject: String, chip, text| Note {
        chip,
        subject,
        href: format!("/hosts/{name}"),
        text,
        link: None,
    };
    // An agent that said goodbye was stopped on purpose.
    let away = (!host.connected && !host.has_left).then(|| {
        let seen = zone.moment(host.last_seen).time_of_day();
        let chip = Chip::new(Tone::Warn, "gap", "away");
        note(name.to_owned(), chip, format!("has not reported since {seen}."))
    });
    // A quiet remark, such as `catching up`, needs no attention.
    let remarks = remarks(host, now, warn).filter(|remark| remark.chip.tone >= Tone::Warn);
    let remarks = remarks.map(|Remark { chip, text }| note(format!("{name}:"), chip, text));
    away.into_iter().chain(remarks).collect()
}

/// Returns the remarks on a host's events and on its processors.
fn remarks(host: &HostSnapshot, now: WallTime, warn: &WarnConfig) -> impl Iterator<Item = Remark> {
    events::remarks(host).into_iter().chain(warnings::host_warning(host, now, warn))
}

/// Returns the values of a sparkline, oldest first. `None` makes a gap.
fn history(
    points: &[std::sync::Arc<MetricsPoint>],
    share_of: impl Fn(&HostMetrics) -> Option<f64>,
) -> Vec<Option<f64>> {
    // The newest point is always at the right end. If the first point is less than ten minutes old, the time before it
    // is a gap.
    let mut newest_first = Vec::with_capacity(POINTS);
    let mut later_time = None;
    for point in points.iter().rev() {
        // The time in which the host did not report becomes a gap.
        let time_to_next = later_time.map_or(Span::ZERO, |later_time| later_time - point.at);
        if time_to_next > MIN_ABSENCE {
            let missing = ((time_to_next.seconds() / POINT_INTERVAL_S) as usize).saturating_sub(1);
            newest_first.resize((newest_first.len() + missing).min(POINTS), None);
        }
        newest_first.push(share_of(&point.metrics));
        later_time = Some(point.at);
    }
    newest_first.resize(POINTS, None);
    newest_first.reverse();
    newest_first
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| NONE.to_owned(), whole_percent)
}

/// Returns a short name of the hardware: the first accelerator, or the processor if there is no accelerator.
pub(crate) fn hardware_name(hardware: &Hardware) -> String {
    let name = hardware.gpus.first().unwrap_or(&hardware.cpu);
    ["(R)", "(TM)", "NVIDIA ", "Processor", "CPU"]
        .iter()
        .fold(name.clone(), |name, ignored| name.replace(ignored, ""))
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
}

/// Describes a host's wall clock relative to the wall clock of the aggregator. Returns a text for
/// the table, and an explanation.
///
/// Processes of one machine report the same boot id, but copies of a virtual machine do so, too. A
/// clock that differs by a second or more is therefore described as a different clock.
pub(crate) fn clock_words(theirs: &ClockIdentity, ours: &ClockIdentity, ahead: Span) -> (String, String) {
    if theirs == ours {
        return ("the aggregator's".to_owned(), "it reads the same clock as the aggregator".to_owned());
    }
    let size = ahead.abs().seconds();
    if theirs.may_share_clock_with(ours) && size < 1.0 {
        let title = "it reports the same machine and clock as the aggregator; the page of a link says whether that is proven";
        return ("the aggregator's".to_owned(), title.to_owned());
    }
    let title = format!("its own clock, within 1{SPACE}s of the aggregator's when its last update arrived");
    // The difference includes the time that the update took on the network, so small differences mean nothing.
    if size < 1.0 {
        return ("its own".to_owned(), title);
    }
    let away = format!("{} {}", long_duration(size), if ahead.is_negative() { "behind" } else { "ahead" });
    (format!("its own, {away}"), format!("its own clock, {away} when its last update arrived"))
}

impl HostLine {
    /// Converts the first `limit` hosts of the live state. Returns the hosts whose agents have not said goodbye, and
    /// the hosts whose agents have.
    pub(crate) fn current_and_ended(
        limit: usize,
        snapshot: &LiveState,
        ours: &ClockIdentity,
        zone: Zone,
        warn: &WarnConfig,
    ) -> (Vec<Self>, Vec<Self>) {
        let faulty_clocks = FaultyClocks::of(snapshot);
        let lines = snapshot.hosts.iter().take(limit);
        let lines = lines.map(|host| Self::new(host, &faulty_clocks, ours, snapshot.at, zone, warn));
        lines.partition(|line| line.ended.is_none())
    }

    pub(crate) fn new(
        host: &HostSnapshot,
        faulty_clocks: &FaultyClocks,
        ours: &ClockIdentity,
        now: WallTime,
        zone: Zone,
        warn: &WarnConfig,
    ) -> Self {
        let name = host.description.name.to_string();
        let metrics = &host.metrics;
        let (clock, clock_title) = clock_words(&host.description.clock, ours, host.clock_ahead);
        let is_far_behind = host.behind.is_some_and(|behind| behind > FAR_BEHIND);
        // A quiet remark, such as `compressed`, is shown only while storage lags far behind.
        let remark = remarks(host, now, warn)
            .min_by_key(|remark| Reverse(remark.chip.tone))
            .filter(|remark| is_far_behind || remark.chip.tone >= Tone::Warn);
        let notes = notes(host, now, zone, warn);
        let chips = notes.iter().map(|note| note.chip).chain(remark.as_ref().map(|remark| remark.chip));
        let least = if host.has_left { Tone::Quiet } else { Tone::Ok };
        let tone = chips.map(|chip| chip.tone).fold(least, Tone::max);
        let spark = |quantity: &str, share_of: fn(&HostMetrics) -> Option<f64>| {
            let items = sparkline(&history(&host.history, share_of));
            Picture::of_items(&items, "spark", &format!("{quantity} of {name}, last 10 minutes"))
        };
        Self {
            tone,
            remark,
            away: (!host.connected).then(|| zone.moment(host.last_seen)),
            ended: host.has_left.then_some(ENDED),
            hardware: hardware_name(&host.description.hardware),
            cpu: percent(metrics.cpu),
            cpu_spark: spark("CPU", |metrics| metrics.cpu),
            memory: metrics.memory_used_bytes.map_or_else(|| NONE.to_owned(), gigabytes),
            memory_of: gigabytes(host.description.hardware.memory_bytes),
            gpu: percent(metrics.gpu),
            gpu_spark: metrics.gpu.map(|_| spark("GPU", |metrics| metrics.gpu)),
            temperature: metrics.temperature_celsius.map_or_else(|| NONE.to_owned(), |value| fixed(value, 1)),
            power: metrics.power_watts.map_or_else(|| NONE.to_owned(), |watts| fixed(watts, 1)),
            waiting: count(host.accounting.waiting),
            behind: host.behind.map_or_else(|| "0".to_owned(), |behind| fixed(behind.seconds(), 1)),
            clock,
            clock_title: format!("{clock_title}; {}", describe_synchronisation(&host.clock)),
            clock_fault: faulty_clocks.chip(&[&name]),
            name,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::tests::samples::NOW;

    #[test]
    fn hardware_names_lose_trademarks_and_generic_words() {
        let cpu = Hardware { cpu: "Intel(R) Core(TM) i5-1135G7 CPU @ 2.40GHz".into(), ..Hardware::default() };
        assert_eq!(hardware_name(&cpu), "Intel Core i5-1135G7 @ 2.40GHz");
        let gpu = Hardware { gpus: vec!["NVIDIA GeForce RTX 3090".into()], ..cpu };
        assert_eq!(hardware_name(&gpu), "GeForce RTX 3090");
    }

    #[test]
    fn sparkline_has_gap_while_host_was_absent() {
        let at = |seconds: i64, cpu| {
            let metrics = HostMetrics { cpu: Some(cpu), ..HostMetrics::default() };
            Arc::new(MetricsPoint { at: NOW + Span::from_seconds(seconds), metrics })
        };
        let of = |points: &[Arc<MetricsPoint>]| history(points, |metrics| metrics.cpu);
        let points = of(&[at(0, 0.1), at(5, 0.2), at(65, 0.3), at(70, 0.4)]);
        assert_eq!(points.len(), POINTS);
        let last = &points[POINTS - 16..];
        assert_eq!(last[..3], [None, Some(0.1), Some(0.2)]);
        assert!(last[3..14].iter().all(Option::is_none), "{last:?}");
        assert_eq!(last[14..], [Some(0.3), Some(0.4)]);
        let points = of(&[at(0, 0.1), at(6_000, 0.3)]);
        assert_eq!(
            (points.len(), points.iter().flatten().count()),
            (POINTS, 1),
            "the older point is older than ten minutes"
        );
    }

    #[test]
    fn clock_shared_with_aggregator_is_described_so() {
        let ours = ClockIdentity::new("boot", "system");
        assert_eq!(clock_words(&ours, &ours, Span::from_seconds(9)).0, "the aggregator's");
        let other_process = ClockIdentity { process: Some(7), ..ours.clone() };
        assert_eq!(clock_words(&other_process, &ours, Span::from_millis(3)).0, "the aggregator's");
        assert_eq!(
            clock_words(&other_process, &ours, Span::from_seconds(9)).0,
            "its own, 9.0\u{202f}s ahead"
        );
        let other = ClockIdentity::new("other", "system");
        assert_eq!(clock_words(&other, &ours, Span::from_millis(-1_200)).0, "its own, 1.2\u{202f}s behind");
        assert_eq!(clock_words(&other, &ours, Span::from_millis(3)).0, "its own");
    }
}
