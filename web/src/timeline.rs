//! The nodes of one iteration, placed on the time line of the edge's clock.
//!
//! Nodes of the edge are placed by the edge's monotonic clock. The nodes of another host are placed relative to the arrival of the request
//! there. The arrival follows from the one-way delay of the request, and has the uncertainty of that delay.

use peernet_clock::{DelaySource, Span, Verdict};
use peernet_logger::{CountedNodes, HostIndex, Measure, Name, Node, NodeId, Transit, Tree};
use peernet_statistics::number::DurationFormat;
use peernet_store::{IterationDetail, QuantityStatistics};

/// A node with a duration, placed on the edge's time line. Times are in seconds.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PlacedNode {
    pub name: Name,
    /// Number of nodes between this node and the root of the tree.
    pub depth: u8,
    pub location: NodeLocation,
    /// Start; `None` if it is unknown on the edge's clock.
    pub start: Option<f64>,
    /// Duration; `None` if the node was never closed, or if its delay is unknown.
    pub length: Option<f64>,
    pub delay: Option<Delay>,
    /// `true` if the statistics of the node's name include the node. Statistics omit a stage of a model inside another
    /// model.
    pub is_counted: bool,
    /// Median of the values of this name in the run. `None` if the median is unknown. Also `None` if the median is not
    /// comparable with this node, because the statistics omit the node or add other nodes of the iteration to it.
    pub median: Option<f64>,
}

/// Location at which a node was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NodeLocation {
    /// On the host of this index; 0 is the edge.
    Host(u8),
    /// Between two hosts.
    Network,
}

/// One-way delay; times in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Delay {
    /// Receiver's stamp minus sender's stamp, by their wall clocks.
    pub raw: f64,
    /// The computed delay; `None` if it is unknown.
    pub value: Option<f64>,
    /// Ends of the interval that contains the true delay; `None` if they are unknown.
    pub bounds: Option<(f64, f64)>,
    pub source: DelaySource,
    pub verdict: Verdict,
}

/// Stay of the iteration on another host, from the request to the answer. Times are in seconds on the edge's time line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Visit {
    /// Time at which the edge sent the request.
    pub sent_at: f64,
    /// Estimated arrival time of the request; the middle of the possible interval if there is no estimate.
    pub arrival: f64,
    /// Times at which the other host sent the answer and at which the edge received it.
    pub answer_times: Option<(f64, f64)>,
    /// Uncertainty of `arrival`: the maximum shift to an earlier time (negative) and to a later time. All times of the visit share this
    /// uncertainty.
    pub shift: (f64, f64),
    /// Sum of upload and download, which does not depend on the clock relation; `None` if the sum is unknown.
    pub network: Option<f64>,
}

/// All nodes of an iteration on one time line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Timeline {
    pub nodes: Vec<PlacedNode>,
    /// One entry per host other than the edge.
    pub visits: Vec<Option<Visit>>,
    /// End of the last node.
    pub end: f64,
}

/// Statistics of a run by name, and the nodes of one of its iterations that they include.
pub(crate) struct NodeStatistics<'a> {
    pub counted_nodes: CountedNodes<'a>,
    pub of_run: &'a [(Name, QuantityStatistics)],
}

impl<'a> NodeStatistics<'a> {
    pub(crate) fn of(detail: &'a IterationDetail) -> Self {
        Self { counted_nodes: detail.tree.counted_nodes(), of_run: &detail.run_figures }
    }

    /// Returns the median that a node's value is comparable with; `None` if the statistics of the name omit the node,
    /// or if they add the values of other nodes of the iteration to its value.
    pub(crate) fn median(&self, id: NodeId, name: &Name) -> Option<f64> {
        let (_, statistics) = self.of_run.iter().find(|(other_name, _)| other_name == name)?;
        self.counted_nodes.is_counted_alone(id).then_some(statistics.p50)
    }
}

/// Returns the transit nodes of a tree, in the order of the tree.
fn transits(tree: &Tree) -> impl Iterator<Item = (&Node, &Transit)> {
    tree.nodes().iter().filter_map(|node| match &node.measure {
        Measure::Transit(transit) => Some((node, &**transit)),
        _ => None,
    })
}

/// Returns the visit of an iteration to the host of anchor `index`. `both_ways` is the sum of upload and download if only the sum is known.
fn visit(tree: &Tree, index: usize, both_ways: Option<f64>) -> Option<Visit> {
    let edge = tree.anchors().first()?;
    let anchor = tree.anchors().get(index)?;
    // The anchor of the other host is the arrival time of the request there.
    let (upload, request) = transits(tree)
        .find(|(node, transit)| node.host == HostIndex::EDGE && transit.received == Some(anchor.wall))?;
    let sent_at = upload.start.seconds();
    let download = transits(tree)
        .find(|(node, transit)| usize::from(node.host.0) == index && transit.received.is_some());
    // The free-running clock of the edge is preferred, because nothing steps it. If the tree has no stamps of that
    // clock, the wall clock is used.
    let answer = download.and_then(|(node, transit)| {
        let stamps = request.raw_stamps.zip(transit.raw_stamps);
        let by_raw_clock =
            stamps.map(|(request, answer)| sent_at + (answer.received - request.sent).seconds());
        let by_wall_clock = transit.received? - edge.wall;
        Some((node.start, by_raw_clock.unwrap_or_else(|| by_wall_clock.seconds())))
    });
    let delay_value = |transit: &Transit| Some(transit.delay.as_ref()?.value?.seconds());
    let both_delays = download.and_then(|(_, back)| Some(delay_value(request)? + delay_value(back)?));
    // The measured sum and the sum of the delays are valid even if a wall clock was stepped during the iteration. The
    // difference of the stamps may be that of wall clocks, so it is used only if both sums are unknown.
    let network = answer.and_then(|(start, received_at)| {
        let by_stamps = received_at - sent_at - start.seconds();
        both_ways.or(both_delays).or_else(|| Some(by_stamps).filter(|sum| *sum >= 0.0))
    });

    let delay = request.delay.as_ref();
    let (arrival, shift) = match (delay.and_then(|delay| delay.value), delay.and_then(|delay| delay.bounds)) {
        (Some(value), Some(bounds)) => {
            (sent_at + value.seconds(), ((bounds.lo - value).seconds(), (bounds.hi - value).seconds()))
        }
        (Some(value), None) => (sent_at + value.seconds(), (0.0, 0.0)),
        // The upload took at least no time, and at most the time of both directions. The middle of this range is shown.
        (None, _) => {
            let half = network?.max(0.0) / 2.0;
            (sent_at + half, (-half, half))
        }
    };
    let answer_times = answer.map(|(start, received_at)| {
        // The download starts when the answer is sent. Its start is relative to the arrival of the request.
        let stay = start.seconds();
        // A step of the edge's wall clock may make `received_at` wrong, but not `both_ways`.
        (arrival + stay, both_ways.map_or(received_at, |network| sent_at + stay + network))
    });
    Some(Visit { sent_at, arrival, answer_times, shift, network })
}

impl Timeline {
    /// Places all nodes of an iteration on the edge's time line.
    pub(crate) fn of(detail: &IterationDetail) -> Self {
        let tree = &detail.tree;
        let visits: Vec<Option<Visit>> =
            (1..tree.anchors().len()).map(|index| visit(tree, index, detail.row.both_ways)).collect();
        let mut timeline = Self { nodes: Vec::new(), visits, end: detail.row.total.unwrap_or(0.0) };
        timeline.add_children(tree, NodeId::ROOT, 0, &NodeStatistics::of(detail));
        timeline.sort();
        let ends = timeline.nodes.iter().filter_map(|node| Some(node.start? + node.length?));
        timeline.end = ends.fold(timeline.end, f64::max);
        timeline
    }

    /// Sorts the children of the root by start. Their descendants stay behind them, and a child without a start stays
    /// behind the child before it.
    fn sort(&mut self) {
        // Start of the child of the root that the node belongs to.
        let mut group_start = f64::NEG_INFINITY;
        let mut keyed: Vec<(f64, PlacedNode)> = Vec::with_capacity(self.nodes.len());
        for node in self.nodes.drain(..) {
            if node.depth == 0 {
                group_start = node.start.unwrap_or(group_start);
            }
            keyed.push((group_start, node));
        }
        keyed.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        self.nodes = keyed.into_iter().map(|(_, node)| node).collect();
    }

    fn add_children(&mut self, tree: &Tree, parent: NodeId, depth: u8, statistics: &NodeStatistics<'_>) {
        for (id, node) in tree.children(parent) {
            let is_sum = matches!(node.name.as_str(), "total" | "stages-total" | "unattributed");
            if depth == 0 && is_sum {
                continue;
            }
            if let Some(placed) = self.position_node((id, node), depth, statistics) {
                self.nodes.push(placed);
            }
            // The depth is limited, because an agent with bad intent may send a deep tree. The API also returns the
            // deeper nodes.
            if depth < 6 {
                self.add_children(tree, id, depth + 1, statistics);
            }
        }
    }

    /// Returns the position on the edge's time line to which the starts of a host's nodes are relative; `None` if the
    /// position is unknown.
    fn origin(&self, host: HostIndex) -> Option<f64> {
        match usize::from(host.0).checked_sub(1) {
            None => Some(0.0),
            Some(index) => self.visits.get(index).copied().flatten().map(|visit| visit.arrival),
        }
    }

    /// Returns a node with its position on the edge's time line; `None` if the page does not show nodes of this kind.
    fn position_node(
        &self,
        (id, node): (NodeId, &Node),
        depth: u8,
        statistics: &NodeStatistics<'_>,
    ) -> Option<PlacedNode> {
        let origin = self.origin(node.host);
        let start = origin.map(|origin| origin + node.start.seconds());
        let placed = PlacedNode {
            name: node.name.clone(),
            depth,
            location: NodeLocation::Host(node.host.0),
            start,
            length: None,
            delay: None,
            is_counted: statistics.counted_nodes.is_counted(id),
            median: statistics.median(id, &node.name),
        };
        match &node.measure {
            Measure::Timer(length) => Some(PlacedNode { length: length.map(Span::seconds), ..placed }),
            // A container has no duration. Only a container below the root is shown: as the heading of its children.
            Measure::Container => Some(placed).filter(|_| depth == 0),
            Measure::Transit(transit) => {
                let delay = transit.delay.map(|delay| Delay {
                    raw: delay.raw.seconds(),
                    value: delay.value.map(Span::seconds),
                    bounds: delay.bounds.map(|bounds| (bounds.lo.seconds(), bounds.hi.seconds())),
                    source: delay.source,
                    verdict: delay.verdict,
                });
                let length = delay.and_then(|delay| delay.value);
                Some(PlacedNode { location: NodeLocation::Network, length, delay, ..placed })
            }
            _ => None,
        }
    }

    /// Returns the format of the nodes' durations in tables.
    pub(crate) fn duration_format(&self) -> DurationFormat {
        let (total, std) = (Some(self.end), None);
        DurationFormat::for_total(total, std)
    }

    /// Returns the visit to the other host; `None` unless there is exactly one other host and its visit is known.
    pub(crate) fn visit(&self) -> Option<&Visit> {
        match self.visits.as_slice() {
            [Some(visit)] => Some(visit),
            _ => None,
        }
    }
}

#[cfg(test)]
#[path = "timeline_tests.rs"]
mod tests;
