//! A payload topic at a node of which the test sees what is published.

use std::sync::Arc;

use futures::FutureExt;
use futures::future::BoxFuture;
use peernet_ros::messages::{EncodedMessage, WireForm};
use peernet_ros::ros1::{SubscriberOptions, TopicType};
use peernet_sample::MediaType;

use super::*;
use crate::transport::ros::interface::{EdgeTopics, SessionSubscriber};

/// Longest payload that the sockets of the node hold. Bytes.
const RECEIVE_BUFFER_BYTES: usize = 10;

/// A node that counts what its publishers publish.
#[derive(Clone, Debug, Default)]
struct CountingNode(Arc<Mutex<usize>>);

impl CountingNode {
    fn published(&self) -> usize {
        *self.0.lock().expect("no test panics with it")
    }
}

impl SessionPublisher for CountingNode {
    fn topic(&self) -> &str {
        "/line/request"
    }

    fn publish(&self, _message: EncodedMessage) -> Result<(), NodeFailure> {
        Err(NodeFailure("payloads are for one node".to_owned()))
    }

    fn publish_to(&self, _node: &str, messages: &[EncodedMessage]) -> Result<Delivery, NodeFailure> {
        *self.0.lock().expect("no test panics with it") += messages.len();
        Ok(Delivery::Taken)
    }

    fn refusal(&self, node: &str) -> Option<String> {
        Some(format!("the QoS of {node} does not fit"))
    }
}

impl SessionNode for CountingNode {
    fn form(&self) -> WireForm {
        WireForm::Cdr
    }

    fn name(&self) -> &str {
        "/edge"
    }

    fn describe(&self, node: &str) -> String {
        node.to_owned()
    }

    fn resolve(&self, name: &str) -> Result<String, NodeFailure> {
        Ok(name.to_owned())
    }

    fn find_cloud<'a>(&'a self, topics: &'a EdgeTopics) -> BoxFuture<'a, Result<Arc<str>, NodeFailure>> {
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

    fn payload_patience(&self) -> Option<Duration> {
        None
    }

    fn caveat(&self) -> Option<&str> {
        None
    }

    fn publish<'a>(
        &'a self,
        _topic: &'a str,
        _of: (TopicUse, TopicType),
        _queue: QueueLimits,
    ) -> BoxFuture<'a, Result<Box<dyn SessionPublisher>, NodeFailure>> {
        std::future::ready(Ok(Box::new(self.clone()) as Box<dyn SessionPublisher>)).boxed()
    }

    fn subscribe<'a>(
        &'a self,
        topic: &'a str,
        _of: (TopicUse, TopicType),
        _options: SubscriberOptions,
    ) -> BoxFuture<'a, Result<Box<dyn SessionSubscriber>, NodeFailure>> {
        std::future::ready(Err(NodeFailure(format!("{topic} is only published")))).boxed()
    }

    fn end(&self, _patience: Duration) -> BoxFuture<'_, ()> {
        std::future::ready(()).boxed()
    }

    fn close(&self) {}
}

struct Sending {
    topic: PayloadTopic,
    node: CountingNode,
    peer: PeerState,
    remarks: Vec<String>,
}

impl Sending {
    fn new() -> Self {
        Self {
            topic: PayloadTopic::new("/line/request".into(), QueueLimits::default()),
            node: CountingNode::default(),
            peer: PeerState::default(),
            remarks: Vec::new(),
        }
    }

    /// Publishes a payload of a number of bytes; returns whether the peer gets it on the topic.
    fn publish(&mut self, media: MediaType, bytes: usize) -> bool {
        let part = Description { media, shape: Vec::new(), element: None };
        let (header, data) = (Header::default(), Bytes::from(vec![7; bytes]));
        let payload = Payload { header: &header, part: &part, data: &data };
        let remark = &mut |text| self.remarks.push(text);
        self.topic.publish(&self.node, ("/cloud", self.peer), &payload, remark).expect("the topic is open")
    }

    async fn open(&mut self) {
        assert!(!self.publish(MediaType::Jpeg, 3));
        let kind = self.topic.take_request().await;
        assert_eq!(kind, PayloadType::CompressedImage);
        self.topic.open(&self.node, kind).await.expect("the node publishes any topic");
    }
}

#[tokio::test]
async fn first_payload_requests_its_type_once() {
    let mut sending = Sending::new();
    assert!(sending.topic.take_request().now_or_never().is_none());
    sending.open().await;
    assert!(!sending.publish(MediaType::Jpeg, 3), "nothing says yet that the peer receives the topic");
    assert_eq!(sending.node.published(), 1);
    assert!(!sending.publish(MediaType::Bytes, 3), "the topic has another type");
    assert!(sending.topic.take_request().now_or_never().is_none());
    assert_eq!(sending.node.published(), 1);
}

#[tokio::test]
async fn subscribed_peer_gets_payloads_on_the_topic_only() {
    let mut sending = Sending::new();
    sending.open().await;
    sending.peer.is_subscribed = true;
    assert!(sending.publish(MediaType::Jpeg, 3));
    assert!(sending.remarks.is_empty(), "{:?}", sending.remarks);
}

#[tokio::test]
async fn long_payloads_and_refusals_are_remarked_once() {
    let mut sending = Sending::new();
    sending.open().await;
    for _ in 0..2 {
        assert!(!sending.publish(MediaType::Jpeg, RECEIVE_BUFFER_BYTES + 1));
        assert!(!sending.publish(MediaType::Jpeg, RECEIVE_BUFFER_BYTES));
    }
    sending.peer.receive_buffer_bytes = Some(5);
    assert!(!sending.publish(MediaType::Jpeg, 6));
    assert_eq!(sending.node.published(), 2);
    let [size, refusal] = &sending.remarks[..] else { panic!("{:?}", sending.remarks) };
    assert!(size.starts_with("a payload of 11 bytes is longer than the 10 bytes"), "{size}");
    assert!(refusal.ends_with("the QoS of /cloud does not fit"), "{refusal}");
}
