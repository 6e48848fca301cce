//! What discovery has found out about the domain, as a state machine without I/O.

use std::collections::{BTreeMap, BTreeSet};

use tokio::sync::watch;

use crate::ros2::names::ros_type;
use crate::ros2::{EndpointId, EndpointRole, FoundEndpoint, ParticipantId, PeerTable, Refusal};

/// Something that discovery found out.
#[derive(Clone, Debug)]
pub(super) enum DiscoveryEvent {
    ParticipantFound(ParticipantId),
    ParticipantGone(ParticipantId),
    EndpointFound { id: EndpointId, topic: String, type_name: String },
    EndpointGone(EndpointId),
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

    pub(super) fn new(own: ParticipantId) -> Self {
        let (participants, endpoints, local) = (BTreeSet::new(), BTreeMap::new(), BTreeMap::new());
        Self { own, participants, endpoints, local, changes: watch::Sender::default() }
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
            Some(FoundEndpoint { id: *id, role: id.role()?, type_name: ros_type(type_name) })
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
                if id != self.own {
                    self.participants.insert(id);
                }
            }
            DiscoveryEvent::ParticipantGone(id) => {
                self.participants.remove(&id);
                self.forget(|endpoint| endpoint.participant() == id);
            }
            DiscoveryEvent::EndpointFound { id, topic, type_name } => {
                if self.endpoints.len() < Self::MAX_ENDPOINTS || self.endpoints.contains_key(&id) {
                    self.endpoints.insert(id, (topic, type_name));
                }
            }
            DiscoveryEvent::EndpointGone(id) => self.forget(|endpoint| endpoint == id),
            DiscoveryEvent::Matched { local, remote } => {
                let refusal = self
                    .other_type(local, remote)
                    .map(|type_name| Refusal::OtherType { type_name: ros_type(type_name) });
                self.update(local, |peers| match refusal {
                    Some(refusal) => peers.refused.insert(remote, refusal).is_none(),
                    None => peers.add(remote),
                });
            }
            DiscoveryEvent::Incompatible { local, remote, refusal } => {
                self.update(local, |peers| {
                    peers.remove(remote);
                    peers.refused.insert(remote, refusal);
                    true
                });
            }
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
