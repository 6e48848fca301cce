//! Frame 1: the tree on the way up, its growth on the way down, in the logger's own wire form and its limits.

use bytes::Bytes;
use peernet_logger::limits::MAX_BYTES;
use peernet_logger::{Growth, Measure, NodeId, Transit, Tree, stage, wire};

use super::Departure;

/// Puts `upload` into a tree: the edge into its own and the cloud into the copy that arrived, so that the node has
/// the same position in both without having been sent.
pub(crate) fn put_upload(tree: &mut Tree, departure: Departure) -> NodeId {
    let transit = Transit { sent: departure.sent, received: None, delay: None };
    tree.add(NodeId::ROOT, stage::UPLOAD, departure.start, Measure::Transit(Box::new(transit)))
}

pub(crate) fn encode_tree(tree: &Tree) -> Result<Bytes, String> {
    let mut out = Vec::with_capacity(512);
    wire::encode(tree, &mut out);
    sendable(out)
}

pub(crate) fn decode_tree(bytes: &[u8]) -> Result<Tree, String> {
    wire::decode(bytes).map_err(|error| error.to_string())
}

pub(crate) fn encode_growth(growth: &Growth) -> Result<Bytes, String> {
    let mut out = Vec::with_capacity(512);
    wire::encode_growth(growth, &mut out);
    sendable(out)
}

pub(crate) fn decode_growth(bytes: &[u8]) -> Result<Growth, String> {
    wire::decode_growth(bytes).map_err(|error| error.to_string())
}

fn sendable(out: Vec<u8>) -> Result<Bytes, String> {
    if out.len() > MAX_BYTES {
        return Err(format!("the tree takes {} bytes, more than {MAX_BYTES}", out.len()));
    }
    Ok(out.into())
}
