//! The announcement of our node to the node list of ROS 2 (`ros2 node list`, `ros2 node info`).
//!
//! Every participant publishes `rmw_dds_common/msg/ParticipantEntitiesInfo` on the DDS topic `ros_discovery_info`:
//! its own identifier, then for each node the names and the identifiers of subscriptions and publishers.

use bytes::{BufMut, Bytes, BytesMut};

use crate::ros2::{EndpointId, EndpointRole};

pub(super) const TOPIC: &str = "ros_discovery_info";
pub(super) const TYPE_NAME: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

/// Our node as others see it.
#[derive(Debug)]
pub(super) struct NodeEntry {
    pub(super) participant: EndpointId,
    pub(super) namespace: String,
    pub(super) name: String,
    /// Bytes of an identifier: 16, and 24 before ROS 2 Iron.
    pub(super) identifier_length: usize,
    pub(super) endpoints: Vec<(EndpointRole, EndpointId)>,
}

impl NodeEntry {
    /// Returns the CDR form of the announcement with its encapsulation header.
    pub(super) fn to_payload(&self) -> Bytes {
        let mut cdr = BytesMut::from(&[0, 1, 0, 0][..]);
        self.put_identifier(&mut cdr, self.participant);
        cdr.put_u32_le(1);
        put_string(&mut cdr, &self.namespace);
        put_string(&mut cdr, &self.name);
        self.put_identifiers(&mut cdr, EndpointRole::Subscription);
        self.put_identifiers(&mut cdr, EndpointRole::Publisher);
        cdr.freeze()
    }

    fn put_identifiers(&self, cdr: &mut BytesMut, role: EndpointRole) {
        let of_role = || self.endpoints.iter().filter(|(other, _)| *other == role);
        cdr.put_u32_le(u32::try_from(of_role().count()).unwrap_or(u32::MAX));
        of_role().for_each(|(_, id)| self.put_identifier(cdr, *id));
    }

    fn put_identifier(&self, cdr: &mut BytesMut, id: EndpointId) {
        cdr.put_slice(&id.0);
        cdr.put_bytes(0, self.identifier_length - id.0.len());
    }
}

/// Appends a string and the padding that the length of the next value needs.
fn put_string(cdr: &mut BytesMut, text: &str) {
    cdr.put_u32_le(u32::try_from(text.len() + 1).unwrap_or(u32::MAX));
    cdr.put_slice(text.as_bytes());
    cdr.put_u8(0);
    cdr.put_bytes(0, cdr.len().next_multiple_of(4) - cdr.len());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn announcement_has_the_form_of_rmw_dds_common() {
        let entry = NodeEntry {
            participant: EndpointId([1; 16]),
            namespace: "/".into(),
            name: "peernet".into(),
            identifier_length: 24,
            endpoints: vec![
                (EndpointRole::Publisher, EndpointId([2; 16])),
                (EndpointRole::Subscription, EndpointId([3; 16])),
            ],
        };
        let mut expected = vec![0, 1, 0, 0];
        let padded = |byte: u8| [[byte; 16].as_slice(), &[0; 8]].concat();
        expected.extend(padded(1));
        expected.extend([1, 0, 0, 0, 2, 0, 0, 0, b'/', 0, 0, 0]);
        expected.extend([8, 0, 0, 0]);
        expected.extend(b"peernet\0");
        expected.extend([1, 0, 0, 0]);
        expected.extend(padded(3));
        expected.extend([1, 0, 0, 0]);
        expected.extend(padded(2));
        assert_eq!(entry.to_payload()[..], expected);
        let shorter = NodeEntry { identifier_length: 16, ..entry };
        assert_eq!(shorter.to_payload().len(), expected.len() - 3 * 8);
    }
}
