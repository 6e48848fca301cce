//! Figures of latency and throughput against payload, for runs with payloads of several sizes.

use std::collections::BTreeMap;

use peernet_statistics::number::{bytes, counted, fixed};

use super::columns::{excluded_note, is_drawable, too_large_note, with_name};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::of_messages::{MessageFigures, MessageSeries};
use peernet_analysis::compare::Configurations;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::message_sizes::{Message, SizeSummary};
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::RowRef;

/// Maximum number of sizes. If there are more, neighbouring sizes are merged, so that each has enough messages.
const MAX_SIZES: usize = 24;
/// Columns that the figures are drawn from.
const PAYLOAD_COLUMNS: [&str; 6] =
    ["upload", "upload-bytes", "upload-logger-bytes", "download", "download-bytes", "download-logger-bytes"];
/// Messages in one direction.
struct DirectionData {
    series: MessageSeries,
    /// Number of messages that have a size but no delay.
    unknown_delays: u64,
}

/// Messages over one link.
struct Study {
    /// Directions that are drawn.
    directions: Vec<DirectionData>,
    /// Name of the link, for the title.
    link_name: String,
    notes: Vec<String>,
    /// Notes on the directions that are not drawn.
    missing: Vec<String>,
}

/// Returns two figures for each link: latency and throughput.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    // Indexes of the runs of each link.
    let mut links: Vec<(String, Vec<usize>)> = Vec::new();
    for (number, run) in runs.iter().enumerate() {
        let link = link_key(&run.record);
        match links.iter_mut().find(|(other, _)| *other == link) {
            Some((_, run_indexes)) => run_indexes.push(number),
            None => links.push((link, vec![number])),
        }
    }
    let both_directions = |run_indexes: &[usize]| -> [DirectionData; 2] {
        let rows = run_indexes.iter().flat_map(|index| &runs[*index].rows).filter(|row| row.is_counted());
        let rows: Vec<RowRef<'_>> = rows.collect();
        ["upload", "download"].map(|name| DirectionData::from_rows(name, &rows))
    };
    let configurations = Configurations::from_runs(runs);
    let studies = links.into_iter().map(|(_, run_indexes)| {
        let rows = run_indexes.iter().flat_map(|index| &runs[*index].rows);
        let notes = [
            pooled_note(&configurations, &run_indexes),
            excluded_note(&rows),
            too_large_note(rows, &PAYLOAD_COLUMNS),
        ];
        let (directions, others): (Vec<DirectionData>, Vec<DirectionData>) =
            both_directions(&run_indexes).into_iter().partition(DirectionData::is_varied);
        let undrawn_notes = directions.iter().flat_map(DirectionData::undrawn_notes);
        Study {
            notes: notes.into_iter().flatten().chain(undrawn_notes).collect(),
            link_name: link_name(&runs[run_indexes[0]].record),
            missing: others.iter().filter_map(DirectionData::missing_reason).collect(),
            directions,
        }
    });
    let (mut studies, others): (Vec<Study>, Vec<Study>) =
        studies.partition(|study: &Study| !study.directions.is_empty());
    // The first figure has the notes on links that have no figure.
    let others = others.into_iter().flat_map(|study| {
        let link_name = study.link_name;
        study.missing.into_iter().map(move |missing| with_name(&missing, &link_name))
    });
    if let Some(first) = studies.first_mut() {
        first.missing.extend(others);
    }
    if studies.is_empty() {
        return Err(MissingData::MessageSizes);
    }
    let drawings = studies.iter().enumerate().flat_map(|(number, study)| {
        let suffix = if number == 0 { String::new() } else { format!("-{}", number + 1) };
        let messages = study.messages();
        let [latency, throughput] = [("latency", messages.latency()), ("throughput", messages.throughput())]
            .map(|(name, figure)| {
                Drawing::new(format!("payload-{name}{suffix}"), AnyFigure::Scaling(figure))
            });
        // The text files of both figures have these notes. Only one figure passes them on to the printed list, so that each is printed once.
        [latency.with_left_out(study.missing.clone()), throughput]
    });
    Ok(drawings.collect())
}

/// Returns a text that identifies the link of a run: edge, cloud, network and address. Runs over the same link are one study. The address is
/// part of the text, because a host has a different address in each network.
fn link_key(record: &RunRecord) -> String {
    let cloud = record.cloud.as_ref().map_or("", |cloud| &cloud.name);
    let [network, address] = [&record.placement.network, &record.placement.address]
        .map(|text| text.as_deref().unwrap_or_default());
    format!("{}, {cloud}, {network}, {address}", record.edge.name)
}

/// Returns the name of a run's link: the names of its two hosts, as far as they are known, and the address of the cloud.
fn link_name(record: &RunRecord) -> String {
    let hosts =
        [Some(&record.edge), record.cloud.as_ref()].into_iter().flatten().map(|host| host.name.as_str());
    let hosts = hosts.filter(|name| !name.is_empty()).collect::<Vec<_>>().join(" → ");
    match record.placement.address.as_deref().map(|address| address.trim_start_matches("tcp://")) {
        Some(address) if !hosts.is_empty() => format!("{hosts} ({address})"),
        _ => hosts,
    }
}

/// Returns a note that the messages of several runs are pooled, with the names of the labels in which the runs differ. `None` for a single
/// run.
fn pooled_note(configurations: &Configurations, runs: &[usize]) -> Option<String> {
    (runs.len() > 1).then_some(())?;
    let label = |run: usize, axis: usize| &configurations.labels[run][axis];
    let differing = configurations.axes.iter().enumerate().filter(|(axis, name)| {
        *name != "run" && runs.iter().any(|run| label(*run, *axis) != label(runs[0], *axis))
    });
    let differing: Vec<&str> = differing.map(|(_, name)| name.as_str()).collect();
    let count = runs.len();
    Some(match differing.as_slice() {
        [] => format!("messages of {count} runs, pooled"),
        axes => format!("messages of {count} runs, pooled, that differ in {}", axes.join(", ")),
    })
}

impl DirectionData {
    /// Returns whether the sizes differ enough to show their effect.
    fn is_varied(&self) -> bool {
        let sizes = &self.series.sizes;
        let ends = sizes.first().zip(sizes.last());
        ends.is_some_and(|(smallest, largest)| largest.wire_bytes >= 2.0 * smallest.wire_bytes)
    }

    /// Returns the reason why the direction is not drawn; `None` if nothing was sent.
    fn missing_reason(&self) -> Option<String> {
        let MessageSeries { name, sizes, .. } = &self.series;
        let (smallest, largest) = sizes.first().zip(sizes.last())?;
        let ends = [smallest, largest].map(|size| bytes(size.wire_bytes).plain());
        let sizes = if ends[0] == ends[1] { ends[0].clone() } else { ends.join(" to ") };
        Some(format!("not drawn: {name}, {sizes}: the largest must be twice the smallest"))
    }

    /// Returns notes on the messages that are in neither figure.
    fn undrawn_notes(&self) -> Vec<String> {
        let MessageSeries { name, sizes, .. } = &self.series;
        let negative_sizes = sizes.iter().filter(|size| size.median <= 0.0).count();
        let unknown_delays_note = (self.unknown_delays > 0).then(|| {
            let messages = counted(self.unknown_delays, "message");
            format!("left out: {messages} of {name} without a known delay")
        });
        let negative_delays_note = (negative_sizes > 0).then(|| {
            let sizes = counted(negative_sizes as u64, "size");
            format!("not drawn: {sizes} of {name} whose median delay is not above zero")
        });
        unknown_delays_note.into_iter().chain(negative_delays_note).collect()
    }

    fn from_rows(name: &'static str, rows: &[RowRef<'_>]) -> Self {
        let [payload, metadata, lower, upper] =
            ["bytes", "logger-bytes", "lo", "hi"].map(|suffix| format!("{name}-{suffix}"));
        let mut by_payload: BTreeMap<u64, Vec<Message>> = BTreeMap::new();
        for row in rows {
            let drawable = |column: &str| row.value(column).filter(|value| is_drawable(*value));
            let Some(delay) = drawable(name) else { continue };
            let Some(bytes) = drawable(&payload).filter(|bytes| *bytes > 0.0) else { continue };
            let wire_bytes = bytes + drawable(&metadata).unwrap_or_default();
            let bounds = row.value(&lower).zip(row.value(&upper));
            by_payload.entry(bytes as u64).or_default().push(Message { wire_bytes, delay, bounds });
        }
        let sizes = merge_sizes(by_payload).into_iter();
        let sizes = sizes.filter_map(|(payload, messages)| SizeSummary::new(payload, &messages)).collect();
        let is_unknown = |row: &&RowRef<'_>| {
            row.value(&payload).is_some_and(|bytes| bytes > 0.0) && row.value(name).is_none()
        };
        let unknown_delays = rows.iter().filter(is_unknown).count() as u64;
        Self { series: MessageSeries::new(name, sizes), unknown_delays }
    }
}

impl Study {
    /// Returns a note on the number of messages behind each point.
    fn count_note(&self) -> Option<String> {
        let counts = || self.directions.iter().flat_map(|one| &one.series.sizes).map(|size| size.count);
        let [fewest, most] = [counts().min()?, counts().max()?].map(|count| fixed(count as f64, 0));
        let each = if fewest == most { most } else { format!("{fewest} to {most}") };
        Some(format!("messages of each size: {each}"))
    }

    /// Returns what both figures are drawn from.
    fn messages(&self) -> MessageFigures {
        MessageFigures {
            link_name: self.link_name.clone(),
            directions: self.directions.iter().map(|direction| direction.series.clone()).collect(),
            notes: self.missing.iter().chain(&self.notes).cloned().chain(self.count_note()).collect(),
        }
    }
}

/// Merges neighbouring sizes if there are more than [`MAX_SIZES`]. For example, the compressed images of a camera all have different sizes.
/// Returns the smallest payload of each size, and its messages.
fn merge_sizes(by_payload: BTreeMap<u64, Vec<Message>>) -> Vec<(u64, Vec<Message>)> {
    if by_payload.len() <= MAX_SIZES {
        return by_payload.into_iter().collect();
    }
    let with_payload =
        |(payload, messages): (u64, Vec<Message>)| messages.into_iter().map(move |one| (payload, one));
    let messages: Vec<(u64, Message)> = by_payload.into_iter().flat_map(with_payload).collect();
    let merged = messages.chunks(messages.len().div_ceil(MAX_SIZES));
    merged.map(|size| (size[0].0, size.iter().map(|(_, message)| *message).collect())).collect()
}
