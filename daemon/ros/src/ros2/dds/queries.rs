//! Queries of a node about the other participants of its domain.

use std::net::{IpAddr, SocketAddr};

use rustdds::discovery::DiscoveredWriterData;
use tokio::sync::watch;

use super::conversions::endpoint_id;
use super::interfaces::own_addresses;
use super::node::Ros2Node;
use crate::ros2::discovered::other_host;
use crate::ros2::error::advise;
use crate::ros2::names::{dds_topic, ros_type};
use crate::ros2::{DiscoveredEndpoint, DiscoveredPublisher, EndpointId, ParticipantId};

impl Ros2Node {
    /// Returns the publishers that other participants have of a topic, by its absolute name, in the order of their
    /// identities.
    pub fn publishers_of(&self, topic: &str) -> Vec<DiscoveredPublisher> {
        let Some(entities) = &self.entities else { return Vec::new() };
        let topic = dds_topic(topic);
        let own_addresses = own_addresses().unwrap_or_else(|error| {
            tracing::warn!(%error, "cannot list the addresses of this host; its publishers count as publishers of another host");
            Vec::new()
        });
        let writers = entities.participant.discovered_writers().into_iter();
        let topic_writers = writers.filter(|writer| writer.publication_topic_data.topic_name == topic);
        let mut publishers: Vec<DiscoveredPublisher> =
            topic_writers.map(|writer| discovered_publisher(&writer, &own_addresses)).collect();
        publishers.sort_by_key(|publisher| publisher.id);
        for publisher in &mut publishers {
            publisher.node = self.node_of(publisher.id);
        }
        publishers
    }

    /// Returns the absolute name of the node that has an endpoint, if its participant has listed it.
    pub fn node_of(&self, endpoint: EndpointId) -> Option<String> {
        self.state.discovery().node_of(endpoint).map(str::to_owned)
    }

    /// Returns the absolute names of a participant's nodes, if it has listed them.
    pub fn nodes_of(&self, participant: ParticipantId) -> Vec<String> {
        self.state.discovery().nodes_of(participant)
    }

    /// Returns the endpoints that other participants have of a topic, by its absolute name.
    pub fn endpoints_of(&self, topic: &str) -> Vec<DiscoveredEndpoint> {
        self.state.discovery().endpoints_of(&dds_topic(topic))
    }

    /// Returns an address of the host on which a participant runs; `None` for this host, and for a participant that has
    /// no known publisher.
    pub fn host_of(&self, participant: ParticipantId) -> Option<IpAddr> {
        let own_addresses = own_addresses().unwrap_or_default();
        let writers = self.entities.as_ref()?.participant.discovered_writers().into_iter();
        let mut participant_writers = writers.filter(|writer| {
            endpoint_id(writer.writer_proxy.remote_writer_guid).participant() == participant
        });
        participant_writers.find_map(|writer| discovered_publisher(&writer, &own_addresses).host)
    }

    /// Returns a receiver of a number that changes with every event of discovery.
    pub fn discovery_changes(&self) -> watch::Receiver<u64> {
        self.state.discovery().changes()
    }

    /// Returns a description of the domain and the network interfaces, such as `domain 7 on lo (127.0.0.1)`.
    pub fn describe_domain(&self) -> String {
        format!("domain {} on {}", self.state.domain_id, self.state.interfaces)
    }

    /// Returns advice for a topic without a publisher.
    pub fn advise(&self) -> String {
        let discovery = self.state.discovery();
        let (participants, topics) = (discovery.participant_count(), discovery.topics());
        advise(self.state.domain_id, &self.state.interfaces, participants, &topics)
    }
}

fn discovered_publisher(writer: &DiscoveredWriterData, own_addresses: &[IpAddr]) -> DiscoveredPublisher {
    let proxy = &writer.writer_proxy;
    // Locators of shared memory, which is on this host, become the unspecified address, which `other_host` ignores.
    let addresses: Vec<IpAddr> =
        proxy.unicast_locator_list.iter().map(|locator| SocketAddr::from(*locator).ip()).collect();
    DiscoveredPublisher {
        id: endpoint_id(proxy.remote_writer_guid),
        type_name: ros_type(&writer.publication_topic_data.type_name),
        host: other_host(&addresses, own_addresses),
        node: None,
    }
}
