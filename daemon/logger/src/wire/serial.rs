//! Serde implementations of trees and tree deltas: bytes in binary formats, objects in human-readable ones.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use peernet_clock::WallTime;

use super::writer::USUAL_NODE_BYTES;
use super::{decode, decode_tree_delta, encode, encode_tree_delta};
use crate::limits::MAX_NODES;
use crate::{Anchor, Node, NodeId, Tree, TreeDelta, TreeError};

/// Human-readable form of a [`Tree`] as it is read, before the check.
#[derive(Deserialize)]
#[serde(rename = "Tree")]
struct PlainTree {
    anchors: Vec<Anchor>,
    nodes: Vec<Node>,
}

/// Human-readable form of a [`Tree`] as it is written.
#[derive(Serialize)]
#[serde(rename = "Tree")]
struct TreeView<'a> {
    anchors: &'a [Anchor],
    nodes: &'a [Node],
}

/// Human-readable form of a [`TreeDelta`] as it is read.
#[derive(Deserialize)]
#[serde(rename = "TreeDelta")]
struct PlainTreeDelta {
    base: u32,
    anchor: Anchor,
    others: Vec<Anchor>,
    closed: (NodeId, WallTime),
    nodes: Vec<Node>,
}

/// Human-readable form of a [`TreeDelta`] as it is written.
#[derive(Serialize)]
#[serde(rename = "TreeDelta")]
struct TreeDeltaView<'a> {
    base: u32,
    anchor: &'a Anchor,
    others: &'a [Anchor],
    closed: (NodeId, WallTime),
    nodes: &'a [Node],
}

/// Returns the approximate number of bytes of the wire form of a tree or tree delta with these nodes.
const fn usual_wire_bytes(nodes: &[Node]) -> usize {
    nodes.len() * USUAL_NODE_BYTES + 64
}

impl Serialize for Tree {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            return TreeView { anchors: &self.anchors, nodes: &self.nodes }.serialize(serializer);
        }
        let mut wire = Vec::with_capacity(usual_wire_bytes(&self.nodes));
        encode(self, &mut wire);
        serializer.serialize_bytes(&wire)
    }
}

impl<'de> Deserialize<'de> for Tree {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            let PlainTree { anchors, nodes } = PlainTree::deserialize(deserializer)?;
            return Self::from_parts(anchors, nodes).map_err(D::Error::custom);
        }
        let wire: std::borrow::Cow<'de, [u8]> = serde_bytes::deserialize(deserializer)?;
        decode(&wire).map_err(D::Error::custom)
    }
}

impl Serialize for TreeDelta {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            let Self { base, anchor, others, closed, nodes } = self;
            return TreeDeltaView { base: *base, anchor, others, closed: *closed, nodes }
                .serialize(serializer);
        }
        let mut wire = Vec::with_capacity(usual_wire_bytes(&self.nodes));
        encode_tree_delta(self, &mut wire);
        serializer.serialize_bytes(&wire)
    }
}

impl<'de> Deserialize<'de> for TreeDelta {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            let PlainTreeDelta { base, anchor, others, closed, nodes } =
                PlainTreeDelta::deserialize(deserializer)?;
            // `Tree::apply_delta` checks the nodes later. Their number is limited here, as it is in the wire form.
            if nodes.len() > MAX_NODES {
                return Err(D::Error::custom(TreeError::TooManyNodes(nodes.len())));
            }
            return Ok(Self { base, anchor, others, closed, nodes });
        }
        let wire: std::borrow::Cow<'de, [u8]> = serde_bytes::deserialize(deserializer)?;
        decode_tree_delta(&wire).map_err(D::Error::custom)
    }
}
