//! Delay and throughput against payload in recorded runs: which messages are compared, and which sizes and directions
//! are drawn.
//!
//! A file of results has every message of a run; a page has only the run's sketches. Files and pages both fill
//! [`DirectionMessages`], and the further steps are the same.

use std::collections::BTreeMap;

use peernet_statistics::number::{bytes, counted, range_of_counts};
use peernet_stream::ExperimentPosition;

use crate::concurrent_edges::concurrent_groups;
use crate::message_sizes::{Message, MessageSketches, SizeSummary};
use crate::record::RunRecord;
use crate::rows::{RowRef, is_plausible};
use crate::transfer::DirectionNodes;

/// Maximum number of sizes. If there are more, neighbouring sizes are merged, so that each size has enough messages.
const MAX_SIZES: usize = 24;

/// Link of a run. The address of the cloud is part of the link, because the cloud has a different address in each
/// network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Link {
    /// Names of the edge and of the cloud, each empty if it is not known.
    pub hosts: [String; 2],
    /// Kind of the network and address of the cloud, each empty if it is not known.
    pub network: [String; 2],
}

impl From<&RunRecord> for Link {
    fn from(record: &RunRecord) -> Self {
        let cloud = record.cloud.as_ref().map(|cloud| cloud.name.clone());
        let network = [&record.placement.network, &record.placement.address];
        Self {
            hosts: [record.edge.name.clone(), cloud.unwrap_or_default()],
            network: network.map(|text| text.clone().unwrap_or_default()),
        }
    }
}

impl Link {
    /// Returns the name of the link: the names of its two hosts, as far as they are known, and the address of the
    /// cloud.
    fn name(&self) -> String {
        let hosts: Vec<&str> =
            self.hosts.iter().map(String::as_str).filter(|name| !name.is_empty()).collect();
        let hosts = hosts.join(" → ");
        match self.network[1].trim_start_matches("tcp://") {
            address if !hosts.is_empty() && !address.is_empty() => format!("{hosts} ({address})"),
            _ => hosts,
        }
    }
}

/// Groups runs by their link, in the order of the first run of each link. Each run is given as its link, its position
/// in an experiment (`None` for a run outside of an experiment), and an item that stands for the run. Runs over the
/// same link are one study. The runs of the concurrent edges of an experiment (its *users*: `NAME-1`, `NAME-2`, … on
/// one machine) are one study, too.
pub fn group_by_link<'a, T>(
    runs: impl IntoIterator<Item = (Link, Option<&'a ExperimentPosition>, T)>,
) -> Vec<(Link, Vec<T>)> {
    let runs: Vec<_> = runs.into_iter().collect();
    let indices: Vec<usize> = (0..runs.len()).collect();
    let groups = concurrent_groups(&indices, |run| runs[*run].1, |run| &runs[*run].0.hosts[0]);
    let mut links: Vec<(Link, Vec<T>)> = Vec::new();
    for (index, (mut link, _, run)) in runs.into_iter().enumerate() {
        let is_user = groups.iter().any(|edges| edges.len() > 1 && edges.contains(&&index));
        if is_user && let Some(name) = name_without_number(&link.hosts[0]) {
            link.hosts[0] = name;
        }
        match links.iter_mut().find(|(other, _)| *other == link) {
            Some((_, runs)) => runs.push(run),
            None => links.push((link, vec![run])),
        }
    }
    links
}

/// Returns the name of an edge without the number of its user; `None` if the name has no number.
fn name_without_number(edge: &str) -> Option<String> {
    let (name, number) = edge.rsplit_once('-')?;
    (!number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())).then(|| name.to_owned())
}

/// Messages of one direction of a link, by size.
#[derive(Clone, Debug, PartialEq)]
pub struct DirectionMessages {
    /// `upload` or `download`.
    pub name: &'static str,
    /// Sizes, the smallest first.
    pub sizes: Vec<SizeSummary>,
    /// Number of messages whose size is known, but whose delay is not known.
    unknown_delays: u64,
    /// Number of runs whose messages have several sizes, but count as messages of one size.
    runs_with_several_sizes: u64,
}

impl DirectionMessages {
    /// Returns the messages of these rows, which must be in the statistics. `nodes` has the names of the direction's
    /// nodes.
    pub fn from_rows(nodes: &'static DirectionNodes, rows: &[RowRef<'_>]) -> Self {
        let (name, payload) = (nodes.delay.as_str(), &nodes.payload);
        let [lower, upper] = ["lo", "hi"].map(|suffix| format!("{name}-{suffix}"));
        let mut by_payload: BTreeMap<u64, Vec<Message>> = BTreeMap::new();
        for row in rows {
            let plausible = |column: &str| row.value(column).filter(|value| is_plausible(*value));
            let Some(delay) = plausible(name) else { continue };
            let Some(bytes) = plausible(payload).filter(|bytes| *bytes > 0.0) else { continue };
            let wire_bytes = bytes + plausible(&nodes.metadata).unwrap_or_default();
            let bounds = row.value(&lower).zip(row.value(&upper));
            by_payload.entry(bytes as u64).or_default().push(Message { wire_bytes, delay, bounds });
        }
        // Each item is one message.
        let sizes = merge_sizes(by_payload, |_| 1).into_iter();
        let is_unknown = |row: &&RowRef<'_>| {
            row.has_unknown_delay(name) && row.value(payload).is_some_and(|bytes| bytes > 0.0)
        };
        Self {
            name,
            sizes: sizes.filter_map(|(payload, messages)| SizeSummary::new(payload, &messages)).collect(),
            unknown_delays: rows.iter().filter(is_unknown).count() as u64,
            runs_with_several_sizes: 0,
        }
    }

    /// Returns the messages of stored runs. All messages of a run count as one size, the median of their payloads.
    /// `nodes` has the names of the direction's nodes.
    pub fn from_sketches<'a>(
        nodes: &'static DirectionNodes,
        runs: impl IntoIterator<Item = MessageSketches<'a>>,
    ) -> Self {
        let (mut unknown_delays, mut runs_with_several_sizes) = (0, 0);
        let mut by_payload: BTreeMap<u64, Vec<MessageSketches<'a>>> = BTreeMap::new();
        let delays = |run: &MessageSketches<'_>| run.delay.map_or(0, |delay| delay.count());
        for run in runs {
            let Some(payload) = run.payload.quantile(0.5).filter(|bytes| *bytes > 0.0) else { continue };
            unknown_delays += run.payload.count().saturating_sub(delays(&run));
            // A sketch does not say which delay belongs to which payload.
            runs_with_several_sizes += u64::from(run.payload.moments.max > run.payload.moments.min);
            by_payload.entry(payload as u64).or_default().push(run);
        }
        let sizes = merge_sizes(by_payload, delays).into_iter();
        let summary = |(payload, runs): (u64, Vec<_>)| SizeSummary::from_sketches(payload, &runs);
        let (name, sizes) = (nodes.delay.as_str(), sizes.filter_map(summary).collect());
        Self { name, sizes, unknown_delays, runs_with_several_sizes }
    }

    /// Returns whether the sizes differ enough to show the effect of size on delay: the largest is at least twice the
    /// smallest.
    fn has_varied_sizes(&self) -> bool {
        let ends = self.sizes.first().zip(self.sizes.last());
        ends.is_some_and(|(smallest, largest)| largest.wire_bytes >= 2.0 * smallest.wire_bytes)
    }

    /// Returns the reason why the direction is not drawn; `None` if no message was sent in this direction.
    fn missing_reason(&self) -> Option<String> {
        let Some((smallest, largest)) = self.sizes.first().zip(self.sizes.last()) else {
            let messages = counted(self.unknown_delays, "message");
            let text = || format!("not drawn: {messages} of {}, because no delay is known", self.name);
            return (self.unknown_delays > 0).then(text);
        };
        let ends = [smallest, largest].map(|size| bytes(size.wire_bytes).plain());
        let sizes = if ends[0] == ends[1] { ends[0].clone() } else { ends.join(" to ") };
        Some(format!(
            "not drawn: {} of {sizes}, because the largest size must be at least twice the smallest",
            self.name
        ))
    }

    /// Returns notes on the messages that neither the latency figure nor the throughput figure shows, and on runs whose
    /// messages of several sizes are shown as one point.
    fn notes(&self) -> impl Iterator<Item = String> {
        let name = self.name;
        let sizes_without_positive_delay = self.sizes.iter().filter(|size| size.median <= 0.0).count();
        let unknown_delays = (self.unknown_delays > 0).then(|| {
            let messages = counted(self.unknown_delays, "message");
            format!("left out: {messages} of {name} without a known delay")
        });
        let without_positive_delay = (sizes_without_positive_delay > 0).then(|| {
            let sizes = counted(sizes_without_positive_delay as u64, "size");
            format!("not drawn: {sizes} of {name} whose median delay is not above zero")
        });
        let several_sizes = (self.runs_with_several_sizes > 0).then(|| {
            let runs = counted(self.runs_with_several_sizes, "run");
            format!("{runs} with several sizes of {name}: one point each, at the median size")
        });
        let remark = self.sizes.iter().find_map(|size| size.bounds_method.remark());
        let remark = remark.map(|remark| format!("clock bounds of {name}: {remark}"));
        [unknown_delays, without_positive_delay, several_sizes, remark].into_iter().flatten()
    }
}

/// Merges neighbouring sizes if there are more than [`MAX_SIZES`], so that all sizes have about equal numbers of
/// messages. For example, the compressed images of a camera all have different sizes. `count` returns the number of
/// messages of an item. Returns each merged size as its smallest payload and its items.
fn merge_sizes<T>(by_payload: BTreeMap<u64, Vec<T>>, count: impl Fn(&T) -> u64) -> Vec<(u64, Vec<T>)> {
    let messages = |items: &[T]| items.iter().map(&count).sum::<u64>();
    let total = by_payload.values().map(|items| messages(items)).sum::<u64>().max(1);
    let is_merged = by_payload.len() > MAX_SIZES;
    let mut merged: Vec<(u64, Vec<T>)> = Vec::new();
    let (mut messages_before, mut last_part) = (0, None);
    for (payload, items) in by_payload {
        // All messages, sorted by size, are divided into MAX_SIZES parts. A size belongs to the part of its first
        // message.
        let part = messages_before * MAX_SIZES as u64 / total;
        messages_before += messages(&items);
        match merged.last_mut() {
            Some((_, all)) if is_merged && last_part == Some(part) => all.extend(items),
            _ => merged.push((payload, items)),
        }
        last_part = Some(part);
    }
    merged
}

/// Messages over one link.
#[derive(Clone, Debug, PartialEq)]
pub struct PayloadStudy {
    /// Name of the link, for titles; empty if neither host is known.
    pub link_name: String,
    /// Directions that are drawn.
    pub directions: Vec<DirectionMessages>,
    /// Notes on the directions and the links that are not drawn.
    pub missing: Vec<String>,
    /// Notes on the messages.
    notes: Vec<String>,
}

impl PayloadStudy {
    /// Returns the study of a link from the messages of its two directions. `notes` are further notes on these
    /// messages.
    pub fn new(
        link: &Link,
        directions: [DirectionMessages; 2],
        notes: impl IntoIterator<Item = String>,
    ) -> Self {
        let (directions, others): (Vec<DirectionMessages>, Vec<DirectionMessages>) =
            directions.into_iter().partition(DirectionMessages::has_varied_sizes);
        Self {
            link_name: link.name(),
            missing: others.iter().filter_map(DirectionMessages::missing_reason).collect(),
            notes: notes.into_iter().chain(directions.iter().flat_map(DirectionMessages::notes)).collect(),
            directions,
        }
    }

    /// Selects the studies that have a direction to draw. The first selected study gets the notes on the links that are
    /// left out.
    pub fn select_drawable(studies: impl IntoIterator<Item = Self>) -> Vec<Self> {
        let (mut drawable, others): (Vec<Self>, Vec<Self>) =
            studies.into_iter().partition(|study| !study.directions.is_empty());
        let others = others.into_iter().flat_map(|study| {
            let name = study.link_name;
            let with_name = move |missing: String| match name.as_str() {
                "" => missing,
                name => format!("{missing} · {name}"),
            };
            study.missing.into_iter().map(with_name)
        });
        if let Some(first) = drawable.first_mut() {
            first.missing.extend(others);
        }
        drawable
    }

    /// Returns all notes: what is not drawn, how the messages were selected, and the number of messages behind each
    /// point.
    pub fn all_notes(&self) -> Vec<String> {
        self.missing.iter().chain(&self.notes).cloned().chain(self.count_note()).collect()
    }

    fn count_note(&self) -> Option<String> {
        let counts = self.directions.iter().flat_map(|direction| &direction.sizes).map(|size| size.count);
        Some(format!("messages of each size: {}", range_of_counts(counts)?))
    }
}

/// Returns a note that the messages of several runs are pooled. The note names the axes of the experiment on which the
/// runs differ. `labels_of_runs` has the labels of each run, one for each axis. `None` for a single run.
pub fn pooled_note(axes: &[String], labels_of_runs: &[&[String]]) -> Option<String> {
    let (first, others) = labels_of_runs.split_first()?;
    (!others.is_empty()).then_some(())?;
    let differs = |axis: usize| others.iter().any(|labels| labels.get(axis) != first.get(axis));
    // The axis `run` has only the names of folders or pipelines.
    let differing = axes.iter().enumerate().filter(|(axis, name)| *name != "run" && differs(*axis));
    let differing: Vec<&str> = differing.map(|(_, name)| name.as_str()).collect();
    let count = labels_of_runs.len();
    Some(match differing.as_slice() {
        [] => format!("messages of {count} runs, pooled"),
        axes => format!("messages of {count} runs, pooled, that differ in {}", axes.join(", ")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_sizes_are_merged_but_none_is_split() {
        // There are a hundred sizes, and half of all messages have the size 40.
        let by_payload: BTreeMap<u64, Vec<u64>> =
            (0..100).map(|size| (size, vec![if size == 40 { 990 } else { 10 }])).collect();
        let merged = merge_sizes(by_payload, |count| *count);
        // Each of the 24 parts has 1,980 / 24 = 82.5 messages. The other sizes have half of all
        // messages, so they fill about 12 parts. At most nine of them share a part with size 40:
        // 9 * 10 + 990 = 1,080 messages.
        assert!((12..=MAX_SIZES).contains(&merged.len()), "{merged:?}");
        assert_eq!(merged.iter().flat_map(|(_, counts)| counts).sum::<u64>(), 1_980);
        assert!(merged.iter().all(|(_, counts)| counts.iter().sum::<u64>() <= 1_080), "{merged:?}");
        let few = (0..MAX_SIZES as u64).map(|size| (size, vec![size])).collect();
        assert_eq!(merge_sizes(few, |count| *count).len(), MAX_SIZES, "few sizes stay separate");
    }

    #[test]
    fn direction_without_known_delays_is_noted() {
        let direction = |name, unknown_delays| DirectionMessages {
            name,
            sizes: Vec::new(),
            unknown_delays,
            runs_with_several_sizes: 0,
        };
        let link = Link { hosts: Default::default(), network: Default::default() };
        let study = PayloadStudy::new(&link, [direction("upload", 2), direction("download", 0)], []);
        assert_eq!(study.missing, ["not drawn: 2 messages of upload, because no delay is known"]);
    }

    fn link(edge: &str, address: &str) -> Link {
        Link {
            hosts: [edge.to_owned(), "cloud".to_owned()],
            network: ["zmq-tcp".to_owned(), address.to_owned()],
        }
    }

    fn position(users: &str) -> ExperimentPosition {
        ExperimentPosition {
            name: "line".to_owned(),
            id: "1".to_owned(),
            configuration: vec![("Users".to_owned(), users.to_owned())],
            repeat: 0,
            ..ExperimentPosition::default()
        }
    }

    #[test]
    fn runs_over_one_link_are_one_study() {
        let runs = [("a", "tcp://x:1"), ("b", "tcp://x:1"), ("a", "tcp://x:1"), ("a", "tcp://y:1")];
        let links = group_by_link(runs.iter().zip(0..).map(|((edge, at), run)| (link(edge, at), None, run)));
        let names: Vec<(String, Vec<i32>)> =
            links.into_iter().map(|(link, runs)| (link.name(), runs)).collect();
        let expected =
            [("a → cloud (x:1)", vec![0, 2]), ("b → cloud (x:1)", vec![1]), ("a → cloud (y:1)", vec![3])];
        assert_eq!(names, expected.map(|(name, runs)| (name.to_owned(), runs)));
        // First one user, then two users at the same time.
        let (alone, together) = (position("1"), position("2"));
        let users = [("a-7", &alone), ("a-7-1", &together), ("a-7-2", &together)];
        let users = users.map(|(edge, position)| (link(edge, "tcp://x:1"), Some(position), ()));
        let links = group_by_link(users);
        assert_eq!(links.len(), 1, "{links:?}");
        assert_eq!(links[0].0.name(), "a-7 → cloud (x:1)");
        let unknown = Link { hosts: Default::default(), network: link("a", "tcp://x:1").network };
        assert_eq!(unknown.name(), "");
    }

    #[test]
    fn edge_that_repeated_run_is_no_user() {
        let position = position("1");
        // The second run measured the position of the first run again.
        let runs = [0, 1].map(|run| (link("a-1", "tcp://x:1"), Some(&position), run));
        let links = group_by_link(runs);
        assert_eq!((links.len(), links[0].0.name().as_str()), (1, "a-1 → cloud (x:1)"));
    }
}
