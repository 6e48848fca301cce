//! How large a tree may become, wherever it comes from, and how long lists in messages.
//!
//! A recorder stays within them by leaving nodes out and counting them; what arrives and does not is refused.

/// Levels of a tree, the root's included.
pub const MAX_DEPTH: usize = 32;

/// Nodes of a tree.
pub const MAX_NODES: usize = 4096;

/// Places that a recorder leaves free for what is computed after the fact: sizes, throughputs, totals.
pub const RESERVED_NODES: usize = 64;

/// Hosts of a tree.
pub const MAX_ANCHORS: usize = 8;

/// Bytes of a name, of a kind or of a unit's symbol, in UTF-8.
pub const MAX_NAME_BYTES: usize = 128;

/// Bytes of the wire form of a tree or a growth.
pub const MAX_BYTES: usize = 1024 * 1024;
