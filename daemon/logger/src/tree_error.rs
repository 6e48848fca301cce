//! Errors of trees and tree deltas.

use crate::limits::{MAX_ANCHORS, MAX_DEPTH, MAX_NODES};

/// Reason why a tree or a tree delta is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TreeError {
    /// The root has a parent, another node has none, or the tree has no nodes. In the last case, the number is 0.
    #[error("node {0} is missing, is a root with a parent, or is no root and has no parent")]
    Orphan(usize),
    /// A node precedes its parent.
    #[error("node {0} precedes its parent")]
    Order(usize),
    /// A node refers to a host that has no anchor in the tree.
    #[error("node {0} refers to a host that the tree does not list")]
    UnknownHost(usize),
    /// The delta was made for another tree.
    #[error("the tree delta was made for a tree of {expected} nodes, but this tree has {actual} nodes")]
    BaseMismatch {
        /// Number of nodes of the tree that the delta was made for.
        expected: usize,
        /// Number of nodes of the tree that the delta was applied to.
        actual: usize,
    },
    /// The node that a receiver wants to close is not a transit, or the transit is already closed.
    #[error("node {0} is not an open transit")]
    NotInFlight(usize),
    /// A node is deeper than the limit.
    #[error("node {0} is deeper than the limit of {MAX_DEPTH} levels")]
    TooDeep(usize),
    /// The tree has more nodes than the limit.
    #[error("the tree has {0} nodes, the limit is {MAX_NODES}")]
    TooManyNodes(usize),
    /// The tree spans more hosts than the limit.
    #[error("the tree spans {0} hosts, the limit is {MAX_ANCHORS}")]
    TooManyHosts(usize),
    /// A value is NaN, which would invalidate every statistic that includes it.
    #[error("the value of node {0} is not a number")]
    NotANumber(usize),
    /// The lower end of an interval is above its upper end.
    #[error("the lower bound of node {0} is above its upper bound")]
    CrossedBounds(usize),
}
