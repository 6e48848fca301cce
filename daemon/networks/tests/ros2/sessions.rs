//! Tests of sessions over topics of ROS 2.

use std::time::Duration;

use bytes::Bytes;
use peernet_clock::WallTime;
use peernet_networks::{
    CloseReason, Incoming, Listener, OpenError, RequestError, Ros2SessionSettings, SessionSettings,
};
use peernet_ros::messages::{CompressedImage, Message, MessageInfo, WireForm};
use peernet_ros::ros2::{QosProfile, Reliability, Ros2Node, Ros2Settings};
use peernet_sample::{Description, MediaType, PixelFormat, Sample};

use crate::ros::{
    assert_second_host_is_refused, exchange, replace_connections, session,
    wait_for_remark_on_second_publisher,
};
use crate::support::{
    Cloud, TIME_LIMIT, TestNetwork, accepted, clock, echo, hello, open, recorder, settings, within,
};

/// Returns settings in which `change` has changed the settings of ROS 2.
fn settings_with(change: impl FnOnce(&mut Ros2SessionSettings)) -> SessionSettings {
    let mut settings = settings();
    change(&mut settings.ros2);
    settings
}

async fn cloud() -> Cloud {
    Cloud::on_network(TestNetwork::Ros2).await
}

/// Returns a node of another program in the cloud's domain.
async fn foreign_node(cloud: &Cloud) -> Ros2Node {
    let settings = Ros2Settings {
        domain_id: cloud.address().ros_domain(),
        interfaces: vec!["127.0.0.1".into()],
        node_name: "viewer".into(),
        ..Ros2Settings::default()
    };
    Ros2Node::new(settings).await.expect("a node")
}

fn topic(pipeline: &str, name: &str) -> String {
    format!("/{}/{name}", pipeline.replace('-', "_"))
}

fn picture(bytes: usize) -> Sample {
    let bytes: Vec<u8> = (0..bytes).map(|index| (index % 251) as u8).collect();
    Sample::from_part(Description::unshaped(MediaType::Jpeg), bytes.into())
}

/// Type of the messages on the topics of companions.
const INFO_TYPE: &str = "peernet_msgs/msg/MessageInfo";

// The ROS 2 clients have threads of their own. They must not wait for the thread of the test.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn payloads_of_all_sizes_and_types_come_back_identical() {
    for description in [
        Description::bytes(),
        Description::unshaped(MediaType::Jpeg),
        Description::pixels(PixelFormat::Rgb8, 400, 1_000),
    ] {
        let mut cloud = cloud().await;
        let (session, _) = session(&mut cloud).await;
        for size in [0, 1, 1_000, 60_000, 1_200_000, 20_000_000, 1_200_000, 1_000] {
            let bytes: Bytes = (0..size).map(|index: u32| (index % 251) as u8).collect::<Vec<u8>>().into();
            let sample = Sample::from_part(description.clone(), bytes);
            assert_eq!(exchange(&mut cloud, &session, sample.clone()).await, sample, "{size} bytes");
        }
        let statistics = session.statistics();
        // The hello and the acceptance are messages, too.
        assert_eq!((statistics.sent.messages, statistics.received.messages), (9, 9));
        assert_eq!((statistics.lost_messages, statistics.received.lost), (0, Some(0)));
        let remarks = session.remarks().borrow().clone();
        let [remark] = &remarks[..] else {
            panic!("one remark says that the longest payloads do not fit: {remarks:?}")
        };
        for expected in ["20000", "/request", "socket_buffer_bytes", "net.core.rmem_max"] {
            assert!(remark.contains(expected), "{expected}: {remark}");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn other_programs_see_pictures_as_compressed_images() {
    let mut cloud = cloud().await;
    let (session, pipeline) = session(&mut cloud).await;
    let viewer = foreign_node(&cloud).await;
    let kind = "sensor_msgs/msg/CompressedImage";
    let mut pictures = viewer
        .create_subscription(&topic(&pipeline, "request"), kind, &QosProfile::default())
        .expect("a subscription");
    let sample = picture(300_000);
    // Until the topic of the pictures is open, the companions carry the pictures.
    let first_picture = async {
        loop {
            exchange(&mut cloud, &session, sample.clone()).await;
            let result = tokio::time::timeout(Duration::from_millis(50), pictures.receive()).await;
            if let Ok(message) = result {
                break message.expect("the node runs").payload;
            }
        }
    };
    let image = CompressedImage::decode(WireForm::Cdr, within(first_picture).await).expect("an image");
    assert_eq!((&*image.format, &image.data[..]), ("jpeg", &sample.parts[0].bytes[..]));
    assert!(image.header.stamp.sec > 1_000_000_000, "the departure is in the header");
    assert_eq!(session.statistics().lost_messages, 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn error_for_domain_without_cloud_names_the_domain() {
    let cloud = cloud().await;
    let domain = cloud.address().ros_domain().expect("a domain");
    let name = cloud.address().listener_name().expect("a name").to_owned();
    // The clouds of all tests use domains up to 100.
    let address_in_other_domain = format!("ros2://{}/{name}", 101 + domain);
    let short_timeout = SessionSettings { open_timeout_ms: 2_000, ..settings() };
    let error = open(&address_in_other_domain.parse().expect("an address"), hello(), short_timeout)
        .await
        .expect_err("no cloud uses this domain")
        .to_string();
    for expected in [&*name, &format!("ROS_DOMAIN_ID {}", 101 + domain), "127.0.0.1", "/sessions"] {
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cloud_with_name_of_another_cloud_is_refused() {
    let cloud = cloud().await;
    let result = Listener::bind(&cloud.address(), settings(), cloud.host, clock()).await;
    let error = result.expect_err("the name is taken").to_string();
    assert!(error.contains("another cloud has the name") && error.contains("another name"), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn topic_with_foreign_publisher_or_type_is_refused() {
    let cloud = cloud().await;
    let node = foreign_node(&cloud).await;
    let qos = QosProfile::default();
    for (name, kind) in [("request_info", INFO_TYPE), ("request", "sensor_msgs/msg/Image")] {
        let hello = hello();
        let topic = topic(hello.pipeline.as_str(), name);
        let _publisher = node.create_publisher(&topic, kind, &qos).expect("a publisher");
        let error = open(&cloud.address(), hello, settings())
            .await
            .expect_err("another node publishes the topic")
            .to_string();
        assert!(
            error.contains(&format!("node /viewer on this host publishes topic {topic}"))
                && error.contains("ROS_NAMESPACE"),
            "{error}"
        );
    }
    let hello = hello();
    let topic = topic(hello.pipeline.as_str(), "response_info");
    let _publisher = node.create_publisher(&topic, "std_msgs/msg/String", &qos).expect("a publisher");
    let error =
        open(&cloud.address(), hello, settings()).await.expect_err("the topic has another type").to_string();
    assert!(error.contains("std_msgs/msg/String for node /viewer") && error.contains(&topic), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_of_second_publishers_are_dropped() {
    let mut cloud = cloud().await;
    let (session, pipeline) = session(&mut cloud).await;
    let node = foreign_node(&cloud).await;
    let publisher = node
        .create_publisher(&topic(&pipeline, "request_info"), INFO_TYPE, &QosProfile::default())
        .expect("a publisher");
    publisher.wait_for_peer(TIME_LIMIT).await.expect("the cloud subscribes");
    let goodbye = MessageInfo { kind: MessageInfo::GOODBYE, ..MessageInfo::default() };
    let goodbye = goodbye.encode(WireForm::Cdr).expect("can be written").into_bytes();
    // A header of CDR, and a body that is too short for any message.
    let malformed_message = Bytes::from_static(&[0, 1, 0, 0, 9]);
    for message in [goodbye, malformed_message] {
        publisher.publish(message, WallTime::from_unix_nanos(1)).await.expect("published");
    }
    publisher.wait_for_acknowledgment(TIME_LIMIT).await.expect("the cloud has the messages");
    echo(&mut cloud, &session, "the session goes on").await;
    wait_for_remark_on_second_publisher(&mut cloud, &session, "node /viewer", publisher.topic()).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn second_host_gets_reason_of_refusal() {
    assert_second_host_is_refused(cloud().await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn new_connection_of_same_pipeline_replaces_earlier_one() {
    replace_connections(cloud().await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn open_session_outlasts_hello_timeout() {
    let short_timeout = SessionSettings { hello_timeout_ms: 2_000, ..settings() };
    let mut cloud = Cloud::start_at(&crate::support::unused_address(TestNetwork::Ros2), short_timeout).await;
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

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn payloads_travel_in_companions_if_qos_is_incompatible() {
    let mut cloud = cloud().await;
    let (address, hello) = (cloud.address(), hello());
    let best_effort = settings_with(|ros2| ros2.reliability = Reliability::BestEffort);
    let edge = tokio::spawn(async move { open(&address, hello, best_effort).await });
    assert!(cloud.next_open().await.accept(accepted(cloud.host)));
    let session = within(edge).await.expect("no panic").expect("accepted");
    // The cloud requests reliable payloads, and the edge offers best effort only. Nevertheless no message is lost.
    for _ in 0..20 {
        exchange(&mut cloud, &session, picture(100_000)).await;
    }
    assert_eq!(session.statistics().lost_messages, 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn best_effort_payloads_are_answered_or_lost_within_deadline() {
    let best_effort = || {
        settings_with(|ros2| {
            ros2.reliability = Reliability::BestEffort;
            ros2.deadline_ms = Some(500);
        })
    };
    let mut cloud = Cloud::start_at(&crate::support::unused_address(TestNetwork::Ros2), best_effort()).await;
    let (address, hello) = (cloud.address(), hello());
    let edge = tokio::spawn(async move { open(&address, hello, best_effort()).await });
    assert!(cloud.next_open().await.accept(accepted(cloud.host)));
    let session = within(edge).await.expect("no panic").expect("accepted");
    let server_task = tokio::spawn(async move {
        while let Some(incoming) = cloud.listener.next().await {
            if let Incoming::Request(request) = incoming {
                request.reply.send(request.recorder, Ok(request.sample));
            }
        }
    });
    let (mut answered, mut lost) = (0, 0);
    for _ in 0..10 {
        let requests = (0..8).map(|_| {
            let session = session.clone();
            tokio::spawn(
                async move { session.request(recorder(), &picture(2_000_000), TIME_LIMIT).await.result },
            )
        });
        for request in requests.collect::<Vec<_>>() {
            match within(request).await.expect("no panic") {
                Ok(_) => answered += 1,
                Err(RequestError::Lost(_)) => lost += 1,
                Err(error) => panic!("neither answered nor lost: {error}"),
            }
        }
    }
    assert_eq!(answered + lost, 80);
    assert!(answered > 0, "{lost} lost");
    server_task.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn session_keeps_messages_for_subscriber_that_does_not_read() {
    let mut cloud = cloud().await;
    let (session, pipeline) = session(&mut cloud).await;
    let viewer = foreign_node(&cloud).await;
    // The subscription reads no message.
    let unread_subscription = viewer
        .create_subscription(
            &topic(&pipeline, "request"),
            "std_msgs/msg/UInt8MultiArray",
            &QosProfile::default(),
        )
        .expect("a subscription");
    for _ in 0..60 {
        let sample = Sample::from_part(Description::bytes(), Bytes::from(vec![1; 1_000_000]));
        exchange(&mut cloud, &session, sample).await;
    }
    assert_eq!(session.statistics().lost_messages, 0);
    drop(unread_subscription);
}
