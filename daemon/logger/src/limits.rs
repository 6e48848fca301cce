//! Limits on the size of trees and of lists in messages.
//!
//! A recorder never exceeds these limits: the recorder leaves out nodes that do not fit, and counts the omitted nodes.
//! A received tree that exceeds the limits is refused.

/// Maximum number of levels of a tree, including the root's.
// The level of a node is computed by a walk over the ancestors of the node. The limit bounds this walk for each node of
// a hostile tree.
pub const MAX_DEPTH: usize = 32;

/// Maximum number of nodes of a tree.
pub const MAX_NODES: usize = 4096;

/// Number of nodes that a recorder leaves free for values that are computed after the recording: sizes, throughputs,
/// totals.
pub const RESERVED_NODES: usize = 64;

/// Maximum number of hosts of a tree. Each host has one anchor.
pub const MAX_ANCHORS: usize = 8;

/// Maximum number of bytes (UTF-8) of a name, a kind, or a unit's symbol.
pub const MAX_NAME_BYTES: usize = 128;

/// Maximum number of bytes of the wire form of a tree or a tree delta.
pub const MAX_TREE_BYTES: usize = 1024 * 1024;
