//! Frame 1 of a message: the tree of a request or the tree delta of a reply, in the wire form and within the limits of
//! the logger.

use bytes::Bytes;
use peernet_logger::limits::MAX_TREE_BYTES;
use peernet_logger::{Measure, NodeId, Transit, Tree, TreeDelta, stage, wire};

use super::Departure;

/// Error: a tree or a tree delta cannot be sent or cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TreeFrameError {
    #[error("the tree or tree delta has {0} bytes, more than {MAX_TREE_BYTES}")]
    TooLong(usize),
    #[error(transparent)]
    Unreadable(#[from] wire::WireError),
}

/// Adds `upload` to a tree and returns the new node. The edge adds the node to its tree, and the cloud adds it to the
/// copy of the tree that arrived. The node therefore has the same position in the two trees, although the node itself
/// is not sent.
pub(crate) fn add_upload(tree: &mut Tree, departure: Departure) -> NodeId {
    let transit = Transit { sent: departure.sent, received: None, delay: None, raw_stamps: None };
    tree.add(NodeId::ROOT, stage::UPLOAD, departure.sent_since_anchor, Measure::Transit(Box::new(transit)))
}

pub(crate) fn encode_tree(tree: &Tree) -> Result<Bytes, TreeFrameError> {
    let mut out = Vec::with_capacity(512);
    wire::encode(tree, &mut out);
    check_length(out)
}

pub(crate) fn decode_tree(bytes: &[u8]) -> Result<Tree, TreeFrameError> {
    Ok(wire::decode(bytes)?)
}

pub(crate) fn encode_tree_delta(delta: &TreeDelta) -> Result<Bytes, TreeFrameError> {
    let mut out = Vec::with_capacity(512);
    wire::encode_tree_delta(delta, &mut out);
    check_length(out)
}

pub(crate) fn decode_tree_delta(bytes: &[u8]) -> Result<TreeDelta, TreeFrameError> {
    Ok(wire::decode_tree_delta(bytes)?)
}

/// Returns the frame if the receiver accepts its length.
fn check_length(out: Vec<u8>) -> Result<Bytes, TreeFrameError> {
    if out.len() > MAX_TREE_BYTES {
        return Err(TreeFrameError::TooLong(out.len()));
    }
    Ok(out.into())
}
