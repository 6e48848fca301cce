//! Tests with peers that are missing, slow or restarted, or that send invalid data.

use bytes::Bytes;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::{TestMaster, clock, environment, node, within};
use crate::messages::{CompressedImage, StringMessage};
use crate::ros1::tcpros::{ConnectionHeader, Subscription};
use crate::ros1::{
    Node, NodeError, PublisherOptions, PublisherState, QueueLimits, RpcUri, SubscriberOptions, TopicType,
    WhenFull,
};

fn message(length: usize) -> Bytes {
    vec![7; length].into()
}

#[tokio::test]
async fn error_names_missing_master() {
    // The socket is bound and does not listen, so connections are refused.
    let socket = tokio::net::TcpSocket::new_v4().unwrap();
    socket.bind("127.0.0.1:0".parse().unwrap()).unwrap();
    let uri = format!("http://{}", socket.local_addr().unwrap());
    let error = Node::new(&environment(&uri), "a", clock()).await.unwrap_err();
    assert_eq!(
        error.to_string(),
        format!(
            "no ROS master answers at {uri}: Connection refused (os error 111); \
             start roscore there, or set ROS_MASTER_URI"
        )
    );
}

#[tokio::test]
async fn restarted_master_learns_all_topics() {
    let mut master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let mut subscriber = b.subscribe("t", kind.clone(), SubscriberOptions::default()).await.unwrap();
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    master.kill().await;
    publisher.publish(message(5)).unwrap();
    within(subscriber.recv()).await.unwrap();
    master.resume();
    let is_known =
        |master: &TestMaster| master.publishers("/t") == ["/a"] && master.subscribers("/t") == ["/b"];
    within(master.wait_until(is_known)).await;
    // The old connection remains, and a new subscriber finds the publisher.
    publisher.publish(message(6)).unwrap();
    assert_eq!(within(subscriber.recv()).await.unwrap().bytes.len(), 6);
    assert_eq!(subscriber.counts().connections, 1);
    let c = node(&master, "c").await;
    let late_subscriber = c.subscribe("t", kind, SubscriberOptions::default()).await.unwrap();
    within(late_subscriber.wait_for_publishers(1)).await.unwrap();
}

#[tokio::test]
async fn type_mismatch_is_refused_with_both_types() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let publisher = a
        .publish("t", TopicType::from_message::<CompressedImage>(), PublisherOptions::default())
        .await
        .unwrap();
    let kind = TopicType::from_message::<StringMessage>();
    let subscriber = b.subscribe("t", kind, SubscriberOptions::default()).await.unwrap();
    let reason = within(async {
        loop {
            let changed = subscriber.publishers_changed();
            if let Some(PublisherState::Failed(reason)) =
                subscriber.publishers().first().map(|publisher| publisher.state.clone())
            {
                break reason;
            }
            changed.await;
        }
    })
    .await;
    assert!(reason.contains("topic /t has two message types: sensor_msgs/CompressedImage"), "{reason}");
    assert!(
        reason.contains("std_msgs/String (md5sum 992ce8a1687cec8c8bd883ec73ca41d1) at node /b"),
        "{reason}"
    );
    assert!(publisher.subscribers().is_empty());
}

/// Returns the connection of a subscriber that reads nothing.
async fn silent_subscriber(publisher_node: &Node, master: &TestMaster) -> TcpStream {
    let state = publisher_node.state();
    assert_eq!(master.publishers("/t"), [publisher_node.name()]);
    let mut stream = TcpStream::connect(("127.0.0.1", state.address.tcpros_port())).await.unwrap();
    let kind = TopicType::any();
    let request = Subscription { node: "/silent".into(), topic: "/t".into(), kind }.request();
    stream.write_all(&request.encode()).await.unwrap();
    stream
}

#[tokio::test]
async fn publisher_with_full_queue_drops_and_counts() {
    let master = TestMaster::start().await;
    let a = node(&master, "a").await;
    let queue = QueueLimits { messages: 4, bytes: 100_000_000 };
    let options = PublisherOptions { queue, ..PublisherOptions::default() };
    let publisher = a.publish("t", TopicType::from_message::<CompressedImage>(), options).await.unwrap();
    let stream = silent_subscriber(&a, &master).await;
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    let dropped: usize = (0..50).map(|_| publisher.publish(message(1_000_000)).unwrap().dropped).sum();
    let counts = publisher.counts();
    assert!(dropped > 10, "{counts:?}");
    assert_eq!((counts.offered, counts.dropped, counts.waiting), (50, dropped as u64, 4));
    assert_eq!(counts.offered, counts.sent + counts.dropped + counts.lost + counts.waiting);
    assert!(publisher.is_full_for("/silent", 1) && !publisher.is_full_for("/other", 1));
    // When the subscriber disconnects, the waiting messages are lost and counted.
    drop(stream);
    within(async {
        while publisher.counts().waiting > 0 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    let counts = publisher.counts();
    assert_eq!(counts.lost, 4);
    assert_eq!(counts.offered, counts.sent + counts.dropped + counts.lost);
}

#[tokio::test]
async fn subscriber_with_full_queue_drops_and_counts() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let options = SubscriberOptions {
        queue: QueueLimits { messages: 10, bytes: 1_000_000 },
        when_full: WhenFull::Drop,
        ..SubscriberOptions::default()
    };
    let mut subscriber = b.subscribe("t", kind, options).await.unwrap();
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    for _ in 0..100 {
        within(publisher.publish_waiting(message(100))).await.unwrap();
    }
    within(async {
        while subscriber.counts().messages < 100 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    for _ in 0..10 {
        within(subscriber.recv()).await.unwrap();
    }
    within(async {
        while subscriber.counts().dropped < 90 {
            tokio::task::yield_now().await;
        }
    })
    .await;
}

#[tokio::test]
async fn newest_messages_replace_oldest_and_are_counted() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let options = SubscriberOptions {
        queue: QueueLimits { messages: 3, bytes: 1_000_000 },
        when_full: WhenFull::DropOldest,
        ..SubscriberOptions::default()
    };
    let mut subscriber = b.subscribe("t", kind, options).await.unwrap();
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    for length in 1..=100 {
        within(publisher.publish_waiting(message(length))).await.unwrap();
    }
    within(async {
        while subscriber.counts().dropped < 97 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    assert_eq!(subscriber.counts().messages, 100);
    for length in 98..=100 {
        assert_eq!(within(subscriber.recv()).await.unwrap().bytes, message(length));
    }
    assert_eq!(subscriber.counts().dropped, 97);
}

#[tokio::test]
async fn unexpected_publisher_is_ignored_with_reason() {
    let master = TestMaster::start().await;
    let (a, b, c) = (node(&master, "a").await, node(&master, "b").await, node(&master, "c").await);
    let kind = TopicType::from_message::<StringMessage>();
    let foreign_publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let options = SubscriberOptions { publisher: Some("/b".into()), ..SubscriberOptions::default() };
    let mut subscriber = c.subscribe("t", kind.clone(), options).await.unwrap();
    let expected_publisher = b.publish("t", kind, PublisherOptions::default()).await.unwrap();
    within(expected_publisher.wait_for_subscribers(1)).await.unwrap();
    for length in 1..=10 {
        foreign_publisher.publish(message(100)).unwrap();
        within(expected_publisher.publish_waiting(message(length))).await.unwrap();
        assert_eq!(within(subscriber.recv()).await.unwrap().bytes, message(length));
    }
    let publisher_watch = subscriber.publisher_watch();
    let reason = within(async {
        loop {
            let changed = publisher_watch.changed();
            let mut states = publisher_watch.publishers().into_iter().map(|publisher| publisher.state);
            if let Some(PublisherState::Failed(reason)) =
                states.find(|state| matches!(state, PublisherState::Failed(_)))
            {
                return reason;
            }
            changed.await;
        }
    })
    .await;
    assert!(
        reason.contains("node /a publishes this topic as well") && reason.contains("node /b"),
        "{reason}"
    );
}

#[tokio::test]
async fn subscriber_reconnects_to_a_restarted_publisher() {
    let master = TestMaster::start().await;
    let b = node(&master, "b").await;
    let kind = TopicType::from_message::<StringMessage>();
    let mut subscriber = b.subscribe("t", kind.clone(), SubscriberOptions::default()).await.unwrap();
    for length in [1, 2] {
        let a = node(&master, "a").await;
        let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
        within(publisher.wait_for_subscribers(1)).await.unwrap();
        publisher.publish(message(length)).unwrap();
        assert_eq!(within(subscriber.recv()).await.unwrap().bytes.len(), length);
        a.shutdown().await.unwrap();
    }
    assert_eq!(subscriber.counts().connections, 2);
}

#[tokio::test]
async fn node_with_taken_name_ends() {
    let master = TestMaster::start().await;
    let old_node = node(&master, "a").await;
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = old_node.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let new_node = node(&master, "a").await;
    let _publisher = new_node.publish("t", kind, PublisherOptions::default()).await.unwrap();
    let error = within(old_node.ended()).await;
    assert!(error.to_string().contains("has registered with the same name"), "{error}");
    assert!(matches!(publisher.publish(message(1)), Err(NodeError::Closed { .. })));
    // The new node's registration remains.
    drop((publisher, old_node));
    assert_eq!(master.publishers("/t"), ["/a"]);
}

#[tokio::test]
async fn topic_can_be_published_again_after_its_end() {
    let master = TestMaster::start().await;
    let a = node(&master, "a").await;
    let publish = || a.publish("t", TopicType::from_message::<StringMessage>(), PublisherOptions::default());
    let publisher = publish().await.unwrap();
    assert!(matches!(publish().await, Err(NodeError::AlreadyPublished { .. })));
    drop(publisher);
    within(master.wait_until(|master| master.publishers("/t").is_empty())).await;
    let _publisher = publish().await.unwrap();
    assert_eq!(master.publishers("/t"), ["/a"]);
    let error = a.publish("u", TopicType::any(), PublisherOptions::default()).await.unwrap_err();
    assert!(matches!(error, NodeError::PublishedWildcard { .. }));
}

#[tokio::test]
async fn malformed_header_is_answered_with_the_reason() {
    let master = TestMaster::start().await;
    let a = node(&master, "a").await;
    let mut stream = TcpStream::connect(("127.0.0.1", a.state().address.tcpros_port())).await.unwrap();
    stream.write_all(b"\x07\0\0\0\x03\0\0\0abc").await.unwrap();
    let mut answer = Vec::new();
    within(stream.read_to_end(&mut answer)).await.unwrap();
    let header = ConnectionHeader::decode(&answer[4..]).unwrap();
    assert_eq!(header.get("error"), Some("a field of the connection header has no '='"));
    let mut stream = TcpStream::connect(("127.0.0.1", a.state().address.tcpros_port())).await.unwrap();
    stream.write_all(&u32::MAX.to_le_bytes()).await.unwrap();
    let answer_bytes = within(stream.read_to_end(&mut answer)).await.unwrap();
    assert_eq!(answer_bytes, 0, "a header above the largest length is not answered");
}

#[tokio::test]
async fn garbage_at_both_ports_leaves_the_node_working() {
    let master = TestMaster::start().await;
    let a = node(&master, "a").await;
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let rpc_port = RpcUri::parse(a.uri()).unwrap().port();
    let long_line = "x".repeat(1_000_000);
    for port in [rpc_port, a.state().address.tcpros_port()] {
        for garbage in [
            "",
            "\0\0\0\0",
            "GET / HTTP/1.1\r\n\r\n",
            "POST / HTTP/1.1\r\nContent-Length: 9\r\n\r\n<a><b/></",
            &long_line,
        ] {
            let mut stream = TcpStream::connect(("127.0.0.1", port)).await.unwrap();
            // The node may close the connection before all bytes are sent.
            let _ = stream.write_all(garbage.as_bytes()).await;
            let _ = stream.shutdown().await;
            let _ = within(stream.read_to_end(&mut Vec::new())).await;
        }
    }
    let b = node(&master, "b").await;
    let mut subscriber = b.subscribe("t", kind, SubscriberOptions::default()).await.unwrap();
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    publisher.publish(message(3)).unwrap();
    within(subscriber.recv()).await.unwrap();
}

#[tokio::test]
async fn connections_have_nodelay_keepalive_and_timeout() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let stream = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
    crate::ros1::socket::configure(&stream).unwrap();
    assert!(stream.nodelay().unwrap());
    let socket = socket2::SockRef::from(&stream);
    assert!(socket.keepalive().unwrap());
    assert!(socket.tcp_user_timeout().unwrap().is_some());
}
