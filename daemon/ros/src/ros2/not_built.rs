//! The types of the ROS 2 client in a build without ROS 2. They have no values, because no node can be created.

use std::net::IpAddr;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::WallTime;
use tokio::sync::watch;

use super::{
    DiscoveredEndpoint, EndpointId, ParticipantId, PeerTable, QosProfile, ReceiveCounts, ReceivedSample,
    Ros2Error, Ros2Settings, SocketBufferWarning,
};

/// A node of ROS 2, which this build does not have.
pub enum Ros2Node {}

/// A publisher of a topic, which this build does not have.
pub enum Ros2Publisher {}

/// A subscription of a topic, which this build does not have.
pub enum Ros2Subscription {}

impl Ros2Node {
    /// Checks the settings and returns an error.
    ///
    /// # Errors
    ///
    /// Always: [`Ros2Error::NotBuilt`] if the settings are valid.
    pub async fn new(settings: Ros2Settings) -> Result<Self, Ros2Error> {
        settings.with_environment(|name| std::env::var(name).ok())?;
        Err(Ros2Error::NotBuilt)
    }

    /// Returns the settings, completed by the environment variables.
    pub fn settings(&self) -> &Ros2Settings {
        match *self {}
    }

    /// Returns the publishers that other participants have of a topic.
    pub fn publishers_of(&self, _topic: &str) -> Vec<super::DiscoveredPublisher> {
        match *self {}
    }

    /// Returns the endpoints that other participants have of a topic.
    pub fn endpoints_of(&self, _topic: &str) -> Vec<DiscoveredEndpoint> {
        match *self {}
    }

    /// Returns the absolute name of the node that has an endpoint.
    pub fn node_of(&self, _endpoint: EndpointId) -> Option<String> {
        match *self {}
    }

    /// Returns the absolute names of a participant's nodes.
    pub fn nodes_of(&self, _participant: ParticipantId) -> Vec<String> {
        match *self {}
    }

    /// Returns an address of the host of a participant.
    pub fn host_of(&self, _participant: ParticipantId) -> Option<IpAddr> {
        match *self {}
    }

    /// Returns the identity of the node in the domain.
    pub fn id(&self) -> ParticipantId {
        match *self {}
    }

    /// Returns the size of a receive buffer of this host's sockets.
    pub fn receive_buffer_bytes(&self) -> usize {
        match *self {}
    }

    /// Returns a receiver of a number that changes with every event of discovery.
    pub fn discovery_changes(&self) -> watch::Receiver<u64> {
        match *self {}
    }

    /// Returns a description of the domain and the network interfaces.
    pub fn describe_domain(&self) -> String {
        match *self {}
    }

    /// Returns advice for a topic without a publisher.
    pub fn advise(&self) -> String {
        match *self {}
    }

    /// Returns limits of the kernel that are below the requested socket buffers.
    pub fn socket_buffer_warnings(&self) -> &[SocketBufferWarning] {
        match *self {}
    }

    /// Returns the number of other participants of the domain.
    pub fn participant_count(&self) -> usize {
        match *self {}
    }

    /// Creates a publisher of a topic.
    ///
    /// # Errors
    ///
    /// This function is never called.
    pub fn create_publisher(
        &self,
        _topic: &str,
        _type_name: &str,
        _qos: &QosProfile,
    ) -> Result<Ros2Publisher, Ros2Error> {
        match *self {}
    }

    /// Creates a subscription of a topic.
    ///
    /// # Errors
    ///
    /// This function is never called.
    pub fn create_subscription(
        &self,
        _topic: &str,
        _type_name: &str,
        _qos: &QosProfile,
    ) -> Result<Ros2Subscription, Ros2Error> {
        match *self {}
    }

    /// Leaves the domain.
    ///
    /// # Errors
    ///
    /// This function is never called.
    pub async fn shut_down(self) -> Result<(), Ros2Error> {
        match self {}
    }
}

impl Ros2Publisher {
    /// Publishes a message and returns its sequence number.
    ///
    /// # Errors
    ///
    /// This function is never called.
    pub async fn publish(&self, _payload: Bytes, _source_time: WallTime) -> Result<i64, Ros2Error> {
        match *self {}
    }

    /// Publishes a message. Never waits.
    pub fn try_publish(&self, _payload: Bytes, _source_time: WallTime) -> Result<Option<i64>, Ros2Error> {
        match *self {}
    }

    /// Treats all messages so far as acknowledged.
    pub fn forget_unacknowledged(&self) {
        match *self {}
    }

    /// Waits until all matched reliable subscriptions have acknowledged all published messages.
    ///
    /// # Errors
    ///
    /// This function is never called.
    pub async fn wait_for_acknowledgment(&self, _time_limit: Duration) -> Result<(), Ros2Error> {
        match *self {}
    }
}

impl Ros2Subscription {
    /// Returns the counts of received and lost messages.
    pub fn counts(&self) -> ReceiveCounts {
        match *self {}
    }

    /// Waits for the next message.
    ///
    /// # Errors
    ///
    /// This function is never called.
    pub async fn receive(&mut self) -> Result<ReceivedSample, Ros2Error> {
        match *self {}
    }
}

macro_rules! endpoint {
    ($($endpoint:ident),*) => {$(
        impl $endpoint {
            /// Returns the identity of the endpoint.
            pub fn id(&self) -> EndpointId {
                match *self {}
            }

            /// Returns the absolute name of the topic.
            pub fn topic(&self) -> &str {
                match *self {}
            }

            /// Returns a receiver of the peers on the topic and their changes.
            pub fn peers(&self) -> watch::Receiver<PeerTable> {
                match *self {}
            }

            /// Waits for a peer on the topic.
            ///
            /// # Errors
            ///
            /// This function is never called.
            pub async fn wait_for_peer(&self, _time_limit: Duration) -> Result<(), Ros2Error> {
                match *self {}
            }
        }
    )*};
}

endpoint!(Ros2Publisher, Ros2Subscription);

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn node_without_ros2_support_returns_error() {
        let error = Ros2Node::new(Ros2Settings::default()).await.err().expect("no ROS 2");
        assert!(error.to_string().contains("cargo feature `ros2`"), "{error}");
        let settings = Ros2Settings { domain_id: Some(300), ..Ros2Settings::default() };
        let error = Ros2Node::new(settings).await.err().expect("no such domain");
        assert!(error.to_string().contains("the domain 300"), "{error}");
    }
}
