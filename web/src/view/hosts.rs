//! Hosts in a table.

use peernet_aggregator::{HostSnapshot, LiveState, MetricsPoint};
use peernet_clock::{ClockIdentity, Span};
use peernet_figures::drawing::sparkline;
use peernet_statistics::number::{NONE, SPACE, count, fixed, gigabytes, length};
use peernet_stream::{Hardware, HostMetrics};

use super::chip::{Chip, Tone};
use super::clock_fault;
use super::events::{self, FAR_BEHIND, Remark};
use super::link::panels::discipline;
use crate::picture::Picture;
use crate::zone::{Zone, ZonedTime};

/// Current state of one host. Texts are figures without their unit, which the header shows.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct HostLine {
    pub name: String,
    pub tone: Tone,
    /// The reason of that tone, where there is one.
    pub remark: Option<Remark>,
    /// `last seen 14:09:12`, for a host that does not report.
    pub away: Option<ZonedTime>,
    /// Accelerator of the host, or its processor where it has none.
    pub kind: String,
    pub cpu: String,
    pub cpu_spark: Picture,
    pub memory: String,
    pub memory_of: String,
    pub gpu: String,
    pub gpu_spark: Option<Picture>,
    pub temperature: String,
    pub power: String,
    pub waiting: String,
    pub behind: String,
    pub clock: String,
    pub clock_title: String,
    pub clock_fault: Option<Chip>,
}

/// A host whose connection was refused.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RefusedLine {
    /// Name that it sent, with its address where it is known.
    pub who: String,
    pub why: String,
    pub at: ZonedTime,
}

impl RefusedLine {
    pub(crate) fn all(picture: &LiveState, zone: Zone) -> Vec<Self> {
        let lines = picture.refused.iter().map(|one| Self {
            who: match &one.address {
                Some(address) => format!("{} ({address})", one.name),
                None => one.name.to_string(),
            },
            why: one.reason.clone(),
            at: zone.moment(one.at),
        });
        lines.collect()
    }
}

/// The points of the sparklines: ten minutes at five seconds.
const POINTS: usize = 120;
const POINT_EVERY_S: f64 = 5.0;
/// Time between two points from which on the host counts as absent.
const SILENT: Span = Span::from_seconds(15);

fn history(
    points: &[std::sync::Arc<MetricsPoint>],
    of: impl Fn(&HostMetrics) -> Option<f64>,
) -> Vec<Option<f64>> {
    // Younger than ten minutes: the line begins at the right, where it will end up.
    let mut newest_first = Vec::with_capacity(POINTS);
    let mut later = None;
    for point in points.iter().rev() {
        // The line is interrupted where the host did not report.
        let silent = later.map_or(Span::ZERO, |later| later - point.at);
        if silent > SILENT {
            let missing = ((silent.seconds() / POINT_EVERY_S) as usize).saturating_sub(1);
            newest_first.resize((newest_first.len() + missing).min(POINTS), None);
        }
        newest_first.push(of(&point.metrics));
        later = Some(point.at);
    }
    newest_first.resize(POINTS, None);
    newest_first.reverse();
    newest_first
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| NONE.to_owned(), |share| fixed(share * 100.0, 0))
}

/// Returns the name by which people know a machine: its accelerator, else its processor.
pub(crate) fn hardware_name(hardware: &Hardware) -> String {
    let name = hardware.gpus.first().unwrap_or(&hardware.cpu);
    ["(R)", "(TM)", "NVIDIA ", "Processor", "CPU"]
        .iter()
        .fold(name.clone(), |name, noise| name.replace(noise, ""))
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
}

/// Describes a host's wall clock relative to the aggregator's. Processes of one machine report the same boot id, but so does a copied
/// virtual machine: a clock that is far away is therefore a different clock.
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
    // The comparison includes the time that the update travelled, so small differences mean nothing.
    if size < 1.0 {
        return ("its own".to_owned(), title);
    }
    let away = format!("{} {}", length(size), if ahead.is_negative() { "behind" } else { "ahead" });
    (format!("its own, {away}"), format!("its own clock, {away} when its last update arrived"))
}

impl HostLine {
    /// Returns the first `most` hosts of a picture.
    pub(crate) fn first(most: usize, picture: &LiveState, ours: &ClockIdentity, zone: Zone) -> Vec<Self> {
        picture.hosts.iter().take(most).map(|host| Self::new(host, ours, zone)).collect()
    }

    pub(crate) fn new(host: &HostSnapshot, ours: &ClockIdentity, zone: Zone) -> Self {
        let name = host.description.name.to_string();
        let metrics = &host.metrics;
        let (clock, clock_title) = clock_words(&host.description.clock, ours, host.clock_ahead);
        let late = host.behind.is_some_and(|behind| behind > FAR_BEHIND);
        let remark = events::worst(host).filter(|remark| late || remark.chip.tone >= Tone::Warn);
        let tone = match &remark {
            _ if host.has_left => Tone::Quiet,
            _ if !host.connected => Tone::Bad,
            Some(remark) => remark.chip.tone.max(Tone::Warn),
            None => Tone::Ok,
        };
        let spark = |what: &str, of: fn(&HostMetrics) -> Option<f64>| {
            let items = sparkline(&history(&host.history, of));
            Picture::of_items(&items, "spark", &format!("{what} of {name}, last 10 minutes"))
        };
        Self {
            tone,
            remark,
            away: (!host.connected).then(|| zone.moment(host.last_seen)),
            kind: hardware_name(&host.description.hardware),
            cpu: percent(metrics.cpu),
            cpu_spark: spark("CPU", |metrics| metrics.cpu),
            memory: metrics.memory_used_bytes.map_or_else(|| NONE.to_owned(), gigabytes),
            memory_of: fixed(host.description.hardware.memory_bytes as f64 / 1e9, 0),
            gpu: percent(metrics.gpu),
            gpu_spark: metrics.gpu.map(|_| spark("GPU", |metrics| metrics.gpu)),
            temperature: metrics.temperature_celsius.map_or_else(|| NONE.to_owned(), |value| fixed(value, 1)),
            power: metrics.power_watts.map_or_else(|| NONE.to_owned(), |watts| fixed(watts, 1)),
            waiting: count(host.accounting.waiting),
            behind: host.behind.map_or_else(|| "0".to_owned(), |behind| fixed(behind.seconds(), 1)),
            clock,
            clock_title: format!("{clock_title}; {}", discipline(&host.clock)),
            clock_fault: host.clock.faults.as_ref().map(|_| clock_fault::CHIP),
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
    fn names_of_hardware_lose_their_noise() {
        let cpu = Hardware { cpu: "Intel(R) Core(TM) i5-1135G7 CPU @ 2.40GHz".into(), ..Hardware::default() };
        assert_eq!(hardware_name(&cpu), "Intel Core i5-1135G7 @ 2.40GHz");
        let gpu = Hardware { gpus: vec!["NVIDIA GeForce RTX 3090".into()], ..cpu };
        assert_eq!(hardware_name(&gpu), "GeForce RTX 3090");
    }

    #[test]
    fn the_line_of_a_host_that_was_away_stops() {
        let at = |seconds: i64, cpu| {
            let metrics = HostMetrics { cpu: Some(cpu), ..HostMetrics::default() };
            Arc::new(MetricsPoint { at: NOW + Span::from_seconds(seconds), metrics })
        };
        let of = |points: &[Arc<MetricsPoint>]| history(points, |metrics| metrics.cpu);
        let known = of(&[at(0, 0.1), at(5, 0.2), at(65, 0.3), at(70, 0.4)]);
        assert_eq!(known.len(), POINTS);
        let last = &known[POINTS - 16..];
        assert_eq!(last[..3], [None, Some(0.1), Some(0.2)]);
        assert!(last[3..14].iter().all(Option::is_none), "{last:?}");
        assert_eq!(last[14..], [Some(0.3), Some(0.4)]);
        let known = of(&[at(0, 0.1), at(6_000, 0.3)]);
        assert_eq!((known.len(), known.iter().flatten().count()), (POINTS, 1), "longer ago than is shown");
    }

    #[test]
    fn one_clock_is_said_to_be_one() {
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
