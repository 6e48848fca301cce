//! The tree of typed nodes that describes one iteration, across hosts.
//!
//! Stored flat, parents before children, so that growing it costs one push and sending it one pass. Starts
//! are offsets on the host's monotonic clock from that host's [`Anchor`], the moment at which the host joined
//! the tree: durations and order within a host carry no wall-clock error, and a wall time is one addition.

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
    /// The root, present in every tree.
    pub const ROOT: Self = Self(0);

    /// No position: what a recorder returns for a node that it had to leave out. Doing something to it does
    /// nothing.
    pub const NOWHERE: Self = Self(u32::MAX);

    /// The position as an index.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// Position of a host among the tree's anchors; 0 is the host that began the tree, the edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct HostIndex(pub u8);

impl HostIndex {
    /// The host that began the tree.
    pub const EDGE: Self = Self(0);
}

/// A host that has nodes in the tree, and when it joined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Anchor {
    /// Whose clock.
    pub host: HostId,
    /// What the host's wall clock showed at the anchor, the zero of its nodes' starts.
    pub wall: WallTime,
}

/// One entry of the tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// What it belongs to; only the root belongs to nothing.
    pub parent: Option<NodeId>,
    /// Standard name ([`crate::stage`]) or one of the user's own.
    pub name: Name,
    /// The host on which it was opened.
    pub host: HostIndex,
    /// When it was opened, on that host's monotonic clock, from that host's anchor.
    pub start: Span,
    /// Its kind and what was measured.
    pub measure: Measure,
}

/// The nodes of one iteration.
///
/// Serialised, it is its [wire form](crate::wire) as a byte string; in formats for people, such as JSON, it is an
/// object of `anchors` and `nodes`. Whichever way it is read, it is checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    pub(crate) anchors: Vec<Anchor>,
    pub(crate) nodes: Vec<Node>,
}

/// What another host added to a tree that was sent to it: the transit it closed and the nodes it appended.
///
/// Sent back instead of the whole tree, so that a peer can add to what it was shown but never rewrite it.
/// Serialised like a [`Tree`].
#[derive(Clone, Debug, PartialEq)]
pub struct Growth {
    /// Nodes of the tree when it was received.
    pub base: u32,
    /// The host that grew it.
    pub anchor: Anchor,
    /// Further hosts that have nodes in it: those whose trees were inserted.
    pub others: Vec<Anchor>,
    /// The transit that ended at this host and the wall-clock stamp of its end.
    pub closed: (NodeId, WallTime),
    /// The appended nodes.
    pub nodes: Vec<Node>,
}

impl Tree {
    /// A tree of a root container alone.
    pub fn new(name: Name, anchor: Anchor) -> Self {
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

    /// A tree of given anchors and nodes, checked.
    ///
    /// # Errors
    /// When the nodes do not form a tree or name hosts that are not there.
    pub fn from_parts(anchors: Vec<Anchor>, nodes: Vec<Node>) -> Result<Self, TreeError> {
        let tree = Self { anchors, nodes };
        tree.check(0)?;
        Ok(tree)
    }

    /// The hosts, in the order in which they joined.
    pub fn anchors(&self) -> &[Anchor] {
        &self.anchors
    }

    /// All nodes, parents before children, in the order in which they were opened.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// All nodes with their positions.
    pub fn iter(&self) -> impl Iterator<Item = (NodeId, &Node)> {
        self.nodes.iter().enumerate().map(|(index, node)| (NodeId(index as u32), node))
    }

    /// The node at a position.
    pub fn get(&self, id: NodeId) -> Option<&Node> {
        self.nodes.get(id.index())
    }

    /// The children of a node, in order.
    pub fn children(&self, of: NodeId) -> impl Iterator<Item = (NodeId, &Node)> {
        self.iter().skip(of.index() + 1).filter(move |(_, node)| node.parent == Some(of))
    }

    /// The node at a path of names below the root: `find(&["sensing", "capture"])`.
    pub fn find(&self, path: &[&str]) -> Option<(NodeId, &Node)> {
        let mut at = (NodeId::ROOT, self.nodes.first()?);
        for name in path {
            at = self.children(at.0).find(|(_, node)| node.name == **name)?;
        }
        Some(at)
    }

    /// Wall-clock time of a node's start on its own host's clock, uncorrected.
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

    /// Appends a finished node of the edge under a parent: what is computed after the fact. A parent that is
    /// not there stands for the root.
    pub fn add(&mut self, parent: NodeId, name: Name, start: Span, measure: Measure) -> NodeId {
        let parent = if parent.index() < self.nodes.len() { parent } else { NodeId::ROOT };
        let measure = measure.without_nan();
        self.push(Node { parent: Some(parent), name, host: HostIndex::EDGE, start, measure })
    }

    /// Changes what was measured at a node: how the edge records a correction.
    pub fn measure_mut(&mut self, id: NodeId) -> Option<&mut Measure> {
        self.nodes.get_mut(id.index()).map(|node| &mut node.measure)
    }

    /// Takes over what another host added: closes the transit that ended there and appends its nodes.
    ///
    /// # Errors
    /// When the growth does not fit this tree; the tree is then unchanged.
    pub fn absorb(&mut self, growth: Growth) -> Result<(), TreeError> {
        let base = self.nodes.len();
        if growth.base as usize != base {
            return Err(TreeError::OtherTree { expected: growth.base as usize, actual: base });
        }
        let (closed, at) = growth.closed;
        match self.nodes.get(closed.index()).map(|node| &node.measure) {
            Some(Measure::Transit(transit)) if transit.received.is_none() => {}
            _ => return Err(TreeError::NotUnderWay(closed.index())),
        }
        let hosts = self.anchors.len();
        self.nodes.extend(growth.nodes);
        self.anchors.push(growth.anchor);
        self.anchors.extend(growth.others);
        if let Err(error) = self.check(base) {
            self.nodes.truncate(base);
            self.anchors.truncate(hosts);
            return Err(error);
        }
        if let Some(Measure::Transit(transit)) = self.measure_mut(closed) {
            transit.received = Some(at);
        }
        Ok(())
    }

    /// Puts a copy of another tree below a node. When it does not fit, this tree is unchanged.
    pub(crate) fn graft(&mut self, below: NodeId, other: &Self) -> Result<NodeId, TreeError> {
        let (base, hosts) = (self.nodes.len(), self.anchors.len());
        let root = NodeId(base as u32);
        let places: Vec<(HostIndex, Span)> = other.anchors.iter().map(|anchor| self.join(anchor)).collect();
        self.nodes.extend(other.nodes.iter().cloned().map(|mut node| {
            if let Some((host, shift)) = places.get(usize::from(node.host.0)) {
                node.host = *host;
                node.start += *shift;
            }
            node.parent = Some(node.parent.map_or(below, |parent| NodeId(parent.0 + root.0)));
            node
        }));
        self.check(base).inspect_err(|_| {
            self.nodes.truncate(base);
            self.anchors.truncate(hosts);
        })?;
        Ok(root)
    }

    /// The place of a host among the anchors, made if it has none, and how much later its own anchor is.
    fn join(&mut self, anchor: &Anchor) -> (HostIndex, Span) {
        if let Some(place) = self.anchors.iter().position(|known| known.host == anchor.host) {
            return (HostIndex(place as u8), anchor.wall - self.anchors[place].wall);
        }
        self.anchors.push(anchor.clone());
        (HostIndex((self.anchors.len() - 1) as u8), Span::ZERO)
    }

    /// Checks the nodes from position `from` on, the others being known to be good.
    ///
    /// # Errors
    /// The first that is wrong: the wire form of such a tree is refused.
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

    /// How many levels down a node lies, the root on level 1; `None` below [`MAX_DEPTH`].
    ///
    /// Climbs instead of remembering: trees are shallow, and a hostile one costs 32 steps a node.
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
