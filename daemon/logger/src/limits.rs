//! Limits on the size of trees and of lists in messages, in one place.
//!
//! A recorder stays within them: it leaves nodes out and counts them. A received tree that exceeds them is refused.

/// Maximum number of levels of a tree, including the root's.
// The level of a node is computed from its ancestors, so that this limits the work for each node of a hostile
// tree.
pub const MAX_DEPTH: usize = 32;

/// Maximum number of nodes of a tree.
pub const MAX_NODES: usize = 4096;

/// Nodes that a recorder leaves free for values computed afterwards: sizes, throughputs, totals.
pub const RESERVED_NODES: usize = 64;

/// Maximum number of hosts of a tree.
pub const MAX_ANCHORS: usize = 8;

/// Maximum number of bytes (UTF-8) of a name, a kind, or a unit's symbol.
pub const MAX_NAME_BYTES: usize = 128;

/// Maximum number of bytes of the wire form of a tree or a tree delta.
pub const MAX_TREE_BYTES: usize = 1024 * 1024;
