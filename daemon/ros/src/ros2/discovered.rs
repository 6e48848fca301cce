//! Endpoints of other participants, as discovery found them.

use std::net::IpAddr;

use super::{EndpointId, EndpointRole};

/// A publisher of another participant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DiscoveredPublisher {
    /// Identity.
    pub id: EndpointId,
    /// Message type, such as `std_msgs/msg/String`.
    pub type_name: String,
    /// Address of the publisher's host; `None` for this host.
    pub host: Option<IpAddr>,
    /// Absolute name of the publisher's node, such as `/robot1/camera`, if the participant has listed the node.
    pub node: Option<String>,
}

/// A publisher or subscription of another participant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DiscoveredEndpoint {
    /// Identity.
    pub id: EndpointId,
    /// Role on the topic.
    pub role: EndpointRole,
    /// Message type, such as `std_msgs/msg/String`.
    pub type_name: String,
    /// Absolute name of the endpoint's node, if the participant has listed the node.
    pub node: Option<String>,
}

impl DiscoveredPublisher {
    /// Returns the name of the publisher's node, or the identity of the publisher if the name is unknown.
    pub fn name(&self) -> String {
        self.node.clone().unwrap_or_else(|| format!("publisher {}", self.id))
    }
}

/// Returns an address of the host that announces `addresses`; `None` for the host whose addresses are `own_addresses`.
///
/// A program only announces addresses of the host that it runs on. Another host may announce some addresses that this
/// host has as well, such as the address of a bridge of containers, but never only such addresses.
#[cfg(any(feature = "ros2", test))]
pub(super) fn other_host(addresses: &[IpAddr], own_addresses: &[IpAddr]) -> Option<IpAddr> {
    let is_host_address =
        |address: &&IpAddr| !address.is_unspecified() && !address.is_multicast() && !address.is_loopback();
    addresses.iter().filter(is_host_address).find(|address| !own_addresses.contains(address)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_address_means_another_host() {
        let addresses = |list: &[&str]| -> Vec<IpAddr> {
            list.iter().map(|address| address.parse().expect("an address")).collect()
        };
        let own_addresses = addresses(&["127.0.0.1", "10.0.0.1", "172.17.0.1", "fe80::1"]);
        let host =
            |list: &[&str]| other_host(&addresses(list), &own_addresses).map(|address| address.to_string());
        assert_eq!(host(&["10.0.0.1", "127.0.0.1", "172.17.0.1"]), None);
        assert_eq!(host(&["172.17.0.1", "10.0.0.2"]).as_deref(), Some("10.0.0.2"));
        assert_eq!(host(&["127.0.0.1", "239.255.0.1", "0.0.0.0"]), None);
        assert_eq!(host(&["fe80::2"]).as_deref(), Some("fe80::2"));
    }
}
