//! What discovery has found out about the domain, as a state machine without I/O.

use std::collections::{BTreeMap, BTreeSet};

use tokio::sync::watch;

use super::names::ros_type;
use super::node_list::{ListEntry, ListedNode};
use super::{EndpointId, EndpointRole, FoundEndpoint, ParticipantId, PeerTable, Refusal};

/// Something that discovery found out.
#[derive(Clone, Debug)]
pub(super) enum DiscoveryEvent {
    ParticipantFound(ParticipantId),
    ParticipantGone(ParticipantId),
    EndpointFound { id: EndpointId, topic: String, type_name: String },
    EndpointGone(EndpointId),
    NodesListed(ListEntry),
    Matched { local: EndpointId, remote: EndpointId },
    Incompatible { local: EndpointId, remote: EndpointId, refusal: Refusal },
}

/// The domain as one node sees it.
#[derive(Debug)]
pub(super) struct DiscoveryState {
    own: ParticipantId,
    participants: BTreeSet<ParticipantId>,
    /// DDS names of the topic and the type of every endpoint in the domain.
    endpoints: BTreeMap<EndpointId, (String, String)>,
    /// The nodes of other participants, as they list them.
    nodes: BTreeMap<ParticipantId, Vec<ListedNode>>,
    /// What was found and not remembered, because a bound was reached.
    ignored: u64,
    local: BTreeMap<EndpointId, LocalEndpoint>,
    /// Number of events so far.
    changes: watch::Sender<u64>,
}

#[derive(Debug)]
struct LocalEndpoint {
    role: EndpointRole,
    /// DDS name.
    type_name: String,
    peers: watch::Sender<PeerTable>,
}

impl DiscoveryState {
    /// Most endpoints of others that are remembered: anybody on the network can announce more.
    const MAX_ENDPOINTS: usize = 16_384;

    /// Most other participants that are remembered.
    const MAX_PARTICIPANTS: usize = 4_096;

    /// Most endpoints that are remembered by the nodes which list them.
    const MAX_LISTED: usize = 16_384;

    /// Most refused peers of one endpoint that are remembered.
    const MAX_REFUSED: usize = 1_024;

    /// Longest name of a topic or type that is remembered. Bytes; DDS has names of 255.
    const MAX_NAME_BYTES: usize = 1_024;

    pub(super) fn new(own: ParticipantId) -> Self {
        Self {
            own,
            participants: BTreeSet::new(),
            endpoints: BTreeMap::new(),
            nodes: BTreeMap::new(),
            ignored: 0,
            local: BTreeMap::new(),
            changes: watch::Sender::default(),
        }
    }

    /// Returns how much was found and not remembered, because a bound was reached.
    pub(super) fn ignored(&self) -> u64 {
        self.ignored
    }

    /// Returns the absolute name of the node that has an endpoint, if its participant has told.
    pub(super) fn node_of(&self, endpoint: EndpointId) -> Option<&str> {
        let nodes = self.nodes.get(&endpoint.participant())?;
        let listed = nodes.iter().find(|node| node.endpoints.contains(&endpoint));
        // An endpoint that is newer than the list is of the participant's only node, if it has only one.
        let only = || nodes.first().filter(|_| nodes.len() == 1);
        listed.or_else(only).map(|node| node.name.as_str())
    }

    /// Returns the absolute names of a participant's nodes, as far as it has told.
    pub(super) fn nodes_of(&self, participant: ParticipantId) -> Vec<String> {
        let nodes = self.nodes.get(&participant);
        nodes.into_iter().flatten().map(|node| node.name.clone()).collect()
    }

    /// Returns the number of events so far, which changes after each of them was recorded.
    pub(super) fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    /// Adds an endpoint of our own; returns the table of its peers, which changes with what discovery finds out.
    pub(super) fn add_local(
        &mut self,
        id: EndpointId,
        role: EndpointRole,
        dds_type: &str,
    ) -> watch::Receiver<PeerTable> {
        let (peers, receiver) = watch::channel(PeerTable::default());
        self.local.insert(id, LocalEndpoint { role, type_name: dds_type.to_owned(), peers });
        receiver
    }

    pub(super) fn remove_local(&mut self, id: EndpointId) {
        self.local.remove(&id);
    }

    /// Returns our endpoints.
    pub(super) fn local_endpoints(&self) -> Vec<(EndpointRole, EndpointId)> {
        self.local.iter().map(|(id, endpoint)| (endpoint.role, *id)).collect()
    }

    /// Returns how many other participants are there.
    pub(super) fn participants(&self) -> usize {
        self.participants.len()
    }

    /// Returns the absolute names of the topics of ROS 2 that others are on.
    pub(super) fn topics(&self) -> Vec<String> {
        let others = self.endpoints.iter().filter(|(id, _)| id.participant() != self.own);
        let names: BTreeSet<&str> = others
            .filter_map(|(_, (topic, _))| topic.strip_prefix("rt").filter(|name| name.starts_with('/')))
            .collect();
        names.into_iter().map(str::to_owned).collect()
    }

    /// Returns the endpoints that others have of a topic, by its DDS name.
    pub(super) fn endpoints_of(&self, dds_topic: &str) -> Vec<FoundEndpoint> {
        let of_topic = self
            .endpoints
            .iter()
            .filter(|(id, (topic, _))| topic == dds_topic && id.participant() != self.own);
        let found = of_topic.filter_map(|(id, (_, type_name))| {
            let node = self.node_of(*id).map(str::to_owned);
            Some(FoundEndpoint { id: *id, role: id.role()?, type_name: ros_type(type_name), node })
        });
        found.collect()
    }

    /// Whether a publisher gives the topic of one of our subscriptions another type. `rustdds` matches by the name of
    /// the topic alone.
    pub(super) fn is_other_type(&self, local: EndpointId, remote: EndpointId) -> bool {
        self.other_type(local, remote).is_some()
    }

    fn other_type(&self, local: EndpointId, remote: EndpointId) -> Option<&str> {
        let (_, remote_type) = self.endpoints.get(&remote)?;
        let local = self.local.get(&local)?;
        (*remote_type != local.type_name).then_some(remote_type.as_str())
    }

    /// Records what discovery found out.
    pub(super) fn apply(&mut self, event: DiscoveryEvent) {
        self.record(event);
        self.changes.send_modify(|count| *count = count.wrapping_add(1));
    }

    fn record(&mut self, event: DiscoveryEvent) {
        match event {
            DiscoveryEvent::ParticipantFound(id) => {
                if id == self.own || self.participants.contains(&id) {
                } else if self.participants.len() < Self::MAX_PARTICIPANTS {
                    self.participants.insert(id);
                } else {
                    self.ignored += 1;
                }
            }
            DiscoveryEvent::ParticipantGone(id) => {
                self.participants.remove(&id);
                self.nodes.remove(&id);
                self.forget(|endpoint| endpoint.participant() == id);
            }
            DiscoveryEvent::EndpointFound { id, topic, type_name } => {
                let has_room = self.endpoints.len() < Self::MAX_ENDPOINTS || self.endpoints.contains_key(&id);
                if has_room && topic.len().max(type_name.len()) <= Self::MAX_NAME_BYTES {
                    self.endpoints.insert(id, (topic, type_name));
                } else {
                    self.ignored += 1;
                }
            }
            DiscoveryEvent::NodesListed(entry) => self.list(entry),
            DiscoveryEvent::EndpointGone(id) => self.forget(|endpoint| endpoint == id),
            DiscoveryEvent::Matched { local, remote } => {
                let refusal = self
                    .other_type(local, remote)
                    .map(|type_name| Refusal::OtherType { type_name: ros_type(type_name) });
                match refusal {
                    Some(refusal) => self.refuse(local, remote, refusal),
                    None => self.update(local, |peers| peers.add(remote)),
                }
            }
            DiscoveryEvent::Incompatible { local, remote, refusal } => {
                self.update(local, |peers| {
                    peers.remove(remote);
                    true
                });
                self.refuse(local, remote, refusal);
            }
        }
    }

    fn refuse(&mut self, local: EndpointId, remote: EndpointId, refusal: Refusal) {
        let mut has_room = true;
        self.update(local, |peers| {
            has_room = peers.refused.len() < Self::MAX_REFUSED || peers.refused.contains_key(&remote);
            has_room && peers.refused.insert(remote, refusal).is_none()
        });
        self.ignored += u64::from(!has_room);
    }

    /// Remembers the nodes of a participant, instead of those that it listed before.
    fn list(&mut self, ListEntry { participant, nodes }: ListEntry) {
        if participant == self.own {
            return;
        }
        // A node takes memory also without endpoints.
        let size =
            |nodes: &[ListedNode]| nodes.iter().map(|node| 1 + node.endpoints.len()).sum::<usize>().max(1);
        self.nodes.remove(&participant);
        let listed =
            |all: &BTreeMap<_, Vec<ListedNode>>| all.values().map(|nodes| size(nodes)).sum::<usize>();
        if listed(&self.nodes) + size(&nodes) > Self::MAX_LISTED {
            // Those that nothing else is known of may be invented.
            self.nodes.retain(|participant, _| self.participants.contains(participant));
        }
        if listed(&self.nodes) + size(&nodes) > Self::MAX_LISTED {
            self.ignored += 1;
        } else {
            self.nodes.insert(participant, nodes);
        }
    }

    fn update(&self, local: EndpointId, change: impl FnOnce(&mut PeerTable) -> bool) {
        if let Some(endpoint) = self.local.get(&local) {
            endpoint.peers.send_if_modified(change);
        }
    }

    fn forget(&mut self, is_gone: impl Fn(EndpointId) -> bool) {
        self.endpoints.retain(|id, _| !is_gone(*id));
        for endpoint in self.local.values() {
            endpoint.peers.send_if_modified(|peers| {
                let gone: Vec<EndpointId> = peers
                    .matched
                    .iter()
                    .chain(peers.refused.keys())
                    .copied()
                    .filter(|id| is_gone(*id))
                    .collect();
                gone.iter().for_each(|id| peers.remove(*id));
                !gone.is_empty()
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOCAL: EndpointId = EndpointId([1; 16]);
    const REMOTE: EndpointId = EndpointId([2; 16]);

    fn state() -> (DiscoveryState, watch::Receiver<PeerTable>) {
        let mut state = DiscoveryState::new(ParticipantId([1; 12]));
        let peers = state.add_local(LOCAL, EndpointRole::Subscription, "std_msgs::msg::dds_::String_");
        (state, peers)
    }

    fn found(type_name: &str) -> DiscoveryEvent {
        DiscoveryEvent::EndpointFound { id: REMOTE, topic: "rt/chatter".into(), type_name: type_name.into() }
    }

    #[test]
    fn peer_is_matched_until_its_participant_is_gone() {
        let (mut state, peers) = state();
        state.apply(DiscoveryEvent::ParticipantFound(ParticipantId([2; 12])));
        state.apply(DiscoveryEvent::ParticipantFound(ParticipantId([1; 12])));
        assert_eq!(state.participants(), 1, "our own participant is no other one");
        state.apply(found("std_msgs::msg::dds_::String_"));
        state.apply(DiscoveryEvent::Matched { local: LOCAL, remote: REMOTE });
        assert!(peers.borrow().matched.contains(&REMOTE));
        assert_eq!(state.topics(), ["/chatter"]);
        state.apply(DiscoveryEvent::ParticipantGone(ParticipantId([2; 12])));
        let expected = PeerTable { matched_total: 1, unmatched_total: 1, ..PeerTable::default() };
        assert_eq!((*peers.borrow()).clone(), expected);
        assert_eq!((state.participants(), state.topics().len()), (0, 0));
    }

    #[test]
    fn peer_of_another_type_is_refused() {
        let (mut state, peers) = state();
        state.apply(found("std_msgs::msg::dds_::Int32_"));
        state.apply(DiscoveryEvent::Matched { local: LOCAL, remote: REMOTE });
        let refusal = Refusal::OtherType { type_name: "std_msgs/msg/Int32".into() };
        assert_eq!(peers.borrow().refused.get(&REMOTE), Some(&refusal));
        assert!(peers.borrow().matched.is_empty());
        assert!(state.is_other_type(LOCAL, REMOTE));
        state.apply(DiscoveryEvent::EndpointGone(REMOTE));
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
        state.apply(found("std_msgs::msg::dds_::String_"));
        state.apply(DiscoveryEvent::Incompatible { local: LOCAL, remote: REMOTE, refusal: refusal.clone() });
        assert_eq!(peers.borrow().refused.get(&REMOTE), Some(&refusal));
        state.apply(DiscoveryEvent::Matched { local: LOCAL, remote: REMOTE });
        assert!(peers.borrow().refused.is_empty() && peers.borrow().matched.contains(&REMOTE));
    }

    fn listed(name: &str, endpoints: &[EndpointId]) -> ListedNode {
        ListedNode { name: name.into(), endpoints: endpoints.to_vec() }
    }

    #[test]
    fn endpoint_has_the_name_of_its_node() {
        let (mut state, _) = state();
        let participant = REMOTE.participant();
        let other = EndpointId([[2; 12].as_slice(), &[9; 4]].concat().try_into().unwrap());
        let nodes = vec![listed("/camera", &[REMOTE]), listed("/lidar", &[])];
        state.apply(DiscoveryEvent::NodesListed(ListEntry { participant, nodes }));
        assert_eq!((state.node_of(REMOTE), state.node_of(other)), (Some("/camera"), None));
        assert_eq!(state.nodes_of(participant), ["/camera", "/lidar"]);
        let nodes = vec![listed("/camera2", &[REMOTE])];
        state.apply(DiscoveryEvent::NodesListed(ListEntry { participant, nodes }));
        assert_eq!(state.node_of(other), Some("/camera2"), "the only node of its participant");
        state.apply(DiscoveryEvent::ParticipantGone(participant));
        assert_eq!(state.node_of(REMOTE), None);
    }

    #[test]
    fn invented_node_lists_make_room_for_real_ones() {
        let (mut state, _) = state();
        let list = |number: u32, state: &mut DiscoveryState| {
            let mut participant = [7; 12];
            participant[..4].copy_from_slice(&number.to_le_bytes());
            let (participant, nodes) = (ParticipantId(participant), vec![listed("/node", &[REMOTE; 99])]);
            state.apply(DiscoveryEvent::NodesListed(ListEntry { participant, nodes }));
            participant
        };
        for number in 0..2_000 {
            list(number, &mut state);
        }
        let real = ParticipantId([2; 12]);
        state.apply(DiscoveryEvent::ParticipantFound(real));
        state.apply(DiscoveryEvent::NodesListed(ListEntry {
            participant: real,
            nodes: vec![listed("/camera", &[REMOTE])],
        }));
        for number in 2_000..4_000 {
            list(number, &mut state);
        }
        assert_eq!(state.node_of(REMOTE), Some("/camera"));
        assert!(state.nodes.len() <= DiscoveryState::MAX_LISTED / 100 + 1, "{}", state.nodes.len());
    }

    #[test]
    fn endpoints_of_others_are_found_by_topic_and_role() {
        let (mut state, _) = state();
        for (last, topic) in [(0x03, "rt/a"), (0x04, "rt/a"), (0x04, "rt/b"), (0x00, "rt/a")] {
            let mut id = REMOTE;
            id.0[15] = last;
            id.0[14] = topic.as_bytes()[3];
            let (topic, type_name) = (topic.to_owned(), "std_msgs::msg::dds_::String_".to_owned());
            state.apply(DiscoveryEvent::EndpointFound {
                id,
                topic: topic.clone(),
                type_name: type_name.clone(),
            });
            state.apply(DiscoveryEvent::EndpointFound { id: LOCAL, topic, type_name });
        }
        let found = state.endpoints_of("rt/a");
        assert!(found.iter().all(|endpoint| endpoint.type_name == "std_msgs/msg/String"));
        let roles: Vec<EndpointRole> = found.iter().map(|endpoint| endpoint.role).collect();
        assert_eq!(roles, [EndpointRole::Publisher, EndpointRole::Subscription]);
    }
}
