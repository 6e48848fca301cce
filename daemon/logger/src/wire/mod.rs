//! The wire form of trees and tree deltas. It is MessagePack: fields are identified by their positions in arrays, and
//! standard names are small numbers.
//!
//! | | |
//! | --- | --- |
//! | tree | `[version, [anchor…], [node…]]` |
//! | tree delta | `[version, base, anchor, [anchor…], closed node, closed at, [node…]]` |
//! | anchor | `[host (16 bytes), wall clock]` |
//! | node | `[parent or nil, name, host, start, kind, …]`, further fields by kind as below |
//! | 0 container | |
//! | 1 timer | duration or nil |
//! | 2 transit | sent, received or nil, delay or nil; if known, also sent and received on the free-running clocks |
//! | 3 value | number, unit |
//! | 4 throughput | number or nil, lower and upper bound or nil and nil |
//! | 5 token rate | number or nil |
//! | 6 custom | kind's name, unit, number or nil |
//! | delay | `[raw difference of the stamps, value or nil, lower and upper bound or nil and nil, source, verdict]` |
//!
//! The fields of a tree delta have the order of the fields of [`TreeDelta`]: `base` is the number of nodes of the tree
//! that the delta extends. The host of a node is the position of the host's anchor.
//!
//! Times are integers in nanoseconds. A name is its position among the standard names, or a string. Numbers without a
//! fraction may be written as integers. A tree of 12 nodes takes about 280 bytes. The form is so short because it is
//! written with `rmp` directly and not through serde.
//!
//! The reader accepts input from untrusted peers: it allocates at most a small multiple of the input's length, enforces
//! [`crate::limits`], and refuses invalid input with the reason.

mod reader;
mod serial;
mod writer;

use peernet_clock::WallTime;

use self::reader::Reader;
use crate::limits::MAX_TREE_BYTES;
use crate::{NodeId, Tree, TreeDelta, TreeError};

/// Version of the wire form.
pub const VERSION: u64 = 1;

/// Reason why bytes are not a tree or a tree delta.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The input is longer than the limit.
    #[error("the input has {0} bytes, the limit is {MAX_TREE_BYTES}")]
    TooLong(usize),
    /// The input has another version of the wire form.
    #[error("version {0} of the wire form is not supported, this program reads version {VERSION}")]
    Version(u64),
    /// The input ends too early, or contains another item than the expected item.
    #[error("expected {expected} at byte {at}")]
    Malformed {
        /// Position in the input.
        at: usize,
        /// Expected item.
        expected: &'static str,
    },
    /// The input contains more items than allowed.
    #[error("the input has {found} {what}, the limit is {limit}")]
    Limit {
        /// Kind of the items.
        what: &'static str,
        /// Number of items stated in the input.
        found: usize,
        /// Maximum number of items.
        limit: usize,
    },
    /// Bytes follow the end of the tree or tree delta.
    #[error("{0} bytes follow the end of the tree or tree delta")]
    Trailing(usize),
    /// The input is well-formed, but not a valid tree.
    #[error(transparent)]
    Tree(#[from] TreeError),
}

/// Appends the wire form of a tree to `out`.
pub fn encode(tree: &Tree, out: &mut Vec<u8>) {
    writer::array(out, 3);
    writer::uint(out, VERSION);
    writer::anchors(out, &tree.anchors);
    writer::nodes(out, &tree.nodes);
}

/// Reads the wire form of a tree.
///
/// # Errors
/// If the bytes are not exactly one tree within the limits.
pub fn decode(bytes: &[u8]) -> Result<Tree, WireError> {
    let mut reader = Reader::new(bytes, 3, "a tree")?;
    let anchors = reader.anchors()?;
    let nodes = reader.nodes()?;
    reader.finish()?;
    Ok(Tree::from_parts(anchors, nodes)?)
}

/// Appends the wire form of a tree delta to `out`.
pub fn encode_tree_delta(delta: &TreeDelta, out: &mut Vec<u8>) {
    let TreeDelta { base, anchor, others, closed: (transit, received_at), nodes } = delta;
    writer::array(out, 7);
    writer::uint(out, VERSION);
    writer::uint(out, u64::from(*base));
    writer::anchor(out, anchor);
    writer::anchors(out, others);
    writer::uint(out, u64::from(transit.0));
    writer::int(out, received_at.unix_nanos());
    writer::nodes(out, nodes);
}

/// Reads the wire form of a tree delta. [`Tree::apply_delta`] checks whether the delta fits a tree.
///
/// # Errors
/// If the bytes are not exactly one tree delta within the limits.
pub fn decode_tree_delta(bytes: &[u8]) -> Result<TreeDelta, WireError> {
    let mut reader = Reader::new(bytes, 7, "a tree delta")?;
    let base = reader.position("the length of the tree")?;
    let anchor = reader.anchor()?;
    let others = reader.anchors()?;
    let transit = NodeId(reader.position("the position of the closed node")?);
    let received_at = WallTime::from_unix_nanos(reader.int("the time of closing")?);
    let nodes = reader.nodes()?;
    reader.finish()?;
    for (index, node) in nodes.iter().enumerate() {
        // Only the values are checked here. `Tree::apply_delta` checks everything else, because it knows the tree.
        node.measure.check(base as usize + index)?;
    }
    Ok(TreeDelta { base, anchor, others, closed: (transit, received_at), nodes })
}

#[cfg(test)]
mod tests;
