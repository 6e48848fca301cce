//! Tests of the limits that apply to ROS 1 nodes without a session.

use std::time::Duration;

use bytes::Bytes;
use peernet_networks::SessionSettings;
use peernet_ros::messages::{EncodedMessage, Header, Message, MessageInfo, SessionHello, Time, WireForm};
use peernet_ros::ros1::{Environment, Node, Publisher, PublisherOptions, RpcUri, TopicType};
use peernet_sample::{Description, Sample};

use crate::ros::{exchange, foreign_node, session};
use crate::ros_master::RosMaster;
use crate::support::{Cloud, accepted, clock, echo, hello, open, settings, within};

/// Limit on the unfinished messages of all sessions of a cloud in these tests, and on each message. Bytes.
const SHARED_BYTES: u64 = 1_000_000;

/// Number of connections that are opened without a session.
const CONNECTIONS_WITHOUT_SESSION: usize = 12;

/// Returns a companion whose payload is never sent.
fn companion_without_payload(sequence: u64, bytes: usize) -> EncodedMessage {
    let stamp = Time::from_nanos(1_000_000_000 + i64::try_from(sequence).expect("small"));
    let info = MessageInfo {
        header: Header { stamp, frame_id: "id".into(), ..Header::default() },
        sequence,
        has_payload: true,
        frame_lengths: vec![u32::try_from(bytes).expect("small"), 0, 1_000],
        frames: vec![7; bytes].into(),
        ..MessageInfo::default()
    };
    info.encode(WireForm::Ros1).expect("can be written")
}

#[tokio::test]
async fn connection_cannot_be_replaced_from_another_address() {
    let master = RosMaster::start();
    let mut cloud = Cloud::start_at(&master.address(), settings()).await;
    let (address, hello) = (cloud.address(), hello());
    let host_and_pipeline =
        (hello.host.to_string(), format!("/{}", hello.pipeline.as_str().replace('-', "_")));
    let edge = tokio::spawn(async move { open(&address, hello, settings()).await });
    assert!(cloud.next_open().await.accept(accepted(cloud.host)));
    let session = within(edge).await.expect("no panic").expect("accepted");
    let environment = Environment {
        master: RpcUri::parse(&master.uri()).expect("a URI"),
        advertised_host: Some("127.0.0.2".to_owned()),
        namespace: "/".to_owned(),
    };
    let node = Node::new(&environment, "stranger", clock()).await.expect("the master answers");
    let hellos = hello_publisher(&cloud, &node).await;
    for _ in 0..20 {
        let (host, pipeline) = host_and_pipeline.clone();
        send_hello(&hellos, &node, host, pipeline).await;
        echo(&mut cloud, &session, "the session goes on").await;
    }
}

/// Returns a publisher of the topic on which a cloud receives connection requests.
async fn hello_publisher(cloud: &Cloud, node: &Node) -> Publisher {
    let address = cloud.address().to_string();
    let topic = format!("/{}/sessions", address.rsplit('/').next().expect("a name"));
    let kind = TopicType::from_message::<SessionHello>();
    let publisher = node.publish(&topic, kind, PublisherOptions::default()).await.expect("registered");
    within(publisher.wait_for_subscribers(1)).await.expect("the cloud subscribes");
    publisher
}

/// Sends a connection request.
async fn send_hello(hellos: &Publisher, node: &Node, host: String, pipeline: String) {
    let header = Header { frame_id: "id".into(), ..Header::default() };
    let hello = SessionHello { header, node: node.name().to_owned(), host, pipeline };
    let hello = hello.encode(WireForm::Ros1).expect("can be written");
    within(hellos.publish_waiting(hello)).await.expect("the node runs");
}

#[tokio::test]
async fn connections_without_session_leave_memory_for_sessions() {
    let master = RosMaster::start();
    let limits =
        SessionSettings { max_message_bytes: SHARED_BYTES, max_unfinished_bytes: SHARED_BYTES, ..settings() };
    let mut cloud = Cloud::start_at(&master.address(), limits).await;
    let (session, _) = session(&mut cloud).await;
    let node = foreign_node(&master, "crowd").await;
    let options = PublisherOptions::default();
    let hellos = hello_publisher(&cloud, &node).await;
    let mut publishers: Vec<Publisher> = Vec::new();
    for number in 0..CONNECTIONS_WITHOUT_SESSION {
        let pipeline = format!("/crowd/line{number}");
        let topic = format!("{pipeline}/request_info");
        let publisher = node
            .publish(&topic, TopicType::from_message::<MessageInfo>(), options)
            .await
            .expect("registered");
        send_hello(&hellos, &node, "crowd".to_owned(), pipeline).await;
        within(publisher.wait_for_subscribers(1)).await.expect("the cloud subscribes");
        // These companions of all connections are together longer than the shared limit.
        for sequence in 0..4 {
            let sending = publisher.publish_waiting(companion_without_payload(sequence, 60_000));
            within(sending).await.expect("the node runs");
        }
        publishers.push(publisher);
    }
    for _ in 0..20 {
        let sample = Sample::from_part(Description::bytes(), Bytes::from(vec![1; 450_000]));
        assert_eq!(exchange(&mut cloud, &session, sample.clone()).await, sample);
    }
    assert_eq!(session.statistics().lost_messages, 0);
}

#[tokio::test]
async fn connection_without_session_ends_after_hello_timeout() {
    let master = RosMaster::start();
    // The heartbeat timeout, which ends a silent connection as well, is longer than the test may take.
    let timeouts = SessionSettings { hello_timeout_ms: 2_000, heartbeat_timeout_ms: 60_000, ..settings() };
    let cloud = Cloud::start_at(&master.address(), timeouts).await;
    let node = foreign_node(&master, "silent").await;
    let hellos = hello_publisher(&cloud, &node).await;
    let kind = TopicType::from_message::<MessageInfo>();
    let options = PublisherOptions::default();
    let publisher = node.publish("/silent/request_info", kind, options).await.expect("registered");
    send_hello(&hellos, &node, "silent".to_owned(), "/silent".to_owned()).await;
    within(publisher.wait_for_subscribers(1)).await.expect("the cloud subscribes");
    within(async {
        while !publisher.subscribers().is_empty() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await;
}
