//! The topics of a node.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::error::NodeError;
use super::publisher::PublishedTopic;
use super::registration::Role;
use super::subscriber::SubscribedTopic;

/// Topics that a node publishes or subscribes to: at most one publisher and one subscriber of each.
#[derive(Debug, Default)]
pub(super) struct NodeTopics {
    topics: Mutex<TopicsByName>,
}

/// Topics by their global names.
#[derive(Debug, Default)]
struct TopicsByName {
    published: BTreeMap<Arc<str>, Arc<PublishedTopic>>,
    subscribed: BTreeMap<Arc<str>, Arc<SubscribedTopic>>,
}

impl NodeTopics {
    fn lock(&self) -> MutexGuard<'_, TopicsByName> {
        self.topics.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a topic that the node publishes.
    ///
    /// # Errors
    /// If the node already publishes it.
    pub(super) fn add_published(&self, topic: Arc<PublishedTopic>) -> Result<(), NodeError> {
        let name = Arc::clone(&topic.publication.topic);
        let published = &mut self.lock().published;
        if published.contains_key(&name) {
            return Err(NodeError::AlreadyPublished { topic: name.to_string() });
        }
        published.insert(name, topic);
        Ok(())
    }

    /// Adds a topic that the node subscribes to.
    ///
    /// # Errors
    /// If the node already subscribes to it.
    pub(super) fn add_subscribed(&self, topic: Arc<SubscribedTopic>) -> Result<(), NodeError> {
        let name = Arc::clone(&topic.subscription.topic);
        let subscribed = &mut self.lock().subscribed;
        if subscribed.contains_key(&name) {
            return Err(NodeError::AlreadySubscribed { topic: name.to_string() });
        }
        subscribed.insert(name, topic);
        Ok(())
    }

    /// Removes a topic, and ends its connections.
    pub(super) fn remove(&self, role: Role, topic: &str) {
        let mut topics = self.lock();
        match role {
            Role::Publisher => topics.published.remove(topic).map(|topic| topic.stop.cancel()),
            Role::Subscriber => topics.subscribed.remove(topic).map(|topic| topic.stop.cancel()),
        };
    }

    /// Returns a topic that the node publishes.
    pub(super) fn find_published(&self, topic: &str) -> Option<Arc<PublishedTopic>> {
        self.lock().published.get(topic).cloned()
    }

    /// Returns a topic that the node subscribes to.
    pub(super) fn find_subscribed(&self, topic: &str) -> Option<Arc<SubscribedTopic>> {
        self.lock().subscribed.get(topic).cloned()
    }

    /// Returns all topics that the node publishes.
    pub(super) fn published(&self) -> Vec<Arc<PublishedTopic>> {
        self.lock().published.values().cloned().collect()
    }

    /// Returns all topics that the node subscribes to.
    pub(super) fn subscribed(&self) -> Vec<Arc<SubscribedTopic>> {
        self.lock().subscribed.values().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use tokio_util::sync::CancellationToken;

    use super::*;
    use crate::ros1::QueueLimits;
    use crate::ros1::tcpros::{Publication, TopicType};

    fn topic() -> Arc<PublishedTopic> {
        let publication = Publication {
            node: "/camera".into(),
            topic: "/image".into(),
            kind: TopicType::any(),
            is_latching: false,
        };
        Arc::new(PublishedTopic::new(publication, QueueLimits::default(), CancellationToken::new()))
    }

    #[test]
    fn topic_is_published_once_until_it_is_removed() {
        let (topics, first) = (NodeTopics::default(), topic());
        topics.add_published(Arc::clone(&first)).unwrap();
        let error = topics.add_published(topic()).unwrap_err();
        assert!(matches!(error, NodeError::AlreadyPublished { topic } if topic == "/image"));
        topics.remove(Role::Subscriber, "/image");
        assert!(topics.find_published("/image").is_some() && !first.stop.is_cancelled());
        topics.remove(Role::Publisher, "/image");
        assert!(topics.published().is_empty() && first.stop.is_cancelled());
        topics.add_published(topic()).unwrap();
    }
}
