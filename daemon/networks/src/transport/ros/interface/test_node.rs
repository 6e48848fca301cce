//! A node for tests of the parts of a connection.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use futures::FutureExt;
use futures::future::BoxFuture;
use peernet_ros::messages::{EncodedMessage, WireForm};
use peernet_ros::ros1::{Delivery, QueueLimits, SubscriberOptions, TopicType};

use super::{EdgeTopics, NodeFailure, SessionNode, SessionPublisher, SessionSubscriber, TopicPurpose};

/// Largest payload that fits into the node's sockets. Bytes.
pub(in crate::transport::ros) const RECEIVE_BUFFER_BYTES: usize = 10;

/// A node that is also its only publisher. It counts the published messages and sends none.
#[derive(Clone, Debug, Default)]
pub(in crate::transport::ros) struct TestNode {
    published: Arc<AtomicUsize>,
    /// `true` if the queues of the topics are full.
    is_full: Arc<AtomicBool>,
    /// Readable names of other nodes, by identifier.
    readable_names: BTreeMap<String, String>,
}

impl TestNode {
    /// Returns the number of messages that were published.
    pub(in crate::transport::ros) fn published_count(&self) -> usize {
        self.published.load(Ordering::Relaxed)
    }

    /// Sets whether the queues of the topics are full.
    pub(in crate::transport::ros) fn set_full(&self, is_full: bool) {
        self.is_full.store(is_full, Ordering::Relaxed);
    }

    /// Sets the readable name of another node.
    pub(in crate::transport::ros) fn set_readable_name(&mut self, node_id: &str, name: &str) {
        self.readable_names.insert(node_id.to_owned(), name.to_owned());
    }
}

impl SessionPublisher for TestNode {
    fn topic(&self) -> &str {
        "/line/request"
    }

    fn publish(&self, _message: EncodedMessage) -> Result<(), NodeFailure> {
        Err(NodeFailure("payloads must be published with publish_fragments".to_owned()))
    }

    fn publish_fragments(&self, _node: &str, fragments: &[EncodedMessage]) -> Result<Delivery, NodeFailure> {
        if self.is_full.load(Ordering::Relaxed) {
            return Ok(Delivery::Full);
        }
        self.published.fetch_add(fragments.len(), Ordering::Relaxed);
        Ok(Delivery::Accepted)
    }

    fn is_full(&self, _node: &str, _length: usize) -> bool {
        self.is_full.load(Ordering::Relaxed)
    }

    fn describe_mismatch(&self, node: &str) -> Option<String> {
        Some(format!("the QoS of {node} does not fit"))
    }
}

impl SessionNode for TestNode {
    fn form(&self) -> WireForm {
        WireForm::Cdr
    }

    fn name(&self) -> &str {
        "/edge"
    }

    fn readable_names(&self, node: &str) -> Vec<String> {
        self.readable_names.get(node).cloned().into_iter().collect()
    }

    fn describe(&self, node: &str) -> String {
        node.to_owned()
    }

    fn resolve(&self, name: &str) -> Result<String, NodeFailure> {
        Ok(name.to_owned())
    }

    fn find_cloud_and_check_topics<'a>(
        &'a self,
        topics: &'a EdgeTopics,
    ) -> BoxFuture<'a, Result<Arc<str>, NodeFailure>> {
        std::future::ready(Ok(topics.cloud.as_str().into())).boxed()
    }

    fn check_cloud_name<'a>(&'a self, _cloud: &'a str) -> BoxFuture<'a, Result<(), NodeFailure>> {
        std::future::ready(Ok(())).boxed()
    }

    fn receive_buffer_bytes(&self) -> Option<usize> {
        Some(RECEIVE_BUFFER_BYTES)
    }

    fn max_companion_bytes(&self) -> usize {
        usize::MAX
    }

    fn payload_timeout(&self) -> Option<Duration> {
        None
    }

    fn caveat(&self) -> Option<&str> {
        None
    }

    fn publish<'a>(
        &'a self,
        _topic: &'a str,
        _kind: (TopicPurpose, TopicType),
        _queue: QueueLimits,
    ) -> BoxFuture<'a, Result<Box<dyn SessionPublisher>, NodeFailure>> {
        std::future::ready(Ok(Box::new(self.clone()) as Box<dyn SessionPublisher>)).boxed()
    }

    fn subscribe<'a>(
        &'a self,
        topic: &'a str,
        _kind: (TopicPurpose, TopicType),
        _options: SubscriberOptions,
    ) -> BoxFuture<'a, Result<Box<dyn SessionSubscriber>, NodeFailure>> {
        std::future::ready(Err(NodeFailure(format!("{topic} is only published")))).boxed()
    }

    fn end(&self, _time_limit: Duration) -> BoxFuture<'_, ()> {
        std::future::ready(()).boxed()
    }

    fn close(&self) {}
}
