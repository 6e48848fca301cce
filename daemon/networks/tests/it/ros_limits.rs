//! What nodes of ROS 1 without a session may take from those that have one.

use bytes::Bytes;
use peernet_networks::SessionSettings;
use peernet_ros::messages::{EncodedMessage, Header, Message, MessageInfo, SessionHello, Time, WireForm};
use peernet_ros::ros1::{Publisher, PublisherOptions, TopicType};
use peernet_sample::{Description, Sample};

use crate::ros::{exchange, foreign_node, session};
use crate::ros_master::RosMaster;
use crate::support::{Cloud, settings, within};

/// Bytes that all sessions of a cloud share here.
const SHARED: u64 = 1_000_000;

/// Connections that are opened and never become a session.
const OTHERS: usize = 40;

/// A companion of which the payload never comes.
fn half_a_message(sequence: u64, bytes: usize) -> EncodedMessage {
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
async fn connections_without_session_take_no_memory_from_sessions() {
    let master = RosMaster::start();
    let limits = SessionSettings { max_message_bytes: SHARED, max_unfinished_bytes: SHARED, ..settings() };
    let mut cloud = Cloud::start_at(&master.address(), limits).await;
    let (session, _) = session(&mut cloud).await;
    let node = foreign_node(&master, "crowd").await;
    let options = PublisherOptions::default();
    let kind = TopicType::of::<SessionHello>();
    let address = cloud.address().to_string();
    let name = address.rsplit('/').next().expect("a name");
    let hellos = node.publish(&format!("/{name}/sessions"), kind, options).await.expect("registered");
    within(hellos.wait_for_subscribers(1)).await.expect("the cloud subscribes");
    let mut publishers: Vec<Publisher> = Vec::new();
    for number in 0..OTHERS {
        let pipeline = format!("/crowd/line{number}");
        let topic = format!("{pipeline}/request_info");
        let publisher =
            node.publish(&topic, TopicType::of::<MessageInfo>(), options).await.expect("registered");
        let hello = SessionHello {
            header: Header { frame_id: "id".into(), ..Header::default() },
            node: node.name().to_owned(),
            host: "crowd".to_owned(),
            pipeline,
        };
        let hello = hello.encode(WireForm::Ros1).expect("can be written");
        within(hellos.publish_waiting(hello)).await.expect("the node runs");
        within(publisher.wait_for_subscribers(1)).await.expect("the cloud subscribes");
        for sequence in 0..4 {
            let sent = publisher.publish_waiting(half_a_message(sequence, 60_000));
            within(sent).await.expect("the node runs");
        }
        publishers.push(publisher);
    }
    for _ in 0..20 {
        let sample = Sample::of(Description::bytes(), Bytes::from(vec![1; 450_000]));
        assert_eq!(exchange(&mut cloud, &session, sample.clone()).await, sample);
    }
    assert_eq!(session.statistics().lost_messages, 0);
}
