//! Sizes, throughputs and other quantities of one iteration.

use peernet_analysis::summary::Scale;
use peernet_analysis::transfer::{DirectionNodes, is_speed_interval_only};
use peernet_logger::{Measure, Name, Node, NodeId};
use peernet_statistics::number::{NONE, SPACE, bytes, throughput, throughput_between, times};
use peernet_store::{IterationDetail, QuantityStatistics};

use super::speed;
use crate::timeline::NodeStatistics;

/// Sizes and throughput of one direction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ByteRow {
    pub name: &'static str,
    pub payload: String,
    pub metadata: String,
    pub throughput: String,
    /// Reason why the throughput is an interval or missing; empty for a single value.
    pub throughput_note: &'static str,
    /// Throughput as a multiple of the run's median throughput.
    pub multiple_of_median: String,
}

/// A measurement that is neither a stage nor a size.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct OtherMeasurement {
    pub path: String,
    pub kind: String,
    pub value: String,
    pub unit: String,
    /// Median of the same measurement in the run.
    pub median: String,
}

/// Returns the size or throughput with this name. An iteration may have several nodes of one name. The value is the one
/// that the statistics of the run include.
fn counted_value(detail: &IterationDetail, name: &str) -> Option<f64> {
    detail.tree.counted_nodes().get(name)
}

/// Returns the statistics of the nodes with this name.
fn statistics_of_name<'a>(
    run_statistics: &'a [(Name, QuantityStatistics)],
    name: &str,
) -> Option<&'a QuantityStatistics> {
    run_statistics.iter().find(|(node, _)| node == name).map(|(_, statistics)| statistics)
}

impl ByteRow {
    /// Returns a row for each direction in which a payload was sent.
    pub(crate) fn of_directions(detail: &IterationDetail) -> Vec<Self> {
        let directions = DirectionNodes::both().into_iter();
        let measured_directions = directions.filter(|nodes| counted_value(detail, &nodes.payload).is_some());
        let byte_rows = measured_directions.map(|nodes| {
            let size = |name: &str| {
                counted_value(detail, name).map_or_else(|| NONE.to_owned(), |size| bytes(size).to_string())
            };
            let (throughput, throughput_note) = throughput_text(detail, nodes);
            let run_median = statistics_of_name(&detail.run_figures, &nodes.throughput)
                .map(|statistics| statistics.p50)
                .filter(|median| *median > 0.0);
            // The ratio of an interval to the median would look exact, so an interval has no ratio.
            let value = counted_value(detail, &nodes.throughput);
            let ratio = value.zip(run_median).filter(|_| throughput_note.is_empty());
            let ratio = ratio.map(|(value, median)| times(value / median));
            Self {
                name: nodes.delay.as_str(),
                payload: size(&nodes.payload),
                metadata: size(&nodes.metadata),
                throughput,
                throughput_note,
                multiple_of_median: ratio.unwrap_or_else(|| NONE.to_owned()),
            }
        });
        byte_rows.collect()
    }
}

/// Returns the throughput in words. Also returns the reason if the throughput is missing or is an interval. If the
/// verdict on the delay is `limited`, only the interval is returned, because a single value would look more certain
/// than it is.
fn throughput_text(detail: &IterationDetail, nodes: &DirectionNodes) -> (String, &'static str) {
    let counted_nodes = detail.tree.counted_nodes();
    let measure = |name: &str| {
        counted_nodes.iter().find(|(_, node, _)| node.name == *name).map(|(_, node, _)| &node.measure)
    };
    let Some(Measure::Throughput(rate)) = measure(&nodes.throughput) else {
        return (NONE.to_owned(), "no throughput was computed");
    };
    let verdict = match measure(&nodes.delay) {
        Some(Measure::Transit(transit)) => transit.delay.map(|delay| delay.verdict),
        _ => None,
    };
    let note = speed::clock_obstacle(verdict).unwrap_or_default();
    // `is_speed_interval_only` returns `Some(true)` for the verdict `limited`, and `None` if the verdict permits no
    // throughput.
    match (rate.value, rate.bounds, is_speed_interval_only(verdict)) {
        (Some(_), Some((lo, hi)), Some(true)) => (throughput_between((lo, Some(hi))), note),
        (Some(value), _, Some(_)) => (throughput(value), ""),
        (Some(_), _, None) => (NONE.to_owned(), note),
        (None, ..) => (NONE.to_owned(), "the delay of this direction is not known"),
    }
}

impl OtherMeasurement {
    /// Returns the measurements that no other table of the page shows.
    pub(crate) fn all(detail: &IterationDetail) -> Vec<Self> {
        let shown_elsewhere = |node: &Node| {
            let is_size_or_speed = DirectionNodes::both()
                .iter()
                .any(|nodes| [&nodes.payload, &nodes.metadata, &nodes.throughput].contains(&&node.name));
            is_size_or_speed || matches!(node.name.as_str(), "total" | "stages-total" | "unattributed")
        };
        // The first node is the root, which is the iteration itself.
        let nodes = detail.tree.iter().skip(1).filter(|(_, node)| {
            !shown_elsewhere(node)
                && matches!(node.measure, Measure::Value(..) | Measure::Custom(..) | Measure::TokenRate(_))
        });
        let statistics = NodeStatistics::of(detail);
        let rows = nodes.map(|(id, node)| {
            let logged_unit = node.measure.unit();
            let scale = Scale::for_unit(logged_unit.symbol());
            let text =
                |value: Option<f64>| value.map_or_else(|| NONE.to_owned(), |value| scale.format(value));
            Self {
                path: path(detail, id),
                kind: node.measure.kind().to_string(),
                value: text(node.measure.value()),
                unit: scale.symbol(logged_unit.symbol()).to_owned(),
                median: text(statistics.median(id, &node.name)),
            }
        });
        rows.collect()
    }
}

/// Returns the names of a node's ancestors below the root and its own name, such as `inference / tokens`.
fn path(detail: &IterationDetail, node_id: NodeId) -> String {
    let mut names = Vec::new();
    let mut current = Some(node_id);
    while let Some(node) = current.and_then(|id| detail.tree.get(id)) {
        if node.parent.is_some() {
            names.push(node.name.to_string());
        }
        current = node.parent;
    }
    names.reverse();
    names.join(&format!("{SPACE}/ "))
}
