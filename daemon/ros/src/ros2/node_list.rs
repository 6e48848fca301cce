//! The node list of ROS 2 (`ros2 node list`, `ros2 node info`): our entry, and the entries of other participants.
//!
//! Every participant publishes `rmw_dds_common/msg/ParticipantEntitiesInfo` on the DDS topic `ros_discovery_info`: its
//! own identifier, then for each node the names and the identifiers of subscriptions and publishers.

use bytes::{BufMut, Bytes, BytesMut};

use super::{EndpointId, EndpointRole, ParticipantId};
use crate::messages::{DecodeError, Reader, WireForm};

#[cfg(feature = "ros2")]
pub(super) const TOPIC: &str = "ros_discovery_info";
#[cfg(feature = "ros2")]
pub(super) const TYPE_NAME: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

/// Maximum number of nodes of a participant that are read. A component container has some dozens.
const MAX_NODES: usize = 512;

/// Maximum number of publishers and subscriptions of a participant that are read.
const MAX_ENDPOINTS: usize = 8_192;

/// Longest name of a node with its namespace, bytes.
const MAX_NAME_BYTES: usize = 512;

/// Lengths of an identifier since ROS 2 Iron and before Iron, bytes.
const IDENTIFIER_LENGTHS: [usize; 2] = [16, 24];

/// A node of another participant, as that participant lists it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ListedNode {
    /// Absolute name, such as `/robot1/camera`.
    pub(crate) name: String,
    /// Publishers and subscriptions of the node.
    pub(crate) endpoints: Vec<EndpointId>,
}

/// An entry of the node list: the nodes of one participant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ListEntry {
    /// The participant.
    pub(crate) participant: ParticipantId,
    /// Nodes of the participant.
    pub(crate) nodes: Vec<ListedNode>,
}

/// Reason why a message of the node list is ignored.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum NodeListError {
    /// The bytes are not an entry.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The entry has more elements than any real entry.
    #[error("it lists more than {max} {elements}")]
    TooMany {
        /// Largest allowed number.
        max: usize,
        /// Kind of the elements.
        elements: &'static str,
    },
    /// ROS 2 does not allow the name of a node.
    #[error("it has a node name that ROS 2 does not allow")]
    InvalidName,
    /// A participant lists endpoints of another participant.
    #[error("it lists endpoints of another participant")]
    ForeignEndpoint,
}

impl ListEntry {
    /// Decodes an entry with identifiers of either length.
    ///
    /// # Errors
    /// [`NodeListError`].
    pub(crate) fn decode(payload: &Bytes) -> Result<Self, NodeListError> {
        let [short, long] = IDENTIFIER_LENGTHS.map(|length| Self::decode_with_length(payload, length));
        // If a message is read with the wrong length, bytes remain or are missing.
        short.or_else(|error| long.map_err(|_| error))
    }

    fn decode_with_length(payload: &Bytes, identifier_length: usize) -> Result<Self, NodeListError> {
        let mut reader = Reader::new(WireForm::Cdr, payload.clone())?;
        let participant = read_identifier(&mut reader, identifier_length)?.participant();
        // A node has at least two empty texts and two empty sequences, each of 4 bytes.
        let count = reader.take_length(16)?;
        if count > MAX_NODES {
            return Err(NodeListError::TooMany { max: MAX_NODES, elements: "nodes" });
        }
        let (mut nodes, mut endpoint_count) = (Vec::new(), 0);
        for _ in 0..count {
            let (namespace, name) = (reader.take_text()?, reader.take_text()?);
            let name = absolute_name(&namespace, &name)?;
            let mut endpoints = Vec::new();
            for _subscriptions_then_publishers in 0..2 {
                let count = reader.take_length(identifier_length)?;
                endpoint_count += count;
                if endpoint_count > MAX_ENDPOINTS {
                    return Err(NodeListError::TooMany {
                        max: MAX_ENDPOINTS,
                        elements: "publishers and subscriptions",
                    });
                }
                for _ in 0..count {
                    let id = read_identifier(&mut reader, identifier_length)?;
                    if id.participant() != participant {
                        return Err(NodeListError::ForeignEndpoint);
                    }
                    endpoints.push(id);
                }
            }
            nodes.push(ListedNode { name, endpoints });
        }
        reader.finish()?;
        Ok(Self { participant, nodes })
    }
}

fn read_identifier(reader: &mut Reader, length: usize) -> Result<EndpointId, DecodeError> {
    let id = EndpointId(reader.take_octets()?);
    for _padding in id.0.len()..length {
        reader.take_octets::<1>()?;
    }
    Ok(id)
}

fn absolute_name(namespace: &str, name: &str) -> Result<String, NodeListError> {
    let absolute = format!("{}/{name}", namespace.trim_end_matches('/'));
    let is_allowed = |char: char| char.is_ascii_alphanumeric() || matches!(char, '_' | '/');
    let is_valid = absolute.starts_with('/')
        && !name.is_empty()
        && absolute.len() <= MAX_NAME_BYTES
        && absolute.chars().all(is_allowed);
    if is_valid { Ok(absolute) } else { Err(NodeListError::InvalidName) }
}

/// The entry of our participant in the node list. Our participant has one node.
#[derive(Debug)]
pub(super) struct OwnEntry {
    pub(super) participant: EndpointId,
    pub(super) namespace: String,
    pub(super) name: String,
    /// Length of an identifier, bytes: 16 since ROS 2 Iron, 24 before Iron.
    pub(super) identifier_length: usize,
    pub(super) endpoints: Vec<(EndpointRole, EndpointId)>,
}

impl OwnEntry {
    /// Returns the CDR form of the entry with its encapsulation header.
    pub(super) fn to_payload(&self) -> Bytes {
        let mut cdr = BytesMut::from(&[0, 1, 0, 0][..]);
        self.put_identifier(&mut cdr, self.participant);
        // Number of nodes.
        cdr.put_u32_le(1);
        put_string(&mut cdr, &self.namespace);
        put_string(&mut cdr, &self.name);
        self.put_identifiers(&mut cdr, EndpointRole::Subscription);
        self.put_identifiers(&mut cdr, EndpointRole::Publisher);
        cdr.freeze()
    }

    fn put_identifiers(&self, cdr: &mut BytesMut, role: EndpointRole) {
        let endpoints_with_role =
            || self.endpoints.iter().filter(|(endpoint_role, _)| *endpoint_role == role);
        cdr.put_u32_le(u32::try_from(endpoints_with_role().count()).unwrap_or(u32::MAX));
        endpoints_with_role().for_each(|(_, id)| self.put_identifier(cdr, *id));
    }

    fn put_identifier(&self, cdr: &mut BytesMut, id: EndpointId) {
        cdr.put_slice(&id.0);
        cdr.put_bytes(0, self.identifier_length - id.0.len());
    }
}

/// Appends a string, and padding to a multiple of four bytes, because the next value begins with a `u32`.
fn put_string(cdr: &mut BytesMut, text: &str) {
    cdr.put_u32_le(u32::try_from(text.len() + 1).unwrap_or(u32::MAX));
    cdr.put_slice(text.as_bytes());
    cdr.put_u8(0);
    cdr.put_bytes(0, cdr.len().next_multiple_of(4) - cdr.len());
}

#[cfg(test)]
mod tests;
