//! Errors of trees.

use crate::limits::{MAX_ANCHORS, MAX_DEPTH, MAX_NODES};

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
    /// A node is further from the root than is allowed.
    #[error("node {0} lies deeper than the limit of {MAX_DEPTH} levels")]
    TooDeep(usize),
    /// The tree has more nodes than are allowed.
    #[error("the tree has {0} nodes, the limit is {MAX_NODES}")]
    TooManyNodes(usize),
    /// The tree spans more hosts than are allowed.
    #[error("the tree spans {0} hosts, the limit is {MAX_ANCHORS}")]
    TooManyHosts(usize),
    /// A measurement that would spoil every statistic it is added to.
    #[error("node {0} measures something that is not a number")]
    NotANumber(usize),
    /// An interval whose lower end lies above its upper end.
    #[error("node {0} has bounds that are crossed")]
    CrossedBounds(usize),
}
