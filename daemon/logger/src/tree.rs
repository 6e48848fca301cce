//! The tree of typed nodes that describes one iteration, across hosts.
//!
//! Stored flat, parents before children, so that growing it costs one push and sending it one pass. Starts
//! are offsets on the host's monotonic clock from that host's [`Anchor`], the moment at which the host joined
//! the tree: durations and order within a host carry no wall-clock error, and a wall time is one addition.

use peernet_clock::{OneWayDelay, Span, WallTime};
use serde::{Deserialize, Serialize};

use crate::{HostId, Name, Unit};

/// Position of a node in its tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct NodeId(pub u32);

impl NodeId {
    /// The root, present in every tree.
    pub const ROOT: Self = Self(0);

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

/// Kind and content of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// Holds other nodes.
    Container,
    /// A duration on one host; `None` while it is open.
    Timer(Option<Span>),
    /// A message's way from one host to another.
    Transit(Box<Transit>),
    /// A number with a unit.
    Value(f64, Unit),
    /// Bits per second.
    Throughput(Rate),
    /// Tokens per second of a language model; `None` while it is open.
    TokenRate(Option<f64>),
    /// A kind that the user declared by name and unit; `None` while it is open.
    Custom(Name, Unit, Option<f64>),
}

/// A rate with the interval that follows from its delay's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    /// The estimate; `None` when the delay has none.
    pub value: Option<f64>,
    /// Lower and upper bound; the upper one is infinite when the delay's interval reaches zero.
    pub bounds: Option<(f64, f64)>,
}

/// A message between two hosts: opened by the sender, closed by the receiver, judged by the edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transit {
    /// The sender's wall clock just before the message was handed to the network.
    pub sent: WallTime,
    /// The receiver's wall clock when the whole message was there; `None` while it is under way.
    pub received: Option<WallTime>,
    /// The delay, once the edge has related the two clocks.
    pub delay: Option<OneWayDelay>,
}

/// What is wrong with a tree or a growth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TreeError {
    /// There must be a root, and only the root has no parent.
    #[error("node {0} has no parent, or the root has one")]
    Orphan(usize),
    /// A parent must stand before its children.
    #[error("node {0} stands before its parent")]
    Order(usize),
    /// A node names a host that has no anchor.
    #[error("node {0} names a host without an anchor")]
    UnknownHost(usize),
    /// A growth was made for another tree.
    #[error("the growth continues a tree of {expected} nodes, this one has {actual}")]
    OtherTree {
        /// Nodes the growth was cut from.
        expected: usize,
        /// Nodes of the tree it was applied to.
        actual: usize,
    },
    /// A growth closes a node that is not an open transit.
    #[error("node {0} is not a transit under way")]
    NotUnderWay(usize),
}

/// The nodes of one iteration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tree {
    pub(crate) anchors: Vec<Anchor>,
    pub(crate) nodes: Vec<Node>,
}

/// What another host added to a tree that was sent to it: the transit it closed and the nodes it appended.
///
/// Sent back instead of the whole tree, so that a peer can add to what it was shown but never rewrite it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// Nodes of the tree when it was received.
    pub base: u32,
    /// The host that grew it.
    pub anchor: Anchor,
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
    pub(crate) fn push(&mut self, node: Node) -> NodeId {
        let id = NodeId(self.nodes.len() as u32);
        self.nodes.push(node);
        id
    }

    /// Appends a finished node of the edge under a parent: what is computed after the fact.
    pub fn add(&mut self, parent: NodeId, name: Name, start: Span, measure: Measure) -> NodeId {
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
        self.nodes.extend(growth.nodes);
        self.anchors.push(growth.anchor);
        if let Err(error) = self.check(base) {
            self.nodes.truncate(base);
            self.anchors.pop();
            return Err(error);
        }
        if let Some(Measure::Transit(transit)) = self.measure_mut(closed) {
            transit.received = Some(at);
        }
        Ok(())
    }

    /// Checks the nodes from position `from` on.
    pub(crate) fn check(&self, from: usize) -> Result<(), TreeError> {
        if self.nodes.is_empty() {
            return Err(TreeError::Orphan(0));
        }
        for (index, node) in self.nodes.iter().enumerate().skip(from) {
            match node.parent {
                None if index == 0 => {}
                Some(_) if index == 0 => return Err(TreeError::Orphan(index)),
                None => return Err(TreeError::Orphan(index)),
                Some(parent) if parent.index() >= index => return Err(TreeError::Order(index)),
                Some(_) => {}
            }
            if usize::from(node.host.0) >= self.anchors.len() {
                return Err(TreeError::UnknownHost(index));
            }
        }
        Ok(())
    }
}

impl Measure {
    /// Whether the node still waits for its end.
    pub fn is_open(&self) -> bool {
        match self {
            Self::Timer(None) | Self::TokenRate(None) | Self::Custom(_, _, None) => true,
            Self::Transit(transit) => transit.received.is_none(),
            _ => false,
        }
    }

    /// The number to store and to compute statistics over, in the unit of [`unit`](Self::unit).
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Container => None,
            Self::Timer(span) => span.map(Span::seconds),
            Self::Transit(transit) => transit.delay.and_then(|delay| delay.value).map(Span::seconds),
            Self::Value(value, _) => Some(*value),
            Self::Throughput(rate) => rate.value,
            Self::TokenRate(rate) => *rate,
            Self::Custom(_, _, value) => *value,
        }
    }

    /// The unit of [`value`](Self::value).
    pub fn unit(&self) -> Unit {
        match self {
            Self::Container => Unit::NONE,
            Self::Timer(_) | Self::Transit(_) => Unit::SECONDS,
            Self::Throughput(_) => Unit::BITS_PER_SECOND,
            Self::TokenRate(_) => Unit::TOKENS_PER_SECOND,
            Self::Value(_, unit) | Self::Custom(_, unit, _) => unit.clone(),
        }
    }

    /// The name of the kind: `container`, `timer`, `transit`, `value`, `throughput`, `token-rate`, or the
    /// user's own.
    pub fn kind(&self) -> Name {
        match self {
            Self::Container => Name::from_static("container"),
            Self::Timer(_) => Name::from_static("timer"),
            Self::Transit(_) => Name::from_static("transit"),
            Self::Value(..) => Name::from_static("value"),
            Self::Throughput(_) => Name::from_static("throughput"),
            Self::TokenRate(_) => Name::from_static("token-rate"),
            Self::Custom(kind, ..) => kind.clone(),
        }
    }
}
