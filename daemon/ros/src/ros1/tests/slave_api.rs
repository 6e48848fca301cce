//! Tests of calls from other nodes and tools to a node.

use super::{TestMaster, node, within};
use crate::messages::StringMessage;
use crate::ros1::rpc::{self, RpcError};
use crate::ros1::xmlrpc::Value;
use crate::ros1::{Node, PublisherOptions, RpcUri, SubscriberOptions, TopicType};

async fn call_method(node: &Node, method: &str, params: Vec<Value>) -> Result<Value, RpcError> {
    within(rpc::call(&RpcUri::parse(node.uri()).unwrap(), method, params)).await
}

/// Calls a method whose only parameter is the caller's name. Returns the value of the successful answer, which has the
/// form `[status, text, value]`.
async fn query(node: &Node, method: &str) -> Value {
    let Value::Array(parts) = call_method(node, method, vec!["/tool".into()]).await.unwrap() else {
        panic!("an array")
    };
    assert_eq!(parts[0], Value::Int(1));
    parts[2].clone()
}

#[tokio::test]
async fn slave_api_answers_queries_of_tools() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let subscriber = b.subscribe("t", kind, SubscriberOptions::default()).await.unwrap();
    within(publisher.wait_for_subscribers(1)).await.unwrap();
    within(subscriber.wait_for_publishers(1)).await.unwrap();

    assert_eq!(query(&a, "getPid").await, Value::Int(std::process::id().into()));
    assert_eq!(query(&a, "getMasterUri").await, master.uri().into());
    let topics = Value::from([Value::from(["/t".into(), "std_msgs/String".into()])]);
    assert_eq!(query(&a, "getPublications").await, topics);
    assert_eq!(query(&a, "getSubscriptions").await, Vec::new().into());
    assert_eq!(query(&b, "getSubscriptions").await, topics);

    let info = query(&a, "getBusInfo").await;
    let connection = info.as_array().unwrap()[0].as_array().unwrap();
    // Number of the connection, other end, direction (`o` for out), transport, topic.
    let expected: [Value; 5] = [Value::Int(1), "/b".into(), "o".into(), "TCPROS".into(), "/t".into()];
    assert_eq!(connection[..5], expected);
    let info = query(&b, "getBusInfo").await;
    let connection = info.as_array().unwrap()[0].as_array().unwrap();
    let (other_end, is_connected) = (&connection[1], &connection[5]);
    assert_eq!((other_end, is_connected), (&Value::from(a.uri()), &Value::Bool(true)));
    let statistics = query(&b, "getBusStats").await;
    // The statistics of publishers, of subscribers, and of services.
    assert_eq!(statistics.as_array().unwrap().len(), 3);

    let error = call_method(&a, "noSuchMethod", vec![]).await.unwrap_err();
    assert_eq!(error.to_string(), "fault -1: unknown method \"noSuchMethod\"");
}

#[tokio::test]
async fn unknown_topics_and_protocols_are_refused() {
    let master = TestMaster::start().await;
    let a = node(&master, "a").await;
    let _publisher = a
        .publish("t", TopicType::from_message::<StringMessage>(), PublisherOptions::default())
        .await
        .unwrap();
    for (topic, protocol, reason) in [
        ("/other", "TCPROS", "topic /other is not published by node /a"),
        ("/t", "UDPROS", "node /a offers TCPROS only, asked for [\"UDPROS\"]"),
    ] {
        let protocols = Value::from([Value::from([protocol.into()])]);
        let answer =
            call_method(&a, "requestTopic", vec!["/b".into(), topic.into(), protocols]).await.unwrap();
        assert_eq!(answer, [Value::Int(0), reason.into(), Value::Int(0)].into());
    }
}

#[tokio::test]
async fn node_shuts_down_when_asked() {
    let master = TestMaster::start().await;
    let a = node(&master, "a").await;
    let mut subscriber = a.subscribe("t", TopicType::any(), SubscriberOptions::default()).await.unwrap();
    call_method(&a, "shutdown", vec!["/rosnode".into(), "user request".into()]).await.unwrap();
    let expected = "the ROS node /a has ended: /rosnode asked it to shut down: user request";
    assert_eq!(within(a.ended()).await.to_string(), expected);
    assert_eq!(within(subscriber.recv()).await.unwrap_err().to_string(), expected);
    a.shutdown().await.unwrap();
    assert!(master.subscribers("/t").is_empty());
}

#[tokio::test]
async fn shutdown_for_duplicate_name_is_ignored_without_duplicate() {
    let master = TestMaster::start().await;
    let a = node(&master, "a").await;
    let publisher = a
        .publish("t", TopicType::from_message::<StringMessage>(), PublisherOptions::default())
        .await
        .unwrap();
    // The call is meant for another node, which has ended. This node has the port of that node.
    let reason = "[/camera] Reason: new node registered with same name";
    call_method(&a, "shutdown", vec!["/master".into(), reason.into()]).await.unwrap();

    // The late registration of a node of the same name, which has ended, makes the master ask this node to end. This
    // node finds no other running node of its name, and registers again.
    let ended_node = node(&master, "a").await;
    let late_registration = ["/a", "/u", "std_msgs/String", ended_node.uri()].map(Value::from);
    ended_node.shutdown().await.unwrap();
    within(rpc::call(&RpcUri::parse(&master.uri()).unwrap(), "registerPublisher", late_registration.into()))
        .await
        .unwrap();
    within(master.wait_until(|master| master.uri_of("/a").as_deref() == Some(a.uri()))).await;
    assert_eq!(master.publishers("/t"), ["/a"]);
    publisher.publish(vec![0; 4]).unwrap();
}

#[tokio::test]
async fn node_without_the_topic_does_not_count_as_running() {
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let publisher = a.publish("t", kind.clone(), PublisherOptions::default()).await.unwrap();
    let _subscriber = a.subscribe("u", kind, SubscriberOptions::default()).await.unwrap();
    let nodes = ["/a".to_owned(), "/none".to_owned()];
    assert_eq!(b.running_publishers("/t", &nodes).await.unwrap(), ["/a"]);
    assert_eq!(b.running_subscribers("/u", &nodes).await.unwrap(), ["/a"]);
    // At the port of a node that ended, another node with other topics answers.
    assert!(b.running_publishers("/u", &nodes).await.unwrap().is_empty());
    drop(publisher);
    assert!(b.running_publishers("/t", &nodes).await.unwrap().is_empty());
}
