//! The wire form of trees and growths: MessagePack, arrays by position, standard names as small numbers.
//!
//! | | |
//! | --- | --- |
//! | tree | `[version, [anchor…], [node…]]` |
//! | growth | `[version, base, anchor, [anchor…], closed node, closed at, [node…]]` |
//! | anchor | `[host (16 bytes), wall clock]` |
//! | node | `[parent or nil, name, host, start, kind, …]`, the rest as below |
//! | 0 container | |
//! | 1 timer | duration or nil |
//! | 2 transit | sent, received or nil, delay or nil; where they are known, sent and received by the free-running clocks |
//! | 3 value | number, unit |
//! | 4 throughput | number or nil, lower and upper bound or nil and nil |
//! | 5 token rate | number or nil |
//! | 6 custom | kind's name, unit, number or nil |
//! | delay | `[raw, value or nil, lower and upper bound or nil and nil, source, verdict]` |
//!
//! Times are integers in nanoseconds. A name is its position among the standard names or a string; numbers
//! without a fraction may be written as integers.
//!
//! Reading takes whatever anyone sends: it allocates at most a small multiple of the input's length, stays within
//! [`crate::limits`], and refuses everything else with the reason.

mod reader;
mod serial;
mod writer;

use peernet_clock::WallTime;

use self::reader::Reader;
use crate::limits::MAX_BYTES;
use crate::{Growth, NodeId, Tree, TreeError};

/// Version of the wire form.
pub const VERSION: u64 = 1;

/// Why bytes are not a tree or a growth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// Longer than anything that is read.
    #[error("{0} bytes are more than the limit of {MAX_BYTES}")]
    TooLong(usize),
    /// Made by another version of this program.
    #[error("version {0} of the wire form cannot be read, only {VERSION}")]
    Version(u64),
    /// Something else stands where it should, or nothing.
    #[error("expected {expected} at byte {at}")]
    Malformed {
        /// Position in the input.
        at: usize,
        /// What should have stood there.
        expected: &'static str,
    },
    /// More of something than is allowed.
    #[error("{found} {what} are more than the limit of {limit}")]
    Limit {
        /// Of what.
        what: &'static str,
        /// How many there were said to be.
        found: usize,
        /// How many may be.
        limit: usize,
    },
    /// Something follows.
    #[error("{0} bytes follow the end")]
    Trailing(usize),
    /// Well-formed, but not a tree.
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
/// When the bytes are anything but one whole tree within the limits.
pub fn decode(bytes: &[u8]) -> Result<Tree, WireError> {
    let mut reader = Reader::begin(bytes, 3, "a tree")?;
    let anchors = reader.anchors()?;
    let nodes = reader.nodes()?;
    reader.end()?;
    Ok(Tree::from_parts(anchors, nodes)?)
}

/// Appends the wire form of a growth to `out`.
pub fn encode_growth(growth: &Growth, out: &mut Vec<u8>) {
    let Growth { base, anchor, others, closed: (closed, at), nodes } = growth;
    writer::array(out, 7);
    writer::uint(out, VERSION);
    writer::uint(out, u64::from(*base));
    writer::anchor(out, anchor);
    writer::anchors(out, others);
    writer::uint(out, u64::from(closed.0));
    writer::int(out, at.unix_nanos());
    writer::nodes(out, nodes);
}

/// Reads the wire form of a growth. Whether it fits a tree is for [`Tree::absorb`] to see.
///
/// # Errors
/// When the bytes are anything but one whole growth within the limits.
pub fn decode_growth(bytes: &[u8]) -> Result<Growth, WireError> {
    let mut reader = Reader::begin(bytes, 7, "a growth")?;
    let base = reader.small("the length of the tree")?;
    let anchor = reader.anchor()?;
    let others = reader.anchors()?;
    let closed = NodeId(reader.small("the position of the closed node")?);
    let at = WallTime::from_unix_nanos(reader.int("the moment of closing")?);
    let nodes = reader.nodes()?;
    reader.end()?;
    for (index, node) in nodes.iter().enumerate() {
        node.measure.check(base as usize + index)?;
    }
    Ok(Growth { base, anchor, others, closed: (closed, at), nodes })
}

#[cfg(test)]
mod tests;
