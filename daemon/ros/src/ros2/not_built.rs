//! The types of the ROS 2 client in a build without ROS 2. They have no values, because no node can be made.

use std::net::IpAddr;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::WallTime;
use tokio::sync::watch;

use super::{
    EndpointId, FoundEndpoint, ParticipantId, PeerTable, QosProfile, ReceiveCounts, ReceivedSample,
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
    /// [`Ros2Error::NotBuilt`], unless the settings are not valid.
    pub async fn new(settings: Ros2Settings) -> Result<Self, Ros2Error> {
        settings.with_environment(|name| std::env::var(name).ok())?;
        Err(Ros2Error::NotBuilt)
    }

    /// The settings, with what the environment variables filled in.
    pub fn settings(&self) -> &Ros2Settings {
        match *self {}
    }

    /// Returns the publishers that others have of a topic.
    pub fn publishers_of(&self, _topic: &str) -> Vec<super::FoundPublisher> {
        match *self {}
    }

    /// Returns the endpoints that others have of a topic.
    pub fn endpoints_of(&self, _topic: &str) -> Vec<FoundEndpoint> {
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

    /// Returns an address of the host that a participant runs on.
    pub fn host_of(&self, _participant: ParticipantId) -> Option<IpAddr> {
        match *self {}
    }

    /// Identity of the node in the domain.
    pub fn id(&self) -> ParticipantId {
        match *self {}
    }

    /// Returns how many bytes a socket of this host takes before it is read.
    pub fn receive_buffer_bytes(&self) -> usize {
        match *self {}
    }

    /// Returns a number that changes with everything that discovery finds out.
    pub fn discovery_changes(&self) -> watch::Receiver<u64> {
        match *self {}
    }

    /// Returns the domain and the network interfaces.
    pub fn describe_domain(&self) -> String {
        match *self {}
    }

    /// Says what to look for when a topic has no publisher.
    pub fn advise(&self) -> String {
        match *self {}
    }

    /// Limits of the kernel below the socket buffers that were asked for.
    pub fn socket_buffer_warnings(&self) -> &[SocketBufferWarning] {
        match *self {}
    }

    /// Returns how many other participants of the domain are there.
    pub fn participants(&self) -> usize {
        match *self {}
    }

    /// Opens a publisher of a topic.
    ///
    /// # Errors
    ///
    /// Never called.
    pub fn publisher(
        &self,
        _topic: &str,
        _type_name: &str,
        _qos: &QosProfile,
    ) -> Result<Ros2Publisher, Ros2Error> {
        match *self {}
    }

    /// Opens a subscription of a topic.
    ///
    /// # Errors
    ///
    /// Never called.
    pub fn subscription(
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
    /// Never called.
    pub async fn shut_down(self) -> Result<(), Ros2Error> {
        match self {}
    }
}

impl Ros2Publisher {
    /// Publishes a message and returns its sequence number.
    ///
    /// # Errors
    ///
    /// Never called.
    pub async fn publish(&self, _payload: Bytes, _source_time: WallTime) -> Result<i64, Ros2Error> {
        match *self {}
    }

    /// Publishes a message without waiting.
    ///
    /// # Errors
    ///
    /// Never called.
    pub fn try_publish(&self, _payload: Bytes, _source_time: WallTime) -> Result<Option<i64>, Ros2Error> {
        match *self {}
    }

    /// Counts everything so far as acknowledged.
    pub fn forget_unacknowledged(&self) {
        match *self {}
    }

    /// Waits until all matched reliable subscriptions have everything that was published.
    ///
    /// # Errors
    ///
    /// Never called.
    pub async fn await_acknowledgment(&self, _patience: Duration) -> Result<(), Ros2Error> {
        match *self {}
    }
}

impl Ros2Subscription {
    /// What was received and lost so far.
    pub fn counts(&self) -> ReceiveCounts {
        match *self {}
    }

    /// Waits for the next message.
    ///
    /// # Errors
    ///
    /// Never called.
    pub async fn receive(&mut self) -> Result<ReceivedSample, Ros2Error> {
        match *self {}
    }
}

macro_rules! endpoint {
    ($($endpoint:ident),*) => {$(
        impl $endpoint {
            /// Identity of the endpoint.
            pub fn id(&self) -> EndpointId {
                match *self {}
            }

            /// Absolute name of the topic.
            pub fn topic(&self) -> &str {
                match *self {}
            }

            /// Peers on the topic that are there, and changes of them.
            pub fn peers(&self) -> watch::Receiver<PeerTable> {
                match *self {}
            }

            /// Waits until a peer on the topic is there.
            ///
            /// # Errors
            ///
            /// Never called.
            pub async fn await_peer(&self, _patience: Duration) -> Result<(), Ros2Error> {
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
    async fn node_of_a_build_without_ros_2_says_so() {
        let error = Ros2Node::new(Ros2Settings::default()).await.err().expect("no ROS 2");
        assert!(error.to_string().contains("cargo feature `ros2`"), "{error}");
        let settings = Ros2Settings { domain_id: Some(300), ..Ros2Settings::default() };
        let error = Ros2Node::new(settings).await.err().expect("no such domain");
        assert!(error.to_string().contains("the domain 300"), "{error}");
    }
}
