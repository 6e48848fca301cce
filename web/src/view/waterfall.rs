//! The rows and sentences of an iteration's page.

mod bars;

use peernet_analysis::slowness::REST_OF_UNATTRIBUTED;
use peernet_analysis::unaccounted_time::{NETWORK_AND_REST, UnaccountedTime};
use peernet_figures::scale::Scale;
use peernet_logger::stage;
use peernet_statistics::number::{
    DurationFormat, EXACT, NONE, SPACE, ends_ms, is_exact, shift_ms, signed_within_ms, within_ms,
};
use peernet_store::IterationDetail;

pub(crate) use bars::rails;

use super::chip::Chip;
use super::clocks;
use super::link::basis::{brief_words, source_words};
use super::stack;
use crate::look;
use crate::picture::Picture;
use crate::timeline::{NodeLocation, PlacedNode, Timeline};

/// One node in the waterfall and in its table. Times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// Name of the host, in the first of consecutive rows of one host.
    pub group: Option<String>,
    /// In the first of consecutive rows of one host: how many rows these are. In all other rows: 1.
    pub span: usize,
    /// CSS class: `net` for the network, `cloud` for another host, `total` for the total, else empty.
    pub class: &'static str,
    pub name: String,
    /// CSS class of the node's colour.
    pub look: &'static str,
    pub depth: u8,
    pub host: String,
    pub value: String,
    pub bound: Option<String>,
    pub chip: Option<Chip>,
    /// Value minus the run's median.
    pub difference: String,
    /// `true` if the node is a cause of the iteration's duration.
    pub is_cause: bool,
    pub bar: Picture,
    pub start: String,
    /// Lower end of the interval that contains the true value.
    pub lo: String,
    /// Upper end of that interval.
    pub hi: String,
    /// Median of the run.
    pub median: String,
}

/// Computation of a one-way delay; times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DelayRow {
    pub name: String,
    /// Receiver's stamp minus sender's stamp.
    pub raw: String,
    /// Offset of the receiver's wall clock from the sender's: `raw` minus `value`.
    pub offset: String,
    pub value: String,
    pub lo: String,
    pub hi: String,
    pub source: &'static str,
    /// Assumptions behind the bounds; empty where they are not stored.
    pub basis: String,
    pub chip: Chip,
}

fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| NONE.to_owned())
}

/// Returns all rows: the nodes in order, the unattributed time, the total.
pub(crate) fn rows(
    detail: &IterationDetail,
    timeline: &Timeline,
    hosts: &[String],
    scale: &Scale,
) -> Vec<Row> {
    let format = timeline.duration_format();
    let is_cause = |name: &str| detail.row.causes.iter().any(|cause| cause.name == *name);
    let row = |node: &PlacedNode| {
        let is_cause = node.is_counted && is_cause(node.name.as_str());
        // Only the bar of a cause has a mark at the median.
        let has_median = is_cause;
        Row::of(node, hosts, is_cause, bars::row(node, timeline, scale, has_median), format)
    };
    let is_lateness = |node: &&PlacedNode| node.depth == 0 && node.name == *look::LATENESS;
    let mut rows: Vec<Row> = timeline.nodes.iter().filter(|node| !is_lateness(node)).map(row).collect();
    // Lateness is a part of the unattributed time, so its row is indented. Otherwise the column would seem to add up to
    // more than the total.
    let lateness = timeline.nodes.iter().find(is_lateness).map(|node| Row { depth: 1, ..row(node) });

    let medians = detail.medians();
    let edge = hosts.first().cloned().unwrap_or_default();
    if let Some(durations) = stack::durations(&detail.row) {
        let (total, unaccounted) = (durations.total, UnaccountedTime::of(&durations));
        if let Some((name, seconds)) = unaccounted.network {
            // As in bars and tables of stages, the sum is before `upload`, the first row of the network.
            let index = rows.iter().position(|row| row.class == "net").unwrap_or(rows.len());
            // The sum of network and unattributed time has no median.
            let median = medians.both_ways().filter(|_| name == look::NETWORK);
            let bar = bars::blank(scale);
            let mut row = Row::without_node(name, "network".to_owned(), (seconds, median), bar, format);
            row.is_cause = is_cause(name);
            rows.insert(index, row);
        }
        if let Some(rest) = unaccounted.unattributed {
            let median = medians.median(&stage::UNATTRIBUTED);
            let bar = bars::blank(scale);
            let mut row = Row::without_node("unattributed", edge.clone(), (rest, median), bar, format);
            // If starts are late, the cause has the second name.
            row.is_cause = is_cause("unattributed") || is_cause(REST_OF_UNATTRIBUTED);
            rows.push(row);
        }
        rows.extend(lateness);
        let mut total_row = Row::without_node(
            "total",
            edge,
            (total, medians.median(&stage::TOTAL)),
            bars::total(total, scale),
            format,
        );
        total_row.class = "total";
        rows.push(total_row);
    }
    name_hosts_once(&mut rows);
    rows
}

/// Names each host once, at the first of its rows.
fn name_hosts_once(rows: &mut [Row]) {
    let mut begin = 0;
    while begin < rows.len() {
        let same = |row: &Row| row.host == rows[begin].host && row.class == rows[begin].class;
        let span = rows[begin..].iter().take_while(|row| same(row)).count().max(1);
        let is_total = rows[begin].class == "total";
        // The total is the time of the whole iteration and not of one host, so its row names no host.
        rows[begin].group = Some(if is_total { String::new() } else { rows[begin].host.clone() });
        rows[begin].span = span;
        begin += span;
    }
}

impl Row {
    fn of(node: &PlacedNode, hosts: &[String], is_cause: bool, bar: Picture, format: DurationFormat) -> Self {
        let (host, class) = match node.location {
            NodeLocation::Network => ("network".to_owned(), "net"),
            NodeLocation::Host(0) => (hosts.first().cloned().unwrap_or_default(), ""),
            NodeLocation::Host(index) => (or_dash(hosts.get(usize::from(index)).cloned()), "cloud"),
        };
        let bounds = node.delay.and_then(|delay| delay.bounds);
        let difference =
            node.length.zip(node.median).map(|(length, median)| format.difference(length - median));
        Self {
            group: None,
            span: 1,
            class,
            name: node.name.to_string(),
            look: look::class(&node.name),
            depth: node.depth,
            host,
            value: or_dash(node.length.map(|length| format_duration(length, bounds, format))),
            bound: bounds.map(clocks::interval_text),
            chip: node.delay.map(|delay| Chip::verdict(delay.verdict)),
            difference: or_dash(difference),
            is_cause,
            bar,
            start: or_dash(node.start.map(|start| format.number(start))),
            lo: or_dash(bounds.map(|(lo, hi)| ends_ms(lo, hi)[0].clone())),
            hi: or_dash(bounds.map(|(lo, hi)| ends_ms(lo, hi)[1].clone())),
            median: or_dash(node.median.map(|median| format.duration(median))),
        }
    }

    /// Creates the row of a time that is not a node of the time line, such as the total. `seconds` is the time in the
    /// iteration, `median` the median in the run.
    fn without_node(
        name: &str,
        host: String,
        (seconds, median): (f64, Option<f64>),
        bar: Picture,
        format: DurationFormat,
    ) -> Self {
        Self {
            group: None,
            span: 1,
            class: if host == "network" { "net" } else { "" },
            name: name.to_owned(),
            look: look::class(name),
            depth: 0,
            host,
            value: format.duration(seconds),
            bound: (name == look::NETWORK || name == NETWORK_AND_REST).then(|| EXACT.to_owned()),
            chip: None,
            difference: or_dash(median.map(|median| format.difference(seconds - median))),
            is_cause: false,
            bar,
            start: NONE.to_owned(),
            lo: NONE.to_owned(),
            hi: NONE.to_owned(),
            median: or_dash(median.map(|median| format.duration(median))),
        }
    }
}

/// Formats a duration in ms with the digits that its bounds support. Without bounds, uses `format`, which is the
/// format of the column.
fn format_duration(seconds: f64, bounds: Option<(f64, f64)>, format: DurationFormat) -> String {
    bounds.map_or_else(|| format.number(seconds), |bounds| within_ms(seconds, bounds))
}

/// Returns the computation of each one-way delay.
pub(crate) fn delays(timeline: &Timeline, stored_delays: &[peernet_store::DelayRow]) -> Vec<DelayRow> {
    let format = timeline.duration_format();
    let nodes_with_delay = timeline.nodes.iter().filter_map(|node| Some((node, node.delay?)));
    let rows = nodes_with_delay.map(|(node, delay)| {
        let bounds = delay.bounds;
        // The ends of an exact delay are shown as exact, and not as two equal numbers.
        let interval_ends = bounds.filter(|(lo, hi)| !is_exact(hi - lo)).map(|(lo, hi)| ends_ms(lo, hi));
        let interval_end = |index: usize| {
            interval_ends.as_ref().map(|ends| ends[index].clone()).or(bounds.map(|_| EXACT.to_owned()))
        };
        DelayRow {
            name: node.name.to_string(),
            raw: format_duration(delay.raw, bounds, format),
            offset: or_dash(delay.value.map(|value| match bounds {
                Some(bounds) => signed_within_ms(delay.raw - value, bounds),
                None => format.difference(delay.raw - value),
            })),
            value: or_dash(delay.value.map(|value| format_duration(value, bounds, format))),
            lo: or_dash(interval_end(0)),
            hi: or_dash(interval_end(1)),
            source: source_words(delay.source),
            basis: stored_delays
                .iter()
                .find(|row| row.stage == node.name)
                .and_then(|row| row.assumptions.as_ref())
                .map_or_else(String::new, brief_words),
            chip: Chip::verdict(delay.verdict),
        }
    });
    rows.collect()
}

/// Describes the way of the sample to the other host and the way of the answer back in a sentence, for readers who do
/// not see the picture.
pub(crate) fn journey(timeline: &Timeline, edge: &str, cloud: &str) -> String {
    let Some(visit) = timeline.visit() else { return String::new() };
    let format = timeline.duration_format();
    let at = |seconds: f64| format!("{}{SPACE}ms", format.duration(seconds));
    let answer = visit.answer_times.map_or_else(
        || "no answer came back".to_owned(),
        |(_, received_at)| format!("the answer is back at {}", at(received_at)),
    );
    format!(
        "The sample leaves {edge} at {}, reaches {cloud} at {}, {answer}",
        at(visit.sent_at),
        at(visit.arrival)
    )
}

/// Describes the effect of the clocks' uncertainty on the picture in a sentence; `None` without such an uncertainty.
pub(crate) fn footnote(timeline: &Timeline, cloud: &str) -> Option<String> {
    let visit = timeline.visit()?;
    let (earlier, later) = visit.shift;
    if later - earlier <= 0.0 {
        return None;
    }
    let shift = shift_ms(earlier, later);
    let sum = visit.network.map_or_else(String::new, |network| {
        format!(", and so is upload + download = {}{SPACE}ms. Only the split of this sum between the two directions is uncertain", timeline.duration_format().duration(network))
    });
    Some(format!("The bars on {cloud} may shift together by {shift}{SPACE}ms; their lengths are exact{sum}."))
}

#[cfg(test)]
mod tests;
