//! Tests of a payload topic at a node that counts published messages.

use futures::FutureExt;
use peernet_sample::MediaType;

use super::*;
use crate::transport::ros::interface::test_node::{RECEIVE_BUFFER_BYTES, TestNode};

struct SendingTest {
    topic: PayloadTopic,
    node: TestNode,
    peer: PeerState,
    remarks: Vec<String>,
}

impl SendingTest {
    fn new() -> Self {
        Self {
            topic: PayloadTopic::new("/line/request".into(), QueueLimits::default()),
            node: TestNode::default(),
            peer: PeerState::default(),
            remarks: Vec::new(),
        }
    }

    /// Publishes a payload of `bytes` bytes. Returns whether the peer receives it on the topic.
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
async fn first_payload_requests_topic_of_its_type_once() {
    let mut sending = SendingTest::new();
    assert!(sending.topic.take_request().now_or_never().is_none());
    sending.open().await;
    assert!(!sending.publish(MediaType::Jpeg, 3), "nothing says yet that the peer receives the topic");
    assert_eq!(sending.node.published_count(), 1);
    assert!(!sending.publish(MediaType::Bytes, 3), "the topic has another type");
    assert!(sending.topic.take_request().now_or_never().is_none());
    assert_eq!(sending.node.published_count(), 1);
}

#[tokio::test]
async fn subscribed_peer_gets_payloads_on_the_topic_only() {
    let mut sending = SendingTest::new();
    sending.open().await;
    sending.peer.is_subscribed = true;
    assert!(sending.publish(MediaType::Jpeg, 3));
    assert!(sending.remarks.is_empty(), "{:?}", sending.remarks);
}

#[tokio::test]
async fn long_payloads_and_mismatches_are_remarked_once() {
    let mut sending = SendingTest::new();
    sending.open().await;
    for _ in 0..2 {
        // This payload is too long for the topic and is not published there.
        assert!(!sending.publish(MediaType::Jpeg, RECEIVE_BUFFER_BYTES + 1));
        // This payload is published on the topic, but the peer has not confirmed that payloads arrive there.
        assert!(!sending.publish(MediaType::Jpeg, RECEIVE_BUFFER_BYTES));
    }
    // A payload that is too long for the peer only causes no second remark.
    sending.peer.receive_buffer_bytes = Some(5);
    assert!(!sending.publish(MediaType::Jpeg, 6));
    assert_eq!(sending.node.published_count(), 2);
    let [size_remark, mismatch_remark] = &sending.remarks[..] else { panic!("{:?}", sending.remarks) };
    assert!(size_remark.starts_with("a payload of 11 bytes is longer than the 10 bytes"), "{size_remark}");
    assert!(mismatch_remark.ends_with("the QoS of /cloud does not fit"), "{mismatch_remark}");
}
