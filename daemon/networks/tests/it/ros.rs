//! Tests of sessions over topics of ROS 1.

use std::time::Duration;

use bytes::Bytes;
use peernet_networks::{CloseReason, Incoming, Listener, OpenError, Session, SessionHello};
use peernet_ros::messages::{CompressedImage, Message, MessageInfo, StringMessage, WireForm};
use peernet_ros::ros1::{
    Environment, Node, PublisherOptions, RpcUri, SubscriberOptions, TopicType, WhenFull,
};
use peernet_sample::{Description, MediaType, PixelFormat, Sample};

use crate::ros_master::RosMaster;
use crate::support::{
    Cloud, TIME_LIMIT, TestNetwork, accepted, clock, echo, hello, open, recorder, settings, within,
};

/// Returns a node of another program.
pub(crate) async fn foreign_node(master: &RosMaster, name: &str) -> Node {
    let environment = Environment {
        master: RpcUri::parse(&master.uri()).expect("a URI"),
        advertised_host: Some("127.0.0.1".to_owned()),
        namespace: "/".to_owned(),
    };
    Node::new(&environment, name, clock()).await.expect("the master answers")
}

/// Returns the topic of a session's requests.
fn request_topic(pipeline: &str) -> String {
    format!("/{}/request", pipeline.replace('-', "_"))
}

/// Sends a sample and lets the cloud answer with the same sample. Returns the answer.
pub(crate) async fn exchange(cloud: &mut Cloud, session: &Session, sample: Sample) -> Sample {
    let pending = tokio::spawn({
        let (session, sample) = (session.clone(), sample.clone());
        async move { session.request(recorder(), &sample, TIME_LIMIT).await }
    });
    let incoming = cloud.next_request().await;
    assert_eq!(incoming.sample, sample);
    incoming.reply.send(incoming.recorder, Ok(incoming.sample));
    within(pending).await.expect("no panic").result.expect("an answer")
}

/// Opens a session. Returns the session and the name of its pipeline.
pub(crate) async fn session(cloud: &mut Cloud) -> (Session, String) {
    let (address, hello) = (cloud.address(), hello());
    let pipeline = hello.pipeline.to_string();
    let edge = tokio::spawn(async move { open(&address, hello, settings()).await });
    assert!(cloud.next_open().await.accept(accepted(cloud.host)));
    (within(edge).await.expect("no panic").expect("accepted"), pipeline)
}

#[tokio::test]
async fn payloads_of_all_sizes_and_types_come_back_identical() {
    for description in [
        Description::bytes(),
        Description::unshaped(MediaType::Jpeg),
        Description::pixels(PixelFormat::Rgb8, 400, 1_000),
    ] {
        let mut cloud = Cloud::on_network(TestNetwork::Ros1).await;
        let (session, _) = session(&mut cloud).await;
        for size in [0, 1, 1_000, 60_000, 1_200_000, 20_000_000, 1_000] {
            let bytes: Bytes = (0..size).map(|index: u32| (index % 251) as u8).collect::<Vec<u8>>().into();
            let sample = Sample::from_part(description.clone(), bytes);
            assert_eq!(exchange(&mut cloud, &session, sample.clone()).await, sample);
        }
        let statistics = session.statistics();
        // The hello and the acceptance are messages, too.
        assert_eq!((statistics.sent.messages, statistics.received.messages), (8, 8));
        assert_eq!((statistics.lost_messages, statistics.received.lost), (0, Some(0)));
        assert!(statistics.round_trip.is_some());
    }
}

#[tokio::test]
async fn other_programs_see_pictures_as_compressed_images() {
    let master = RosMaster::start();
    let mut cloud = Cloud::start_at(&master.address(), settings()).await;
    let (session, pipeline) = session(&mut cloud).await;
    let viewer = foreign_node(&master, "viewer").await;
    let kind = TopicType::from_message::<CompressedImage>();
    let mut pictures = viewer
        .subscribe(&request_topic(&pipeline), kind, SubscriberOptions::default())
        .await
        .expect("registered");
    let picture = Sample::from_part(Description::unshaped(MediaType::Jpeg), Bytes::from(vec![9; 5_000]));
    // Until the topic of the pictures is open, the companions carry the pictures.
    let first_picture = async {
        loop {
            exchange(&mut cloud, &session, picture.clone()).await;
            let result = tokio::time::timeout(Duration::from_millis(50), pictures.recv()).await;
            if let Ok(message) = result {
                break message.expect("the node runs").bytes;
            }
        }
    };
    let image = CompressedImage::decode(WireForm::Ros1, within(first_picture).await).expect("an image");
    assert_eq!((&*image.format, &image.data[..]), ("jpeg", &picture.parts[0].bytes[..]));
    assert!(image.header.stamp.sec > 1_000_000_000, "the departure is in the header");
    assert_eq!(session.statistics().lost_messages, 0);
}

// Restarting the master blocks this thread, so the sessions need another thread.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sessions_continue_while_master_restarts() {
    let mut master = RosMaster::start();
    let mut cloud = Cloud::start_at(&master.address(), settings()).await;
    let (first_session, _) = session(&mut cloud).await;
    master.restart();
    echo(&mut cloud, &first_session, "connections need no master").await;
    // The cloud registers again within five seconds.
    let address = cloud.address();
    let second_session = tokio::spawn(async move {
        loop {
            match open(&address, hello(), settings()).await {
                Ok(session) => return session,
                Err(OpenError::Unreachable { .. }) => tokio::time::sleep(Duration::from_millis(100)).await,
                Err(error) => panic!("{error}"),
            }
        }
    });
    assert!(cloud.next_open().await.accept(accepted(cloud.host)));
    let second_session = within(second_session).await.expect("no panic");
    echo(&mut cloud, &second_session, "the new master knows the cloud").await;
    echo(&mut cloud, &first_session, "still there").await;
}

#[tokio::test]
async fn unreachable_master_is_named() {
    let mut master = RosMaster::start();
    let address = master.address().parse().expect("an address");
    master.kill();
    let error = open(&address, hello(), settings()).await.expect_err("no master").to_string();
    assert!(error.contains("no ROS master answers") && error.contains("start roscore"), "{error}");
    let error =
        Listener::bind(&address, settings(), hello().host, clock()).await.expect_err("no master").to_string();
    assert!(error.contains("no ROS master answers") && error.contains(&address.to_string()), "{error}");
}

#[tokio::test]
async fn new_connection_of_same_pipeline_replaces_earlier_one() {
    replace_connections(Cloud::on_network(TestNetwork::Ros1).await).await;
}

/// Opens three connections of one pipeline in succession. Each connection works, and ends the connection before it.
pub(crate) async fn replace_connections(mut cloud: Cloud) {
    let hello = hello();
    let mut earlier_session: Option<Session> = None;
    for _ in 0..3 {
        let (address, hello) = (cloud.address(), hello.clone());
        let mut edge = tokio::spawn(async move { open(&address, hello, settings()).await });
        let request = loop {
            let incoming = tokio::select! {
                incoming = cloud.next() => incoming,
                result = &mut edge => panic!("the edge ended before the cloud accepted the session: {result:?}"),
            };
            match incoming {
                Incoming::Open(request) => break request,
                Incoming::Closed { .. } => {}
                other => panic!("expected a hello, not {other:?}"),
            }
        };
        assert!(request.accept(accepted(cloud.host)));
        let session = within(edge).await.expect("no panic").expect("accepted");
        if let Some(earlier_session) = earlier_session {
            assert!(matches!(within(earlier_session.closed()).await, CloseReason::Broken(_)));
        }
        echo(&mut cloud, &session, "the new connection works").await;
        earlier_session = Some(session);
    }
}

#[tokio::test]
async fn cloud_with_name_of_another_cloud_is_refused() {
    let cloud = Cloud::on_network(TestNetwork::Ros1).await;
    let result = Listener::bind(&cloud.address(), settings(), cloud.host, clock()).await;
    let error = result.expect_err("the name is taken").to_string();
    assert!(error.contains("a cloud with the name") && error.contains("another name"), "{error}");
}

#[tokio::test]
async fn failed_bind_leaves_no_registration() {
    let master = RosMaster::start();
    // The topic of hellos is registered, and the topic of refusals cannot be registered.
    let relay = master.relay_without("registerPublisher").await;
    let address = format!("ros1://{relay}/cloud").parse().expect("an address");
    let result = Listener::bind(&address, settings(), hello().host, clock()).await;
    let error = result.expect_err("a topic is not registered").to_string();
    assert!(error.contains("no ROS master answers"), "{error}");
    let observer = foreign_node(&master, "observer").await;
    let state = observer.system_state().await.expect("the master answers");
    assert!(state.subscribers.is_empty(), "{state:?}");
}

#[tokio::test]
async fn topic_with_foreign_publisher_or_type_is_refused() {
    let master = RosMaster::start();
    let cloud = Cloud::start_at(&master.address(), settings()).await;
    let node = foreign_node(&master, "rosbag").await;
    for (suffix, kind) in [
        ("_info", TopicType::from_message::<MessageInfo>()),
        ("", TopicType::from_message::<StringMessage>()),
    ] {
        let hello = hello();
        let topic = format!("{}{suffix}", request_topic(hello.pipeline.as_str()));
        let _publisher = node.publish(&topic, kind, PublisherOptions::default()).await.expect("registered");
        let error = open(&cloud.address(), hello, settings())
            .await
            .expect_err("another node publishes the topic")
            .to_string();
        assert!(
            error.contains("node /rosbag publishes topic")
                && error.contains(&topic)
                && error.contains("ROS_NAMESPACE"),
            "{error}"
        );
    }
    let hello = hello();
    let topic = format!("/{}/response_info", hello.pipeline.as_str().replace('-', "_"));
    let kind = TopicType::from_message::<StringMessage>();
    let _publisher = node.publish(&topic, kind, PublisherOptions::default()).await.expect("registered");
    let error =
        open(&cloud.address(), hello, settings()).await.expect_err("the topic has another type").to_string();
    assert!(error.contains("std_msgs/String") && error.contains(&topic), "{error}");
}

#[tokio::test]
async fn messages_of_second_publishers_are_dropped() {
    let master = RosMaster::start();
    let mut cloud = Cloud::start_at(&master.address(), settings()).await;
    let (session, pipeline) = session(&mut cloud).await;
    let node = foreign_node(&master, "stranger").await;
    let topic = format!("{}_info", request_topic(&pipeline));
    let publisher = node
        .publish(&topic, TopicType::from_message::<MessageInfo>(), PublisherOptions::default())
        .await
        .expect("registered");
    within(publisher.wait_for_subscribers(1)).await.expect("the cloud subscribes");
    let goodbye = MessageInfo { kind: MessageInfo::GOODBYE, ..MessageInfo::default() };
    for _ in 0..100 {
        publisher.publish(goodbye.encode(WireForm::Ros1).expect("can be written")).expect("the node runs");
    }
    publisher.publish(Bytes::from_static(b"nonsense")).expect("the node runs");
    echo(&mut cloud, &session, "the session goes on").await;
    wait_for_remark_on_second_publisher(&mut cloud, &session, "node /stranger", &topic).await;
}

/// Exchanges requests until the cloud remarks on a second publisher.
pub(crate) async fn wait_for_remark_on_second_publisher(
    cloud: &mut Cloud,
    session: &Session,
    node: &str,
    topic: &str,
) {
    within(async {
        while cloud.remarks.is_empty() {
            echo(cloud, session, "the session goes on").await;
        }
    })
    .await;
    for expected in [node, topic, "two publishers", "another name"] {
        assert!(cloud.remarks[0].contains(expected), "{expected}: {:?}", cloud.remarks);
    }
}

#[tokio::test]
async fn second_host_gets_reason_of_refusal() {
    assert_second_host_is_refused(Cloud::on_network(TestNetwork::Ros1).await).await;
}

/// Requests the topics of a pipeline from a second host. Both ends report the refusal, and the first session continues.
pub(crate) async fn assert_second_host_is_refused(mut cloud: Cloud) {
    let (first_session, pipeline) = session(&mut cloud).await;
    let (address, hello) = (cloud.address(), hello());
    let hello = SessionHello { pipeline: pipeline.parse().expect("a name"), ..hello };
    let host = hello.host;
    let edge = tokio::spawn(async move { open(&address, hello, settings()).await });
    let refusal = within(async {
        loop {
            if let Some(Incoming::Refused { host, text }) = cloud.listener.next().await {
                break (host, text);
            }
        }
    });
    let (refused_host, text) = refusal.await;
    assert_eq!(refused_host, Some(host));
    assert!(text.contains("refused a connection to node /peernet_robot_1_"), "{text}");
    let Err(OpenError::Refused { reason, .. }) = within(edge).await.expect("no panic") else {
        panic!("the edge is refused")
    };
    for message in [text, reason] {
        assert!(
            message.contains("another host uses the topics") && message.contains("ROS_NAMESPACE"),
            "{message}"
        );
    }
    echo(&mut cloud, &first_session, "the first session goes on").await;
}

#[tokio::test]
async fn open_session_outlasts_hello_timeout() {
    let short_hello_timeout = peernet_networks::SessionSettings { hello_timeout_ms: 2_000, ..settings() };
    let mut cloud = Cloud::start_at(&RosMaster::shared().address(), short_hello_timeout).await;
    let address = cloud.address();
    let edge = tokio::spawn(async move { open(&address, hello(), settings()).await });
    // A refused connection before the session does not end the session either.
    cloud.next_open().await.refuse("no");
    assert!(matches!(within(edge).await.expect("no panic"), Err(OpenError::Refused { .. })));
    let (session, _) = session(&mut cloud).await;
    tokio::time::sleep(Duration::from_millis(2_500)).await;
    echo(&mut cloud, &session, "an open session is not ended").await;
    within(cloud.listener.close()).await;
    assert_eq!(within(session.closed()).await, CloseReason::Goodbye("the cloud shuts down".into()));
}

#[tokio::test]
async fn session_keeps_messages_for_subscriber_that_does_not_read() {
    let master = RosMaster::start();
    let mut cloud = Cloud::start_at(&master.address(), settings()).await;
    let (session, pipeline) = session(&mut cloud).await;
    let viewer = foreign_node(&master, "viewer").await;
    let options = SubscriberOptions { when_full: WhenFull::Wait, ..SubscriberOptions::default() };
    let unread_subscriber =
        viewer.subscribe(&request_topic(&pipeline), TopicType::any(), options).await.expect("registered");
    // The subscriber reads no message.
    for _ in 0..100 {
        let sample = Sample::from_part(Description::bytes(), Bytes::from(vec![1; 1_000_000]));
        exchange(&mut cloud, &session, sample).await;
    }
    assert_eq!(session.statistics().lost_messages, 0);
    drop(unread_subscriber);
}
