//! State machine of discovery without I/O: the participants and endpoints of the domain, and the peers of our
//! endpoints.

use std::collections::{BTreeMap, BTreeSet};

use tokio::sync::watch;

use super::names::ros_type;
use super::node_list::{ListEntry, ListedNode};
use super::{DiscoveredEndpoint, EndpointId, EndpointRole, ParticipantId, PeerTable, Refusal};

/// Event of discovery.
#[derive(Clone, Debug)]
pub(super) enum DiscoveryEvent {
    ParticipantDiscovered(ParticipantId),
    ParticipantLost(ParticipantId),
    EndpointDiscovered { id: EndpointId, topic: String, type_name: String },
    EndpointLost(EndpointId),
    NodesListed(ListEntry),
    Matched { local: EndpointId, remote: EndpointId },
    Incompatible { local: EndpointId, remote: EndpointId, refusal: Refusal },
}

/// State of the domain as one node sees it.
#[derive(Debug)]
pub(super) struct DiscoveryState {
    /// Identity of our participant.
    own_id: ParticipantId,
    /// Other participants.
    participants: BTreeSet<ParticipantId>,
    /// DDS names of the topic and of the type of every endpoint in the domain.
    endpoints: BTreeMap<EndpointId, (String, String)>,
    /// Nodes of other participants, as these list them.
    nodes: BTreeMap<ParticipantId, Vec<ListedNode>>,
    /// Number of discovered objects that were not remembered because a limit was reached.
    ignored_count: u64,
    /// Our endpoints.
    local: BTreeMap<EndpointId, LocalEndpoint>,
    /// Sender of the number of events so far.
    changes: watch::Sender<u64>,
    bounds: DiscoveryBounds,
}

/// Maximum numbers of remembered objects. There are limits because every host on the network can announce objects.
#[derive(Clone, Copy, Debug)]
struct DiscoveryBounds {
    /// Other participants.
    participants: usize,
    /// Endpoints in the domain.
    endpoints: usize,
    /// Nodes in the node list, and their endpoints.
    listed: usize,
    /// Matched peers of one endpoint.
    matched: usize,
    /// Refused peers of one endpoint.
    refused: usize,
}

impl Default for DiscoveryBounds {
    fn default() -> Self {
        Self { participants: 4_096, endpoints: 16_384, listed: 16_384, matched: 4_096, refused: 1_024 }
    }
}

/// One of our endpoints.
#[derive(Debug)]
struct LocalEndpoint {
    role: EndpointRole,
    /// DDS name of the type.
    type_name: String,
    /// Table of the peers, which discovery updates.
    peers: watch::Sender<PeerTable>,
}

impl DiscoveryState {
    /// Longest name of a topic or type that is stored, bytes. Names in DDS have at most 255 bytes.
    const MAX_NAME_BYTES: usize = 1_024;

    pub(super) fn new(own_id: ParticipantId) -> Self {
        Self {
            own_id,
            participants: BTreeSet::new(),
            endpoints: BTreeMap::new(),
            nodes: BTreeMap::new(),
            ignored_count: 0,
            local: BTreeMap::new(),
            changes: watch::Sender::default(),
            bounds: DiscoveryBounds::default(),
        }
    }

    /// Returns the number of discovered objects that were not remembered because a limit was reached.
    pub(super) fn ignored_count(&self) -> u64 {
        self.ignored_count
    }

    /// Returns the absolute name of the node that has an endpoint, if its participant has listed it.
    pub(super) fn node_of(&self, endpoint: EndpointId) -> Option<&str> {
        let nodes = self.nodes.get(&endpoint.participant())?;
        let listed = nodes.iter().find(|node| node.endpoints.contains(&endpoint));
        // An endpoint that is newer than the list belongs to the participant's node if there is only one.
        let single_node = || nodes.first().filter(|_| nodes.len() == 1);
        listed.or_else(single_node).map(|node| node.name.as_str())
    }

    /// Returns the absolute names of a participant's nodes, if it has listed them.
    pub(super) fn nodes_of(&self, participant: ParticipantId) -> Vec<String> {
        let nodes = self.nodes.get(&participant);
        nodes.into_iter().flatten().map(|node| node.name.clone()).collect()
    }

    /// Returns a receiver of the number of events. The number changes after each applied event.
    pub(super) fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    /// Adds one of our endpoints. Returns the table of its peers, which discovery updates.
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

    /// Returns the number of other participants.
    pub(super) fn participant_count(&self) -> usize {
        self.participants.len()
    }

    /// Returns the absolute names of the ROS 2 topics of other participants.
    pub(super) fn topics(&self) -> Vec<String> {
        let remote_endpoints = self.endpoints.iter().filter(|(id, _)| id.participant() != self.own_id);
        let names: BTreeSet<&str> = remote_endpoints
            .filter_map(|(_, (topic, _))| topic.strip_prefix("rt").filter(|name| name.starts_with('/')))
            .collect();
        names.into_iter().map(str::to_owned).collect()
    }

    /// Returns the endpoints that other participants have of a topic, by its DDS name.
    pub(super) fn endpoints_of(&self, dds_topic: &str) -> Vec<DiscoveredEndpoint> {
        let topic_endpoints = self
            .endpoints
            .iter()
            .filter(|(id, (topic, _))| topic == dds_topic && id.participant() != self.own_id);
        let endpoints = topic_endpoints.filter_map(|(id, (_, type_name))| {
            let node = self.node_of(*id).map(str::to_owned);
            Some(DiscoveredEndpoint { id: *id, role: id.role()?, type_name: ros_type(type_name), node })
        });
        endpoints.collect()
    }

    /// Returns whether a remote endpoint has another type than one of our endpoints of the same topic. This must be
    /// checked because `rustdds` matches by the name of the topic alone.
    pub(super) fn has_other_type(&self, local: EndpointId, remote: EndpointId) -> bool {
        self.other_type(local, remote).is_some()
    }

    fn other_type(&self, local: EndpointId, remote: EndpointId) -> Option<&str> {
        let (_, remote_type) = self.endpoints.get(&remote)?;
        let local = self.local.get(&local)?;
        (*remote_type != local.type_name).then_some(remote_type.as_str())
    }

    /// Applies an event.
    pub(super) fn apply(&mut self, event: DiscoveryEvent) {
        self.update_state(event);
        self.changes.send_modify(|count| *count = count.wrapping_add(1));
    }

    fn update_state(&mut self, event: DiscoveryEvent) {
        match event {
            DiscoveryEvent::ParticipantDiscovered(id) => {
                if id == self.own_id || self.participants.contains(&id) {
                } else if self.participants.len() < self.bounds.participants {
                    self.participants.insert(id);
                } else {
                    self.ignored_count += 1;
                }
            }
            DiscoveryEvent::ParticipantLost(id) => {
                self.participants.remove(&id);
                self.nodes.remove(&id);
                self.remove_endpoints(|endpoint| endpoint.participant() == id);
            }
            DiscoveryEvent::EndpointDiscovered { id, topic, type_name } => {
                let has_space =
                    self.endpoints.len() < self.bounds.endpoints || self.endpoints.contains_key(&id);
                // Names beyond the limit of DDS are forged, and would only take memory.
                if has_space && topic.len().max(type_name.len()) <= Self::MAX_NAME_BYTES {
                    self.endpoints.insert(id, (topic, type_name));
                } else {
                    self.ignored_count += 1;
                }
            }
            DiscoveryEvent::NodesListed(entry) => self.replace_nodes(entry),
            DiscoveryEvent::EndpointLost(id) => self.remove_endpoints(|endpoint| endpoint == id),
            DiscoveryEvent::Matched { local, remote } => {
                let refusal = self
                    .other_type(local, remote)
                    .map(|type_name| Refusal::OtherType { type_name: ros_type(type_name) });
                match refusal {
                    Some(refusal) => self.refuse(local, remote, refusal),
                    None => self.match_peer(local, remote),
                }
            }
            DiscoveryEvent::Incompatible { local, remote, refusal } => {
                self.refuse(local, remote, refusal);
            }
        }
    }

    fn match_peer(&mut self, local: EndpointId, remote: EndpointId) {
        let (limit, mut has_space) = (self.bounds.matched, true);
        self.update_peers(local, |peers| {
            has_space = peers.matched.len() < limit || peers.matched.contains(&remote);
            has_space && peers.add(remote)
        });
        self.ignored_count += u64::from(!has_space);
    }

    fn refuse(&mut self, local: EndpointId, remote: EndpointId, refusal: Refusal) {
        let (limit, mut has_space) = (self.bounds.refused, true);
        self.update_peers(local, |peers| {
            peers.remove(remote);
            has_space = peers.refused.len() < limit;
            if has_space {
                peers.refused.insert(remote, refusal);
            }
            // Receivers are notified even if there is no space, because the peer may no longer be matched.
            true
        });
        self.ignored_count += u64::from(!has_space);
    }

    /// Replaces the listed nodes of a participant.
    fn replace_nodes(&mut self, ListEntry { participant, nodes }: ListEntry) {
        if participant == self.own_id {
            return;
        }
        // A node takes memory even without endpoints, and a list even without nodes.
        let size =
            |nodes: &[ListedNode]| nodes.iter().map(|node| 1 + node.endpoints.len()).sum::<usize>().max(1);
        self.nodes.remove(&participant);
        let listed_count =
            |lists: &BTreeMap<_, Vec<ListedNode>>| lists.values().map(|nodes| size(nodes)).sum::<usize>();
        if listed_count(&self.nodes) + size(&nodes) > self.bounds.listed {
            // Lists of participants that discovery does not know may be forged, so they are dropped first.
            self.nodes.retain(|participant, _| self.participants.contains(participant));
        }
        if listed_count(&self.nodes) + size(&nodes) > self.bounds.listed {
            self.ignored_count += 1;
        } else {
            self.nodes.insert(participant, nodes);
        }
    }

    /// Changes the peers of one of our endpoints. Receivers of the peers are notified if `change` returns `true`.
    fn update_peers(&self, local: EndpointId, change: impl FnOnce(&mut PeerTable) -> bool) {
        if let Some(endpoint) = self.local.get(&local) {
            endpoint.peers.send_if_modified(change);
        }
    }

    fn remove_endpoints(&mut self, is_lost: impl Fn(EndpointId) -> bool) {
        self.endpoints.retain(|id, _| !is_lost(*id));
        for endpoint in self.local.values() {
            endpoint.peers.send_if_modified(|peers| {
                let lost: Vec<EndpointId> = peers
                    .matched
                    .iter()
                    .chain(peers.refused.keys())
                    .copied()
                    .filter(|id| is_lost(*id))
                    .collect();
                lost.iter().for_each(|id| peers.remove(*id));
                !lost.is_empty()
            });
        }
    }
}

#[cfg(test)]
mod tests;
