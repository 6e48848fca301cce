//! Tests of writing and reading entries of the node list, including arbitrary bytes.

use proptest::prelude::*;
use proptest::sample::Index;

use super::*;

fn entry(identifier_length: usize) -> OwnEntry {
    let endpoint_id = |byte: u8, last: u8| {
        let mut id = [byte; 16];
        id[15] = last;
        EndpointId(id)
    };
    OwnEntry {
        participant: endpoint_id(1, 0xc1),
        namespace: "/robot1".into(),
        name: "camera".into(),
        identifier_length,
        endpoints: vec![
            (EndpointRole::Publisher, endpoint_id(1, 0x03)),
            (EndpointRole::Subscription, endpoint_id(1, 0x04)),
        ],
    }
}

#[test]
fn entry_round_trips_with_identifiers_of_both_lengths() {
    for length in IDENTIFIER_LENGTHS {
        let written = entry(length);
        let decoded = ListEntry::decode(&written.to_payload()).unwrap();
        // An entry lists a node's subscriptions before its publishers.
        let endpoints = vec![written.endpoints[1].1, written.endpoints[0].1];
        let node = ListedNode { name: "/robot1/camera".into(), endpoints };
        assert_eq!(decoded, ListEntry { participant: ParticipantId([1; 12]), nodes: vec![node] });
    }
}

#[test]
fn entry_with_foreign_endpoint_or_invalid_name_is_refused() {
    let mut entry_with_foreign_endpoint = entry(16);
    entry_with_foreign_endpoint.endpoints[0].1.0[0] = 2;
    assert_eq!(
        ListEntry::decode(&entry_with_foreign_endpoint.to_payload()),
        Err(NodeListError::ForeignEndpoint)
    );
    for (namespace, name) in [("/", ""), ("robot", "camera"), ("/", "a\nb"), ("/", &*"n".repeat(600))] {
        let entry_with_invalid_name =
            OwnEntry { namespace: namespace.into(), name: name.into(), ..entry(16) };
        assert_eq!(
            ListEntry::decode(&entry_with_invalid_name.to_payload()),
            Err(NodeListError::InvalidName),
            "{namespace} {name}"
        );
    }
    let entry_in_root_namespace = OwnEntry { namespace: "/".into(), ..entry(16) };
    assert_eq!(ListEntry::decode(&entry_in_root_namespace.to_payload()).unwrap().nodes[0].name, "/camera");
}

#[test]
fn announcement_has_the_form_of_rmw_dds_common() {
    let entry = OwnEntry {
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
    let padded_identifier = |byte: u8| [[byte; 16].as_slice(), &[0; 8]].concat();
    expected.extend(padded_identifier(1));
    expected.extend([1, 0, 0, 0, 2, 0, 0, 0, b'/', 0, 0, 0]);
    expected.extend([8, 0, 0, 0]);
    expected.extend(b"peernet\0");
    expected.extend([1, 0, 0, 0]);
    expected.extend(padded_identifier(3));
    expected.extend([1, 0, 0, 0]);
    expected.extend(padded_identifier(2));
    assert_eq!(entry.to_payload()[..], expected);
    let entry_with_short_identifiers = OwnEntry { identifier_length: 16, ..entry };
    assert_eq!(entry_with_short_identifiers.to_payload().len(), expected.len() - 3 * 8);
}

/// Returns an entry of several nodes, made of entries of single nodes.
fn multi_node_entry(entries: &[OwnEntry]) -> Vec<u8> {
    let Some(first) = entries.first() else { return Vec::new() };
    // The number of nodes follows the encapsulation header of 4 bytes and the identifier of the participant.
    let count_start = 4 + first.identifier_length;
    let nodes_start = count_start + 4;
    let mut cdr = first.to_payload()[..count_start].to_vec();
    cdr.extend(u32::try_from(entries.len()).unwrap().to_le_bytes());
    for entry in entries {
        cdr.extend(&entry.to_payload()[nodes_start..]);
    }
    cdr
}

fn any_entry(length: usize) -> impl Strategy<Value = OwnEntry> {
    let id = |last: u8| {
        let mut id = [1; 16];
        id[15] = last;
        EndpointId(id)
    };
    let name = || prop_oneof!["[a-z_]{0,9}", "/[a-z/]{0,9}", any::<String>()];
    (name(), name(), prop::collection::vec(any::<(bool, u8)>(), 0..6)).prop_map(
        move |(namespace, name, endpoints)| {
            let role =
                |publishes| if publishes { EndpointRole::Publisher } else { EndpointRole::Subscription };
            let endpoints =
                endpoints.into_iter().map(|(publishes, last)| (role(publishes), id(last))).collect();
            OwnEntry { participant: id(0xc1), namespace, name, identifier_length: length, endpoints }
        },
    )
}

fn any_payload() -> impl Strategy<Value = Vec<u8>> {
    let entries = |length| prop::collection::vec(any_entry(length), 0..4);
    prop_oneof![entries(IDENTIFIER_LENGTHS[0]), entries(IDENTIFIER_LENGTHS[1])]
        .prop_map(|entries| multi_node_entry(&entries))
}

proptest! {
    #[test]
    fn damaged_node_lists_are_read_within_bounds(
        mut bytes in any_payload(),
        changes in prop::collection::vec((any::<Index>(), any::<u8>(), 0..5_u8), 0..6),
    ) {
        for (index, byte, change) in changes {
            let index = index.index(bytes.len() + 1);
            match change {
                0 => bytes.insert(index, byte),
                1 => bytes.truncate(index),
                2 if bytes.len() < 4_096 => bytes.extend_from_within(index..),
                // A length that claims more elements than there are: the random byte is its highest byte.
                3 => {
                    let claimed_length = u32::from(byte).rotate_right(8).to_le_bytes();
                    bytes.splice(index..(index + 4).min(bytes.len()), claimed_length).for_each(drop);
                }
                _ if index < bytes.len() => bytes[index] = byte,
                _ => {}
            }
        }
        let length = bytes.len();
        if let Ok(entry) = ListEntry::decode(&bytes.into()) {
            prop_assert!(entry.nodes.len() <= MAX_NODES);
            let endpoints: Vec<EndpointId> = entry.nodes.iter().flat_map(|node| node.endpoints.clone()).collect();
            prop_assert!(endpoints.len() * IDENTIFIER_LENGTHS[0] <= length, "the identifiers fit in the bytes");
            prop_assert!(endpoints.iter().all(|id| id.participant() == entry.participant));
            for node in &entry.nodes {
                prop_assert!(node.name.starts_with('/') && node.name.len() <= MAX_NAME_BYTES && node.name.is_ascii());
            }
        }
    }
}
