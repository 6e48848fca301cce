//! Values of an iteration for statistics and `data.csv`, by the names of the iteration's nodes.

use crate::{Node, NodeId, Tree};

macro_rules! names_of_iteration {
    ($($position:ident = $name:literal;)*) => {
        /// Names that have one value in each iteration.
        const NAMES: &[&str] = &[$($name),*];

        enum Position { $($position),* }

        /// Returns the position of a name in [`NAMES`]; `None` for any other name.
        // The function is a `match` instead of a search, because it is called for each node that the aggregator stores.
        fn position(name: &str) -> Option<u8> {
            match name {
                $($name => Some(Position::$position as u8),)*
                _ => None,
            }
        }
    };
}

names_of_iteration! {
    Sensing = "sensing";
    Capture = "capture";
    Transform = "transform";
    Encode = "encode";
    SendQueue = "send-queue";
    Upload = "upload";
    Queue = "queue";
    BatchWait = "batch-wait";
    Ipc = "ipc";
    Preprocessing = "preprocessing";
    Inference = "inference";
    Postprocessing = "postprocessing";
    Download = "download";
    Actuation = "actuation";
    Total = "total";
    StagesTotal = "stages-total";
    Unattributed = "unattributed";
    Lateness = "lateness";
    SkippedStarts = "skipped-starts";
    Restart = "restart";
    UploadBytes = "upload-bytes";
    UploadLoggerBytes = "upload-logger-bytes";
    DownloadBytes = "download-bytes";
    DownloadLoggerBytes = "download-logger-bytes";
    UploadThroughput = "upload-throughput";
    DownloadThroughput = "download-throughput";
    Top1 = "top-1";
    Top5 = "top-5";
    UnknownLabel = "unknown-label";
}

/// Role of a node in the statistics of its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeRole {
    /// Node whose name has one value in each iteration, such as the name of a stage. The value of the node is added to
    /// the value of the name. The variant contains the position of the name in the list of such names.
    OfIteration(u8),
    /// Node with such a name at a place that does not count, for example a stage of a model inside another model.
    /// Statistics of the name omit this node.
    Nested,
    /// Node with a name that may have several values in an iteration. Each node is a separate value.
    Other,
}

/// The values of one iteration by name.
///
/// The names of stages, totals, sizes, throughputs, scores and the count of skipped starts have one value in each
/// iteration. This value is the sum of the nodes with the name that are directly below the root, or, for `capture` and
/// `transform`, directly below `sensing`. Nodes with these names at other places do not count. Nodes with all other
/// names are separate values.
#[derive(Clone, Debug, Default)]
pub struct IterationValues {
    /// First node and sum of each name, in the order of [`NAMES`]; `None` for a name without a value.
    sums: [Option<(NodeId, f64)>; NAMES.len()],
    /// The nodes `sensing` below the root.
    sensing: Vec<NodeId>,
}

impl IterationValues {
    /// Returns whether a name has one value in each iteration.
    pub fn has_one_value(name: &str) -> bool {
        position(name).is_some()
    }

    /// Adds a node with its value and returns the role of the node. Nodes must be added in the order of their tree,
    /// parents before children.
    pub fn add(&mut self, id: NodeId, parent: Option<NodeId>, name: &str, value: Option<f64>) -> NodeRole {
        let (Some(position), Some(parent)) = (position(name), parent) else { return NodeRole::Other };
        let is_part_of_sensing = position == Position::Capture as u8 || position == Position::Transform as u8;
        let is_counted =
            if is_part_of_sensing { self.sensing.contains(&parent) } else { parent == NodeId::ROOT };
        if !is_counted {
            return NodeRole::Nested;
        }
        if position == Position::Sensing as u8 {
            self.sensing.push(id);
        }
        if let Some(value) = value.filter(|value| !value.is_nan()) {
            let (_, sum) = self.sums[usize::from(position)].get_or_insert((id, 0.0));
            *sum += value;
        }
        NodeRole::OfIteration(position)
    }

    /// Returns the iteration's one value of a name. `None` if the iteration has no such value, or if the name does not
    /// have one value in each iteration.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.sums[usize::from(position(name)?)].map(|(_, sum)| sum)
    }

    /// Returns the value that statistics count for a node. All nodes of the tree must have been added.
    ///
    /// If the name has one value in each iteration, the first node of the name stands for the sum, and the result for
    /// all other nodes of the name is `None`. A node with any other name stands for its own value, `own_value`.
    pub fn counted(&self, id: NodeId, role: NodeRole, own_value: Option<f64>) -> Option<f64> {
        match role {
            NodeRole::OfIteration(position) => {
                let (first, sum) = self.sums[usize::from(position)]?;
                (first == id).then_some(sum)
            }
            NodeRole::Nested => None,
            NodeRole::Other => own_value,
        }
    }
}

/// The nodes of a tree that statistics of their names include.
#[derive(Clone, Debug)]
pub struct CountedNodes<'a> {
    tree: &'a Tree,
    values: IterationValues,
    /// Role of each node, in the order of the tree.
    roles: Vec<NodeRole>,
}

impl Tree {
    /// Returns the nodes that statistics of their names include.
    pub fn counted_nodes(&self) -> CountedNodes<'_> {
        let mut values = IterationValues::default();
        let add = |(id, node): (NodeId, &Node)| values.add(id, node.parent, &node.name, node.measure.value());
        let roles = self.iter().map(add).collect();
        CountedNodes { tree: self, values, roles }
    }
}

impl CountedNodes<'_> {
    /// Returns the iteration's one value of a name ([`IterationValues::get`]).
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values.get(name)
    }

    /// Returns whether the value of a node is part of the statistics of its name.
    pub fn is_counted(&self, id: NodeId) -> bool {
        self.roles.get(id.index()).is_some_and(|role| *role != NodeRole::Nested)
    }

    /// Returns whether the statistics of a node's name contain the node's own value: the node counts, and no value of
    /// another node is added to the node's value.
    pub fn is_counted_alone(&self, id: NodeId) -> bool {
        match self.roles.get(id.index()) {
            Some(role @ NodeRole::OfIteration(_)) => {
                self.roles.iter().filter(|other| *other == role).count() == 1
            }
            Some(NodeRole::Other) => true,
            Some(NodeRole::Nested) | None => false,
        }
    }

    /// Returns the nodes, each with the value that statistics count for the node ([`IterationValues::counted`]).
    pub fn iter(&self) -> impl Iterator<Item = (NodeId, &Node, Option<f64>)> {
        let nodes = self.tree.iter().zip(&self.roles).filter(|(_, role)| **role != NodeRole::Nested);
        nodes.map(|((id, node), role)| (id, node, self.values.counted(id, *role, node.measure.value())))
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{Span, WallTime};

    use super::*;
    use crate::{Anchor, HostId, Measure, Name, Unit, stage};

    /// Builds a tree from `(parent, name, value)`. The parent is a position in the tree: 0 is the
    /// root, 1 the first of `nodes`.
    fn tree(nodes: &[(u32, &str, f64)]) -> Tree {
        let anchor = Anchor { host: HostId::random(), wall: WallTime::from_unix_nanos(0) };
        let mut tree = Tree::new(stage::ITERATION, anchor);
        for (parent, name, value) in nodes {
            tree.add(NodeId(*parent), Name::from(*name), Span::ZERO, Measure::Value(*value, Unit::NONE));
        }
        tree
    }

    #[test]
    fn nodes_of_stage_are_summed_without_nested_nodes() {
        let tree = tree(&[
            (0, "sensing", 1.0),
            (1, "capture", 2.0),
            (0, "capture", 64.0),
            (0, "inference", 4.0),
            (4, "inner-model", 5.0),
            (5, "preprocessing", 6.0),
            (5, "inference", 7.0),
            (0, "sensing", 8.0),
            (8, "capture", 16.0),
            (0, "inference", f64::NAN),
            (0, "inference", 32.0),
            (1, "grasp", 1.0),
            (0, "grasp", 2.0),
        ]);
        let counted_nodes = tree.counted_nodes();
        let counted: Vec<(u32, &str, f64)> = counted_nodes
            .iter()
            .filter_map(|(NodeId(id), node, value)| Some((id, node.name.as_str(), value?)))
            .collect();
        let expected = [
            (1, "sensing", 9.0),
            (2, "capture", 18.0),
            (4, "inference", 36.0),
            (5, "inner-model", 5.0),
            (12, "grasp", 1.0),
            (13, "grasp", 2.0),
        ];
        assert_eq!(counted, expected);
        let counted_alone = (0..14).map(NodeId).filter(|id| counted_nodes.is_counted_alone(*id));
        assert_eq!(counted_alone.map(|id| id.0).collect::<Vec<_>>(), [0, 5, 12, 13]);
        let omitted = (0..14).map(NodeId).filter(|id| !counted_nodes.is_counted(*id));
        assert_eq!(omitted.map(|id| id.0).collect::<Vec<_>>(), [3, 6, 7]);
        let names = ["sensing", "capture", "inference", "preprocessing", "grasp"];
        assert_eq!(
            names.map(|name| counted_nodes.get(name)),
            [Some(9.0), Some(18.0), Some(36.0), None, None]
        );
    }

    #[test]
    fn every_stage_has_one_value_per_iteration() {
        let other_names = [
            stage::CAPTURE,
            stage::TRANSFORM,
            stage::TOTAL,
            stage::STAGES_TOTAL,
            stage::UNATTRIBUTED,
            stage::LATENESS,
            stage::SKIPPED_STARTS,
            stage::RESTART,
            stage::UPLOAD_BYTES,
            stage::UPLOAD_LOGGER_BYTES,
            stage::DOWNLOAD_BYTES,
            stage::DOWNLOAD_LOGGER_BYTES,
            stage::UPLOAD_THROUGHPUT,
            stage::DOWNLOAD_THROUGHPUT,
            stage::TOP_1,
            stage::TOP_5,
            stage::UNKNOWN_LABEL,
        ];
        let mut expected: Vec<Name> = stage::ORDER.into_iter().chain(other_names).collect();
        let mut names: Vec<Name> = NAMES.iter().copied().map(Name::from).collect();
        expected.sort();
        names.sort();
        assert_eq!(names, expected);
        for (index, name) in NAMES.iter().enumerate() {
            assert_eq!(position(name).map(usize::from), Some(index));
        }
        assert!(!IterationValues::has_one_value("gripper-force"));
    }
}
