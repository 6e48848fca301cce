//! Tests of discovery, including arbitrary announcements.

use std::ops::Range;

use proptest::prelude::*;

use super::*;

const LOCAL: EndpointId = EndpointId([1; 16]);
const REMOTE: EndpointId = EndpointId([2; 16]);

fn state() -> (DiscoveryState, watch::Receiver<PeerTable>) {
    let mut state = DiscoveryState::new(ParticipantId([1; 12]));
    let peers = state.add_local(LOCAL, EndpointRole::Subscription, "std_msgs::msg::dds_::String_");
    (state, peers)
}

fn discovered_remote(type_name: &str) -> DiscoveryEvent {
    DiscoveryEvent::EndpointDiscovered { id: REMOTE, topic: "rt/chatter".into(), type_name: type_name.into() }
}

#[test]
fn peer_is_matched_until_its_participant_is_gone() {
    let (mut state, peers) = state();
    state.apply(DiscoveryEvent::ParticipantDiscovered(ParticipantId([2; 12])));
    state.apply(DiscoveryEvent::ParticipantDiscovered(ParticipantId([1; 12])));
    assert_eq!(state.participant_count(), 1, "our own participant is not counted");
    state.apply(discovered_remote("std_msgs::msg::dds_::String_"));
    state.apply(DiscoveryEvent::Matched { local: LOCAL, remote: REMOTE });
    assert!(peers.borrow().matched.contains(&REMOTE));
    assert_eq!(state.topics(), ["/chatter"]);
    state.apply(DiscoveryEvent::ParticipantLost(ParticipantId([2; 12])));
    let expected = PeerTable { matched_total: 1, unmatched_total: 1, ..PeerTable::default() };
    assert_eq!((*peers.borrow()).clone(), expected);
    assert_eq!((state.participant_count(), state.topics().len()), (0, 0));
}

#[test]
fn peer_of_another_type_is_refused() {
    let (mut state, peers) = state();
    state.apply(discovered_remote("std_msgs::msg::dds_::Int32_"));
    state.apply(DiscoveryEvent::Matched { local: LOCAL, remote: REMOTE });
    let refusal = Refusal::OtherType { type_name: "std_msgs/msg/Int32".into() };
    assert_eq!(peers.borrow().refused.get(&REMOTE), Some(&refusal));
    assert!(peers.borrow().matched.is_empty());
    assert!(state.has_other_type(LOCAL, REMOTE));
    state.apply(DiscoveryEvent::EndpointLost(REMOTE));
    assert!(peers.borrow().refused.is_empty());
}

#[test]
fn peer_with_incompatible_qos_is_refused_with_the_reason() {
    let (mut state, peers) = state();
    let refusal = Refusal::IncompatibleQos {
        policy: "reliability".into(),
        offered: "best-effort".into(),
        requested: "reliable".into(),
    };
    state.apply(discovered_remote("std_msgs::msg::dds_::String_"));
    state.apply(DiscoveryEvent::Incompatible { local: LOCAL, remote: REMOTE, refusal: refusal.clone() });
    assert_eq!(peers.borrow().refused.get(&REMOTE), Some(&refusal));
    state.apply(DiscoveryEvent::Matched { local: LOCAL, remote: REMOTE });
    assert!(peers.borrow().refused.is_empty() && peers.borrow().matched.contains(&REMOTE));
}

fn listed_node(name: &str, endpoints: &[EndpointId]) -> ListedNode {
    ListedNode { name: name.into(), endpoints: endpoints.to_vec() }
}

#[test]
fn endpoint_has_the_name_of_its_node() {
    let (mut state, _) = state();
    let participant = REMOTE.participant();
    let unlisted_endpoint = EndpointId([[2; 12].as_slice(), &[9; 4]].concat().try_into().unwrap());
    let nodes = vec![listed_node("/camera", &[REMOTE]), listed_node("/lidar", &[])];
    state.apply(DiscoveryEvent::NodesListed(ListEntry { participant, nodes }));
    assert_eq!((state.node_of(REMOTE), state.node_of(unlisted_endpoint)), (Some("/camera"), None));
    assert_eq!(state.nodes_of(participant), ["/camera", "/lidar"]);
    let nodes = vec![listed_node("/camera2", &[REMOTE])];
    state.apply(DiscoveryEvent::NodesListed(ListEntry { participant, nodes }));
    assert_eq!(state.node_of(unlisted_endpoint), Some("/camera2"), "the only node of its participant");
    state.apply(DiscoveryEvent::ParticipantLost(participant));
    assert_eq!(state.node_of(REMOTE), None);
}

#[test]
fn forged_node_lists_are_removed_before_real_ones() {
    let (mut state, _) = state();
    // A list of a participant that discovery does not know may be forged. Each list counts as 100 listed objects: one
    // node and its 99 endpoints.
    let announce_list = |number: u32, state: &mut DiscoveryState| {
        let mut participant = [7; 12];
        participant[..4].copy_from_slice(&number.to_le_bytes());
        let (participant, nodes) = (ParticipantId(participant), vec![listed_node("/node", &[REMOTE; 99])]);
        state.apply(DiscoveryEvent::NodesListed(ListEntry { participant, nodes }));
        participant
    };
    for number in 0..2_000 {
        announce_list(number, &mut state);
    }
    let discovered_participant = ParticipantId([2; 12]);
    state.apply(DiscoveryEvent::ParticipantDiscovered(discovered_participant));
    state.apply(DiscoveryEvent::NodesListed(ListEntry {
        participant: discovered_participant,
        nodes: vec![listed_node("/camera", &[REMOTE])],
    }));
    for number in 2_000..4_000 {
        announce_list(number, &mut state);
    }
    assert_eq!(state.node_of(REMOTE), Some("/camera"));
    assert!(state.nodes.len() <= state.bounds.listed / 100 + 1, "{}", state.nodes.len());
}

#[test]
fn remote_endpoints_are_found_by_topic() {
    let (mut state, _) = state();
    // The last byte of an id says what the endpoint is: 0x03 a publisher, 0x04 a subscription, 0x00 neither.
    for (kind_byte, topic) in [(0x03, "rt/a"), (0x04, "rt/a"), (0x04, "rt/b"), (0x00, "rt/a")] {
        let mut id = REMOTE;
        id.0[15] = kind_byte;
        id.0[14] = topic.as_bytes()[3];
        let (topic, type_name) = (topic.to_owned(), "std_msgs::msg::dds_::String_".to_owned());
        state.apply(DiscoveryEvent::EndpointDiscovered {
            id,
            topic: topic.clone(),
            type_name: type_name.clone(),
        });
        // Our own endpoints are not among the found endpoints.
        state.apply(DiscoveryEvent::EndpointDiscovered { id: LOCAL, topic, type_name });
    }
    let endpoints = state.endpoints_of("rt/a");
    assert!(endpoints.iter().all(|endpoint| endpoint.type_name == "std_msgs/msg/String"));
    let roles: Vec<EndpointRole> = endpoints.iter().map(|endpoint| endpoint.role).collect();
    assert_eq!(roles, [EndpointRole::Publisher, EndpointRole::Subscription]);
}

/// Limits that short sequences of events reach.
const SMALL_BOUNDS: DiscoveryBounds =
    DiscoveryBounds { participants: 3, endpoints: 5, listed: 9, matched: 2, refused: 2 };

/// Participants that announce; the first participant is our own.
const ANNOUNCING_PARTICIPANTS: Range<u8> = 0..8;

fn id_of(participant: u8) -> ParticipantId {
    ParticipantId([participant; 12])
}

fn any_endpoint() -> impl Strategy<Value = EndpointId> {
    (ANNOUNCING_PARTICIPANTS, 0..3_u8, any::<u8>()).prop_map(|(participant, number, kind)| {
        let mut id = [participant; 16];
        id[12..].copy_from_slice(&[0, 0, number, kind % 8]);
        EndpointId(id)
    })
}

fn any_name() -> impl Strategy<Value = String> {
    let max_name_bytes = DiscoveryState::MAX_NAME_BYTES;
    prop_oneof![
        4 => prop::sample::select(vec!["rt/a".to_owned(), "a::b_".to_owned(), "rt".to_owned()]),
        2 => any::<String>(),
        1 => (max_name_bytes - 1..max_name_bytes + 2).prop_map(|length| "n".repeat(length)),
    ]
}

fn any_refusal() -> impl Strategy<Value = Refusal> {
    any_name().prop_map(|type_name| Refusal::OtherType { type_name })
}

fn any_entry() -> impl Strategy<Value = ListEntry> {
    let nodes = (any_name(), prop::collection::vec(any_endpoint(), 0..6));
    let nodes = nodes.prop_map(|(name, endpoints)| ListedNode { name, endpoints });
    (ANNOUNCING_PARTICIPANTS, prop::collection::vec(nodes, 0..4))
        .prop_map(|(participant, nodes)| ListEntry { participant: id_of(participant), nodes })
}

fn any_event() -> impl Strategy<Value = DiscoveryEvent> {
    let local = || prop_oneof![4 => Just(LOCAL), 1 => any_endpoint()];
    prop_oneof![
        1 => ANNOUNCING_PARTICIPANTS.prop_map(|participant| DiscoveryEvent::ParticipantDiscovered(id_of(participant))),
        1 => ANNOUNCING_PARTICIPANTS.prop_map(|participant| DiscoveryEvent::ParticipantLost(id_of(participant))),
        3 => (any_endpoint(), any_name(), any_name()).prop_map(|(id, topic, type_name)| {
            DiscoveryEvent::EndpointDiscovered { id, topic, type_name }
        }),
        1 => any_endpoint().prop_map(DiscoveryEvent::EndpointLost),
        2 => any_entry().prop_map(DiscoveryEvent::NodesListed),
        2 => (local(), any_endpoint())
            .prop_map(|(local, remote)| DiscoveryEvent::Matched { local, remote }),
        2 => (local(), any_endpoint(), any_refusal()).prop_map(|(local, remote, refusal)| {
            DiscoveryEvent::Incompatible { local, remote, refusal }
        }),
    ]
}

/// Checks that the remembered objects do not exceed the limits.
fn check_bounds(state: &DiscoveryState, peers: &PeerTable) {
    let listed: usize = state.nodes.values().flatten().map(|node| 1 + node.endpoints.len()).sum::<usize>();
    let remembered =
        [state.participants.len(), state.endpoints.len(), listed, peers.matched.len(), peers.refused.len()];
    let bounds = [
        SMALL_BOUNDS.participants,
        SMALL_BOUNDS.endpoints,
        SMALL_BOUNDS.listed,
        SMALL_BOUNDS.matched,
        SMALL_BOUNDS.refused,
    ];
    assert!(remembered.iter().zip(bounds).all(|(count, bound)| *count <= bound), "{remembered:?}");
    // A list without nodes counts as one listed object.
    assert!(state.nodes.len() <= SMALL_BOUNDS.listed, "{} participants with a node list", state.nodes.len());
    let max_name_bytes = DiscoveryState::MAX_NAME_BYTES;
    assert!(state.endpoints.values().all(|(topic, kind)| topic.len().max(kind.len()) <= max_name_bytes));
    assert!(peers.refused.keys().all(|id| !peers.matched.contains(id)), "matched and refused");
}

proptest! {
    #[test]
    fn any_announcements_stay_within_bounds(events in prop::collection::vec(any_event(), 0..40)) {
        let mut state = DiscoveryState { bounds: SMALL_BOUNDS, ..DiscoveryState::new(id_of(0)) };
        let peers = state.add_local(LOCAL, EndpointRole::Subscription, "a::b_");
        for event in events {
            let (ignored_before, changes_before) = (state.ignored_count(), *state.changes().borrow());
            let has_too_long_name = matches!(
                &event,
                DiscoveryEvent::EndpointDiscovered { topic, type_name, .. }
                    if topic.len().max(type_name.len()) > DiscoveryState::MAX_NAME_BYTES
            );
            let queried = match &event {
                DiscoveryEvent::EndpointDiscovered { id, .. } | DiscoveryEvent::EndpointLost(id) => *id,
                DiscoveryEvent::Matched { remote, .. } | DiscoveryEvent::Incompatible { remote, .. } => *remote,
                _ => REMOTE,
            };
            state.apply(event);
            prop_assert_eq!(*state.changes().borrow(), changes_before + 1);
            prop_assert!(
                !has_too_long_name || state.ignored_count() == ignored_before + 1,
                "an ignored endpoint is counted"
            );
            check_bounds(&state, &peers.borrow());
            // Every query must return.
            let _ = (state.node_of(queried), state.nodes_of(queried.participant()), state.topics());
            let _ = (state.endpoints_of("rt/a"), state.has_other_type(LOCAL, queried));
        }
        for participant in ANNOUNCING_PARTICIPANTS {
            state.apply(DiscoveryEvent::ParticipantLost(id_of(participant)));
        }
        let remaining = peers.borrow();
        prop_assert!(remaining.matched.is_empty() && remaining.refused.is_empty() && remaining.matched_total == remaining.unmatched_total);
        prop_assert!(state.endpoints.is_empty() && state.nodes.is_empty() && state.participants.is_empty());
    }
}
