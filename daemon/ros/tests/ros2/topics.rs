//! Tests of ROS 2 between nodes of one process, over the loopback interface.

use std::sync::atomic::{AtomicU16, Ordering};
use std::time::Duration;

use bytes::{BufMut, Bytes, BytesMut};
use peernet_clock::WallTime;
use peernet_ros::ros2::{
    Durability, QosProfile, Refusal, Reliability, Ros2Error, Ros2Node, Ros2Publisher, Ros2Settings,
    Ros2Subscription,
};

const BYTES_TYPE: &str = "std_msgs/msg/UInt8MultiArray";
/// Time limit of every wait, far above what is needed.
const TIME_LIMIT: Duration = Duration::from_secs(30);

/// Returns settings with a domain that no other test of this process uses.
fn settings() -> Ros2Settings {
    static NEXT_OFFSET: AtomicU16 = AtomicU16::new(0);
    // Another process of these tests uses other domains, unless the last digits of both process ids are equal.
    let process_base = u16::try_from(std::process::id() % 10).expect("below 10") * 20;
    let domain_id = Some(1 + process_base + NEXT_OFFSET.fetch_add(1, Ordering::Relaxed));
    Ros2Settings { domain_id, interfaces: vec!["127.0.0.1".into()], ..Ros2Settings::default() }
}

async fn two_nodes() -> (Ros2Node, Ros2Node) {
    let settings = settings();
    let first = Ros2Node::new(settings.clone()).await.expect("a node");
    (first, Ros2Node::new(settings).await.expect("a node"))
}

async fn connected_pair(
    (first, second): &(Ros2Node, Ros2Node),
    topic: &str,
    qos: &QosProfile,
) -> (Ros2Publisher, Ros2Subscription) {
    let publisher = first.create_publisher(topic, BYTES_TYPE, qos).expect("a publisher");
    let subscription = second.create_subscription(topic, BYTES_TYPE, qos).expect("a subscription");
    publisher.wait_for_peer(TIME_LIMIT).await.expect("a subscription");
    subscription.wait_for_peer(TIME_LIMIT).await.expect("a publisher");
    (publisher, subscription)
}

/// Returns the CDR form of a sequence of bytes.
fn payload(size: usize, seed: usize) -> Bytes {
    let mut cdr = BytesMut::from(&[0, 1, 0, 0][..]);
    cdr.put_u32_le(u32::try_from(size).expect("small enough"));
    cdr.extend((0..size).map(|index| (index * 31 + seed).to_le_bytes()[0]));
    cdr.freeze()
}

/// Returns whether the received bytes are the sent bytes, apart from the padding of DDS.
fn is_same(sent: &Bytes, received: &Bytes) -> bool {
    received.starts_with(sent) && received.len() < sent.len() + 4
}

async fn receive(subscription: &mut Ros2Subscription) -> peernet_ros::ros2::ReceivedSample {
    let received = tokio::time::timeout(TIME_LIMIT, subscription.receive());
    received.await.expect("a message in time").expect("a message")
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_of_every_size_arrive_unchanged() {
    let nodes = two_nodes().await;
    let (publisher, mut subscription) = connected_pair(&nodes, "/bytes", &QosProfile::default()).await;
    for (number, size) in (1..).zip([0, 1, 1_000, 60_000, 1_200_000]) {
        let (sent, time) = (payload(size, number), WallTime::from_unix_nanos(1_700_000_000_123_456_789));
        let sequence = publisher.publish(sent.clone(), time).await.expect("published");
        let received = receive(&mut subscription).await;
        assert!(is_same(&sent, &received.payload), "{size} bytes");
        assert_eq!((received.sequence, sequence), (number as i64, number as i64));
        assert_eq!((received.writer, received.source_time), (publisher.id(), Some(time)));
        assert_eq!(received.missing_before, 0);
        assert!(received.received_time > time);
    }
    let counts = subscription.counts();
    assert_eq!((counts.received, counts.lost, counts.late), (5, 0, 0));
    publisher.wait_for_acknowledgment(TIME_LIMIT).await.expect("acknowledged");
}

#[tokio::test(flavor = "multi_thread")]
async fn burst_of_large_messages_arrives_whole() {
    let nodes = two_nodes().await;
    let qos = QosProfile { depth: 20, ..QosProfile::default() };
    let (publisher, mut subscription) = connected_pair(&nodes, "/burst", &qos).await;
    let sender = tokio::spawn(async move {
        for number in 0..20 {
            let time = WallTime::from_unix_nanos(1);
            publisher.publish(payload(1_000_000, number), time).await.expect("published");
        }
        publisher.wait_for_acknowledgment(TIME_LIMIT).await.expect("acknowledged");
        publisher
    });
    for number in 0..20 {
        let received = receive(&mut subscription).await;
        assert!(is_same(&payload(1_000_000, number), &received.payload), "message {number}");
    }
    sender.await.expect("the sender ends");
    assert_eq!(subscription.counts().lost, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn unread_message_is_counted_as_lost() {
    let nodes = two_nodes().await;
    let writer_qos = QosProfile { depth: 20, ..QosProfile::default() };
    let publisher = nodes.0.create_publisher("/slow", BYTES_TYPE, &writer_qos).expect("a publisher");
    let reader_qos = QosProfile { depth: 1, ..QosProfile::default() };
    let mut subscription =
        nodes.1.create_subscription("/slow", BYTES_TYPE, &reader_qos).expect("a subscription");
    publisher.wait_for_peer(TIME_LIMIT).await.expect("a subscription");
    let publish = |number| publisher.publish(payload(100_000, number), WallTime::from_unix_nanos(1));
    publish(0).await.expect("published");
    receive(&mut subscription).await;
    for number in 1..=10 {
        publish(number).await.expect("published");
    }
    publisher.wait_for_acknowledgment(TIME_LIMIT).await.expect("acknowledged");
    while receive(&mut subscription).await.sequence < 11 {}
    let counts = subscription.counts();
    assert_eq!(counts.received + counts.lost, 11, "{counts:?}");
    assert!(counts.lost > 0, "{counts:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn late_subscription_gets_kept_transient_local_messages() {
    let nodes = two_nodes().await;
    let qos = QosProfile { durability: Durability::TransientLocal, depth: 3, ..QosProfile::default() };
    let publisher = nodes.0.create_publisher("/map", BYTES_TYPE, &qos).expect("a publisher");
    let sent = payload(5_000, 1);
    publisher.publish(sent.clone(), WallTime::from_unix_nanos(1)).await.expect("published");
    let mut subscription = nodes.1.create_subscription("/map", BYTES_TYPE, &qos).expect("a subscription");
    assert!(is_same(&sent, &receive(&mut subscription).await.payload));
}

#[tokio::test(flavor = "multi_thread")]
async fn incompatible_qos_is_named_at_both_ends() {
    let (first, second) = two_nodes().await;
    let offered = QosProfile { reliability: Reliability::BestEffort, ..QosProfile::default() };
    let publisher = first.create_publisher("/qos", BYTES_TYPE, &offered).expect("a publisher");
    let subscription =
        second.create_subscription("/qos", BYTES_TYPE, &QosProfile::default()).expect("a subscription");
    let expected = Refusal::IncompatibleQos {
        policy: "reliability".into(),
        offered: "best-effort".into(),
        requested: "reliable".into(),
    };
    for mut peers in [publisher.peers(), subscription.peers()] {
        let refused_peers =
            tokio::time::timeout(TIME_LIMIT, peers.wait_for(|peers| !peers.refused.is_empty()));
        let refused_peers =
            refused_peers.await.expect("in time").expect("the endpoint exists").refused.clone();
        assert_eq!(refused_peers.values().collect::<Vec<_>>(), [&expected]);
    }
    let error = subscription.wait_for_peer(Duration::from_millis(1)).await.expect_err("no peer").to_string();
    assert!(
        error.contains("the publisher offers best-effort, the subscription requests reliable"),
        "{error}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_of_another_type_are_dropped() {
    let nodes = two_nodes().await;
    let qos = QosProfile::default();
    let mut subscription = nodes.1.create_subscription("/type", BYTES_TYPE, &qos).expect("a subscription");
    let publisher_of_other_type =
        nodes.0.create_publisher("/type", "std_msgs/msg/String", &qos).expect("a publisher");
    let mut peers = subscription.peers();
    let refused_peers = tokio::time::timeout(TIME_LIMIT, peers.wait_for(|peers| !peers.refused.is_empty()));
    let refused_peers = refused_peers.await.expect("in time").expect("the endpoint exists").refused.clone();
    let expected = Refusal::OtherType { type_name: "std_msgs/msg/String".into() };
    assert_eq!(refused_peers.get(&publisher_of_other_type.id()), Some(&expected));
    let error = subscription.wait_for_peer(Duration::from_millis(1)).await.expect_err("no peer").to_string();
    assert!(error.contains("its message type is std_msgs/msg/String"), "{error}");
    let publisher_of_same_type = nodes.0.create_publisher("/type", BYTES_TYPE, &qos).expect("a publisher");
    publisher_of_same_type.wait_for_peer(TIME_LIMIT).await.expect("a subscription");
    publisher_of_other_type.publish(payload(10, 0), WallTime::from_unix_nanos(1)).await.expect("published");
    publisher_of_same_type.publish(payload(10, 1), WallTime::from_unix_nanos(1)).await.expect("published");
    assert_eq!(receive(&mut subscription).await.writer, publisher_of_same_type.id());
}

#[tokio::test(flavor = "multi_thread")]
async fn missing_peer_error_names_domain_interface_and_topics() {
    let (first, second) = two_nodes().await;
    let qos = QosProfile::default();
    let publisher = first.create_publisher("/alone", BYTES_TYPE, &qos).expect("a publisher");
    let subscription = second.create_subscription("/elsewhere", BYTES_TYPE, &qos).expect("a subscription");
    let error = publisher.wait_for_peer(Duration::from_secs(3)).await.expect_err("no peer");
    let Ros2Error::NoPeer(absence) = &error else { panic!("{error}") };
    assert_eq!((absence.participants, absence.topics.as_slice()), (1, &["/elsewhere".to_owned()][..]));
    let domain = first.settings().domain_id.expect("a domain");
    for part in
        ["no subscription of topic /alone".to_owned(), format!("domain {domain}"), "127.0.0.1".to_owned()]
    {
        assert!(error.to_string().contains(&part), "{part}: {error}");
    }
    drop(subscription);
}

#[tokio::test(flavor = "multi_thread")]
async fn shutdown_ends_receiving_and_peer_notices() {
    let nodes = two_nodes().await;
    let (publisher, mut subscription) = connected_pair(&nodes, "/end", &QosProfile::default()).await;
    let receiving = tokio::spawn(async move { subscription.receive().await.map(|_| ()) });
    let (first, second) = nodes;
    tokio::time::timeout(TIME_LIMIT, second.shut_down()).await.expect("in time").expect("shut down");
    let receive_result =
        tokio::time::timeout(TIME_LIMIT, receiving).await.expect("in time").expect("no panic");
    assert!(matches!(receive_result, Err(Ros2Error::ShutDown { .. })), "{receive_result:?}");
    let mut peers = publisher.peers();
    let peer_loss = tokio::time::timeout(TIME_LIMIT, peers.wait_for(|peers| peers.matched.is_empty()));
    assert_eq!(peer_loss.await.expect("in time").expect("the endpoint exists").unmatched_total, 1);
    first.shut_down().await.expect("shut down");
    let result = publisher.publish(payload(1, 1), WallTime::from_unix_nanos(1)).await;
    assert!(matches!(result, Err(Ros2Error::ShutDown { .. })), "{result:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn payload_without_encapsulation_header_is_refused() {
    let node = Ros2Node::new(settings()).await.expect("a node");
    let publisher = node.create_publisher("/raw", BYTES_TYPE, &QosProfile::default()).expect("a publisher");
    let result = publisher.publish(Bytes::from_static(b"hello"), WallTime::from_unix_nanos(1)).await;
    assert!(matches!(result, Err(Ros2Error::NotCdr { .. })), "{result:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn unknown_interface_error_lists_existing_interfaces() {
    let settings = Ros2Settings { interfaces: vec!["eth99".into()], ..settings() };
    let error = Ros2Node::new(settings).await.err().expect("no such interface").to_string();
    assert!(error.contains("\"eth99\"") && error.contains("127.0.0.1"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn publishers_of_a_topic_are_found_without_a_subscription() {
    let (first, second) = two_nodes().await;
    let mut changes = second.discovery_changes();
    assert_eq!(second.publishers_of("/found"), []);
    let publisher =
        first.create_publisher("/found", BYTES_TYPE, &QosProfile::default()).expect("a publisher");
    let _other = first.create_publisher("/other", BYTES_TYPE, &QosProfile::default()).expect("a publisher");
    let mut wait_for_count = async |count: usize| {
        let count_reached = async {
            while second.publishers_of("/found").len() != count {
                changes.changed().await.expect("the node is there");
            }
        };
        tokio::time::timeout(TIME_LIMIT, count_reached).await.expect("in time");
    };
    wait_for_count(1).await;
    let publisher_on_first_node = second.publishers_of("/found").remove(0);
    assert_eq!(
        (publisher_on_first_node.id, publisher_on_first_node.type_name.as_str()),
        (publisher.id(), BYTES_TYPE)
    );
    assert_eq!(publisher_on_first_node.host, None, "it is on this host");
    assert!(second.describe_domain().contains("127.0.0.1"), "{}", second.describe_domain());
    drop(publisher);
    wait_for_count(0).await;
}
