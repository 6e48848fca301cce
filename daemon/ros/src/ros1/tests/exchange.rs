//! Tests of messages between publishers and subscribers.

use bytes::Bytes;

use super::{TestMaster, node, within};
use crate::messages::{CompressedImage, Message, StringMessage, WireForm};
use crate::ros1::{PublisherOptions, PublisherState, Subscriber, SubscriberOptions, TopicType};

fn text(data: &str) -> crate::messages::EncodedMessage {
    StringMessage { data: data.into() }.encode(WireForm::Ros1).unwrap()
}

async fn receive(subscriber: &mut Subscriber) -> String {
    let message = within(subscriber.recv()).await.unwrap();
    StringMessage::decode(WireForm::Ros1, message.bytes).unwrap().data
}

#[tokio::test]
async fn messages_arrive_in_order_and_are_counted() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let mut subscriber = b.subscribe("t", kind, SubscriberOptions::default()).await.unwrap();
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    for number in 0..1000 {
        within(publisher.publish_waiting(text(&number.to_string()))).await.unwrap();
    }
    for number in 0..1000 {
        assert_eq!(receive(&mut subscriber).await, number.to_string());
    }
    let counts = publisher.counts();
    assert_eq!((counts.offered, counts.sent, counts.dropped + counts.lost + counts.waiting), (1000, 1000, 0));
    assert_eq!(subscriber.counts().messages, 1000);
    // Before each message, a length of four bytes is sent.
    assert_eq!(counts.sent_bytes, subscriber.counts().bytes + 4 * 1000);
    let status = &subscriber.publishers()[0];
    let PublisherState::Connected(info) = &status.state else { panic!("connected: {status:?}") };
    assert_eq!((&*info.node, &*info.uri), ("/a", a.uri()));
    assert_eq!(info.local, publisher.subscribers()[0].remote);
    a.shutdown().await.unwrap();
    b.shutdown().await.unwrap();
}

#[tokio::test]
async fn subscriber_may_come_first() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let mut subscriber = b.subscribe("t", TopicType::any(), SubscriberOptions::default()).await.unwrap();
    assert!(subscriber.publishers().is_empty());
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = a.publish("/t", kind, PublisherOptions::default()).await.unwrap();
    within(subscriber.wait_for_publishers(1)).await.unwrap();
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    publisher.publish(text("hello")).unwrap();
    assert_eq!(receive(&mut subscriber).await, "hello");
}

#[tokio::test]
async fn connected_subscriber_misses_no_message() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    for number in 0..50 {
        let mut subscriber = b.subscribe("t", kind.clone(), SubscriberOptions::default()).await.unwrap();
        within(subscriber.wait_for_publishers(1)).await.unwrap();
        publisher.publish(text(&number.to_string())).unwrap();
        assert_eq!(receive(&mut subscriber).await, number.to_string());
    }
}

#[tokio::test]
async fn large_messages_arrive_whole() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<CompressedImage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let mut subscriber = b.subscribe("t", kind, SubscriberOptions::default()).await.unwrap();
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    for length in [0, 1, 1000, 60_000, 1_200_000, 20_000_000] {
        let data: Bytes =
            (0..length).map(|index: u32| index.to_le_bytes()[0] ^ 0x5a).collect::<Vec<u8>>().into();
        let image = CompressedImage { data, format: "raw".into(), ..CompressedImage::default() };
        publisher.publish(image.encode(WireForm::Ros1).unwrap()).unwrap();
        let message = within(subscriber.recv()).await.unwrap();
        assert_eq!(CompressedImage::decode(WireForm::Ros1, message.bytes).unwrap(), image);
    }
}

#[tokio::test]
async fn latched_message_reaches_late_subscribers() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let options = PublisherOptions { is_latching: true, ..PublisherOptions::default() };
    let publisher = a.publish("t", kind.clone(), options).await.unwrap();
    publisher.publish(text("old")).unwrap();
    publisher.publish(text("last")).unwrap();
    let mut subscriber = b.subscribe("t", kind, SubscriberOptions::default()).await.unwrap();
    assert_eq!(receive(&mut subscriber).await, "last");
    // The messages were published without a subscriber, so only the last message is offered.
    assert_eq!(publisher.counts().offered, 1);
}

#[tokio::test]
async fn several_publishers_are_listed() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let first_publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let second_publisher = b.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let mut subscriber = b.subscribe("t", kind, SubscriberOptions::default()).await.unwrap();
    within(subscriber.wait_for_publishers(2)).await.unwrap();
    within(first_publisher.wait_for_subscribers(1)).await.unwrap();
    within(second_publisher.wait_for_subscribers(1)).await.unwrap();
    assert_eq!(b.system_state().await.unwrap().publishers_of("/t"), ["/a", "/b"]);
    assert_eq!(b.topic_types().await.unwrap(), [("/t".to_owned(), "std_msgs/String".to_owned())]);
    first_publisher.publish(text("1")).unwrap();
    let message = within(subscriber.recv()).await.unwrap();
    assert_eq!(&*message.publisher.node, "/a");
}

#[tokio::test]
async fn messages_before_shutdown_are_written() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<CompressedImage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let mut subscriber = b.subscribe("t", kind, SubscriberOptions::default()).await.unwrap();
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    for _ in 0..20 {
        publisher.publish(Bytes::from(vec![1; 1_000_000])).unwrap();
    }
    let receiver = async {
        for _ in 0..20 {
            assert_eq!(within(subscriber.recv()).await.unwrap().bytes.len(), 1_000_000);
        }
    };
    let (shutdown_result, ()) = tokio::join!(a.shutdown(), receiver);
    shutdown_result.unwrap();
    assert_eq!(publisher.counts().sent, 20);
    assert!(master.publishers("/t").is_empty());
}
