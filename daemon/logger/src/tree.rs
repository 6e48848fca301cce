//! The tree of typed nodes that describes one iteration on all its hosts.
//!
//! Nodes are stored in one list, with parents before their children, so that adding a node is one push and sending the
//! tree is one pass. The start of a node is an offset on its host's monotonic clock from the host's [`Anchor`], the
//! moment at which the host joined the tree. Durations and order within a host therefore contain no wall-clock error.
//! The start of a node on the wall clock is the sum of anchor and offset.

use peernet_clock::{Span, WallTime};
use serde::{Deserialize, Serialize};

use crate::limits::{MAX_ANCHORS, MAX_DEPTH, MAX_NODES};
use crate::measure::Measure;
use crate::{HostId, Name, TreeError};

/// Position of a node in its tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct NodeId(pub u32);

impl NodeId {
    /// Position of the root node. Every tree has a root.
    pub const ROOT: Self = Self(0);

    /// Invalid position, which a recorder returns for a node that it left out. Operations on it have no effect.
    pub const SKIPPED: Self = Self(u32::MAX);

    /// Returns the position as an index.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// Position of a host among the tree's anchors. Position 0 is the host that created the tree, the edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct HostIndex(pub u8);

impl HostIndex {
    /// Position of the host that created the tree.
    pub const EDGE: Self = Self(0);
}

/// A host that has nodes in the tree, and the time at which the host joined the tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Anchor {
    /// Host that the anchor belongs to.
    pub host: HostId,
    /// Time of the host's wall clock when the host joined the tree. The starts of the host's nodes are counted from
    /// this moment.
    pub wall: WallTime,
}

/// One entry of the tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Parent of the node; `None` only for the root.
    pub parent: Option<NodeId>,
    /// Standard name ([`crate::stage`]) or a custom name.
    pub name: Name,
    /// Host on which the node was opened.
    pub host: HostIndex,
    /// Time at which the node was opened, on the monotonic clock of `host`, counted from the anchor of `host`.
    pub start: Span,
    /// Kind and value of the node.
    pub measure: Measure,
}

/// The nodes of one iteration.
///
/// The serialised form is the [wire form](crate::wire) as a byte string. In human-readable formats such as JSON it is
/// an object of `anchors` and `nodes`. Both forms are checked when they are read.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    pub(crate) anchors: Vec<Anchor>,
    pub(crate) nodes: Vec<Node>,
}

/// Additions of a host to a tree that the host received: the end of the transit with which the tree arrived, and the
/// nodes that the host appended.
///
/// A delta is serialised like a [`Tree`]: as its wire form, or as an object in human-readable formats.
// Only the delta is sent back, not the whole tree, so that a peer can add to the tree but not rewrite it.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeDelta {
    /// Number of nodes of the tree when it was received.
    pub base: u32,
    /// Anchor of the host that added the nodes.
    pub anchor: Anchor,
    /// Anchors of further hosts with nodes in the delta: hosts whose trees were inserted into the received tree.
    pub others: Vec<Anchor>,
    /// Transit that ended at the host of `anchor`, and the wall-clock time of this end.
    pub closed: (NodeId, WallTime),
    /// Appended nodes.
    pub nodes: Vec<Node>,
}

impl Tree {
    /// Creates a tree with one node: the root, which is a container.
    pub fn new(name: Name, anchor: Anchor) -> Self {
        // The capacity suffices for the nodes of a usual iteration, so that recording does not reallocate.
        let mut nodes = Vec::with_capacity(24);
        nodes.push(Node {
            parent: None,
            name,
            host: HostIndex::EDGE,
            start: Span::ZERO,
            measure: Measure::Container,
        });
        Self { anchors: vec![anchor], nodes }
    }

    /// Creates a tree of given anchors and nodes.
    ///
    /// # Errors
    /// If the nodes do not form a tree, exceed a limit, or refer to a host without anchor.
    pub fn from_parts(anchors: Vec<Anchor>, nodes: Vec<Node>) -> Result<Self, TreeError> {
        let tree = Self { anchors, nodes };
        tree.check(0)?;
        Ok(tree)
    }

    /// Returns the hosts in the order in which they joined.
    pub fn anchors(&self) -> &[Anchor] {
        &self.anchors
    }

    /// Returns all nodes in the order in which they were opened, with parents before their children.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Returns all nodes with their positions.
    pub fn iter(&self) -> impl Iterator<Item = (NodeId, &Node)> {
        self.nodes.iter().enumerate().map(|(index, node)| (NodeId(index as u32), node))
    }

    /// Returns the node at a position.
    pub fn get(&self, id: NodeId) -> Option<&Node> {
        self.nodes.get(id.index())
    }

    /// Returns the children of a node in the order in which they were opened.
    pub fn children(&self, parent: NodeId) -> impl Iterator<Item = (NodeId, &Node)> {
        // Parents precede their children, so the search starts after the node.
        self.iter().skip(parent.index() + 1).filter(move |(_, node)| node.parent == Some(parent))
    }

    /// Returns the node at a path of names below the root: `find(&["sensing", "capture"])`.
    pub fn find(&self, path: &[&str]) -> Option<(NodeId, &Node)> {
        let mut current = (NodeId::ROOT, self.nodes.first()?);
        for name in path {
            current = self.children(current.0).find(|(_, node)| node.name == **name)?;
        }
        Some(current)
    }

    /// Returns the wall-clock time of a node's start on its own host's clock, without correction.
    pub fn wall_start(&self, node: &Node) -> Option<WallTime> {
        self.anchors.get(usize::from(node.host.0)).map(|anchor| anchor.wall + node.start)
    }

    /// Appends a node and returns its position.
    #[inline]
    pub(crate) fn push(&mut self, node: Node) -> NodeId {
        let id = NodeId(self.nodes.len() as u32);
        self.nodes.push(node);
        id
    }

    /// Appends a node of the edge whose measure is computed after the recording. If `parent` does not exist, the node
    /// becomes a child of the root.
    pub fn add(&mut self, parent: NodeId, name: Name, start: Span, measure: Measure) -> NodeId {
        // `parent` is `NodeId::SKIPPED` if the recorder left the parent out.
        let parent = if parent.index() < self.nodes.len() { parent } else { NodeId::ROOT };
        let measure = measure.without_nan();
        self.push(Node { parent: Some(parent), name, host: HostIndex::EDGE, start, measure })
    }

    /// Returns the measure of a node for modification; `None` if there is no such node. The edge thus records corrected
    /// delays.
    pub fn measure_mut(&mut self, id: NodeId) -> Option<&mut Measure> {
        self.nodes.get_mut(id.index()).map(|node| &mut node.measure)
    }

    /// Adds the nodes of another host, and closes the transit that ended at that host.
    ///
    /// # Errors
    /// If the delta does not fit this tree. The tree is then unchanged.
    pub fn apply_delta(&mut self, delta: TreeDelta) -> Result<(), TreeError> {
        let base = self.nodes.len();
        // The delta refers to parents by their positions in the tree that was sent, so this tree must still have the
        // same length.
        if delta.base as usize != base {
            return Err(TreeError::BaseMismatch { expected: delta.base as usize, actual: base });
        }
        let (transit_id, received_at) = delta.closed;
        // A peer may close only the transit with which it received the tree. This transit must still be open.
        match self.nodes.get(transit_id.index()).map(|node| &node.measure) {
            Some(Measure::Transit(transit)) if transit.received.is_none() => {}
            _ => return Err(TreeError::NotInFlight(transit_id.index())),
        }
        let anchor_count = self.anchors.len();
        // The nodes are appended before the check, because parents and hosts are checked against the whole tree.
        self.nodes.extend(delta.nodes);
        self.anchors.push(delta.anchor);
        self.anchors.extend(delta.others);
        if let Err(error) = self.check(base) {
            self.nodes.truncate(base);
            self.anchors.truncate(anchor_count);
            return Err(error);
        }
        if let Some(Measure::Transit(transit)) = self.measure_mut(transit_id) {
            transit.received = Some(received_at);
        }
        Ok(())
    }

    /// Inserts a copy of another tree below a node. If the other tree does not fit, this tree is unchanged.
    pub(crate) fn insert_tree(&mut self, parent: NodeId, other: &Self) -> Result<NodeId, TreeError> {
        let (base, anchor_count) = (self.nodes.len(), self.anchors.len());
        let root = NodeId(base as u32);
        let hosts_and_shifts: Vec<(HostIndex, Span)> =
            other.anchors.iter().map(|anchor| self.find_or_add_anchor(anchor)).collect();
        self.nodes.extend(other.nodes.iter().cloned().map(|mut node| {
            if let Some((host, shift)) = hosts_and_shifts.get(usize::from(node.host.0)) {
                node.host = *host;
                node.start += *shift;
            }
            node.parent = Some(node.parent.map_or(parent, |own_parent| NodeId(own_parent.0 + root.0)));
            node
        }));
        self.check(base).inspect_err(|_| {
            self.nodes.truncate(base);
            self.anchors.truncate(anchor_count);
        })?;
        Ok(root)
    }

    /// Returns the position of the anchor that the host of `anchor` has in this tree. If the host has none, `anchor` is
    /// added. Also returns how much later `anchor` is than the anchor at that position.
    fn find_or_add_anchor(&mut self, anchor: &Anchor) -> (HostIndex, Span) {
        // A host has only one anchor in a tree. The host's wall clock tells how far apart the two anchors are.
        if let Some(index) = self.anchors.iter().position(|existing| existing.host == anchor.host) {
            return (HostIndex(index as u8), anchor.wall - self.anchors[index].wall);
        }
        self.anchors.push(anchor.clone());
        // The index fits into a `u8`, because two trees within the limits have at most 16 hosts together. If these are
        // too many for one tree, `check` refuses the result afterwards.
        (HostIndex((self.anchors.len() - 1) as u8), Span::ZERO)
    }

    /// Checks the nodes from position `from` on. The nodes before this position must have been checked.
    ///
    /// # Errors
    /// If the tree violates a rule. Receivers refuse the wire form of such a tree.
    pub fn check(&self, from: usize) -> Result<(), TreeError> {
        if self.nodes.is_empty() {
            return Err(TreeError::Orphan(0));
        }
        if self.nodes.len() > MAX_NODES {
            return Err(TreeError::TooManyNodes(self.nodes.len()));
        }
        if self.anchors.len() > MAX_ANCHORS {
            return Err(TreeError::TooManyHosts(self.anchors.len()));
        }
        for (index, node) in self.nodes.iter().enumerate().skip(from) {
            if node.parent.is_none() != (index == 0) {
                return Err(TreeError::Orphan(index));
            }
            // This order excludes cycles, and lets readers process a tree in one pass.
            if node.parent.is_some_and(|parent| parent.index() >= index) {
                return Err(TreeError::Order(index));
            }
            if usize::from(node.host.0) >= self.anchors.len() {
                return Err(TreeError::UnknownHost(index));
            }
            if self.level(NodeId(index as u32)).is_none() {
                return Err(TreeError::TooDeep(index));
            }
            node.measure.check(index)?;
        }
        Ok(())
    }

    /// Returns the level of a node, with the root on level 1; `None` if the node is deeper than [`MAX_DEPTH`].
    // The level is computed from the ancestors and not stored, because trees are shallow: even a hostile tree costs at
    // most 32 steps per node.
    pub(crate) fn level(&self, id: NodeId) -> Option<usize> {
        let mut parent = self.nodes.get(id.index())?.parent;
        let mut level = 1;
        while let Some(id) = parent {
            level += 1;
            if level > MAX_DEPTH {
                return None;
            }
            parent = self.nodes.get(id.index())?.parent;
        }
        Some(level)
    }
}
