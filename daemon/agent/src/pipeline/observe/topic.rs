//! A topic of the observed system.

use std::fmt;
use std::sync::Arc;

use peernet_ros::messages::WireForm;
use peernet_ros::ros1::{
    Node, NodeError, PublisherInfo, PublisherState, ReceivedMessage, Subscriber, SubscriberOptions,
    TopicType, WhenFull,
};

use super::message::{TopicMessage, begins_with_header, read_header};

/// A subscription of an observed topic.
pub(super) struct Topic(Subscriber);

/// A publisher of an observed topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PublisherPlace {
    /// Name of the node, or of the endpoint where the node has none.
    pub(super) node: String,
    /// Its host, unless it is this one.
    pub(super) host: Option<String>,
}

impl fmt::Display for PublisherPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.host {
            None => write!(f, "{} on this host", self.node),
            Some(host) => write!(f, "{} at {host}, where this agent measures nothing", self.node),
        }
    }
}

impl Topic {
    /// Subscribes to a topic of any type.
    ///
    /// # Errors
    /// The name is not allowed, or the master does not answer.
    pub(super) async fn subscribe(node: &Node, topic: &str) -> Result<Self, NodeError> {
        // A queue that is full must not hold up the publisher, which is a part of the observed system.
        let options = SubscriberOptions { when_full: WhenFull::Drop, ..SubscriberOptions::default() };
        Ok(Self(node.subscribe(topic, TopicType::any(), options).await?))
    }

    /// Waits for the next message. Dropping the future loses none.
    ///
    /// # Errors
    /// The node has ended.
    pub(super) async fn next(&mut self) -> Result<TopicMessage, NodeError> {
        let ReceivedMessage { bytes, publisher, received, .. } = self.0.recv().await?;
        let has_header = begins_with_header(&publisher.kind.definition);
        let header = has_header.then(|| read_header(WireForm::Ros1, &bytes)).flatten();
        Ok(TopicMessage {
            received,
            length: bytes.len(),
            stamp: header.as_ref().map(|header| header.stamp.as_nanos()).filter(|stamp| *stamp != 0),
            sequence: header.map(|header| header.seq.into()),
            publisher: Arc::clone(&publisher.uri),
        })
    }

    /// Returns the global name of the topic.
    pub(super) fn name(&self) -> &str {
        self.0.topic()
    }

    /// Returns the type of the messages, once a publisher is connected.
    pub(super) fn kind(&self) -> Option<TopicType> {
        Some(self.connected().next()?.kind.clone())
    }

    /// Returns why the topic has no messages at the moment; `None` while it has a publisher.
    pub(super) fn trouble(&self) -> Option<String> {
        let publishers = self.0.publishers();
        if publishers.iter().any(|publisher| matches!(publisher.state, PublisherState::Connected(_))) {
            return None;
        }
        let failed = publishers.into_iter().find_map(|publisher| match publisher.state {
            PublisherState::Failed(reason) => Some(reason),
            PublisherState::Connecting | PublisherState::Connected(_) => None,
        });
        let silent = format!("no node publishes {}", self.name());
        Some(failed.map_or_else(|| silent.clone(), |reason| format!("{silent} ({reason})")))
    }

    /// Returns the publishers whose messages are received.
    pub(super) fn publishers(&self) -> Vec<PublisherPlace> {
        let place = |info: Arc<PublisherInfo>| {
            // A connection within a host has the same address at both ends.
            let host = (info.remote.ip() != info.local.ip()).then(|| info.remote.ip().to_string());
            PublisherPlace { node: info.node.to_string(), host }
        };
        self.connected().map(place).collect()
    }

    /// Returns a future that ends when the publishers have changed since it was made.
    pub(super) fn publishers_changed(&self) -> impl Future<Output = ()> + '_ {
        self.0.publishers_changed()
    }

    /// Messages that were received and dropped because the agent was too busy.
    pub(super) fn dropped(&self) -> u64 {
        self.0.counts().dropped
    }

    fn connected(&self) -> impl Iterator<Item = Arc<PublisherInfo>> + use<> {
        self.0.publishers().into_iter().filter_map(|publisher| match publisher.state {
            PublisherState::Connected(info) => Some(info),
            PublisherState::Connecting | PublisherState::Failed(_) => None,
        })
    }
}
