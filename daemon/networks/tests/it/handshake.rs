//! Tests of opening and closing sessions.

use std::time::Duration;

use peernet_networks::{BindError, CloseReason, Listener, NetworkKind, OpenError, SessionSettings};

use crate::fake_cloud::FakeCloud;
use crate::support::{
    Cloud, TestNetwork, accepted, clock, echo, hello, open, over_every_network,
    over_every_network_with_ports, settings, unused_address, within,
};

over_every_network!(
    accepted_session_identifies_both_sides,
    dropping_last_clone_closes_session,
    refusal_arrives_with_reason,
    unreachable_cloud_is_reported_at_once,
    cloud_that_does_not_answer_times_out,
    sessions_beyond_limit_are_refused_until_one_closes
);

over_every_network_with_ports!(port_in_use_is_reported_with_advice);

async fn accepted_session_identifies_both_sides(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (address, expected) = (cloud.address(), hello());
    assert!(address.port() != 0 || address.ros_domain().is_some());
    let edge = tokio::spawn({
        let hello = expected.clone();
        async move { open(&address, hello, settings()).await }
    });
    let request = cloud.next_open().await;
    assert_eq!(request.hello, expected);
    let id = request.session;
    assert!(request.accept(accepted(cloud.host)));
    let session = within(edge).await.expect("no panic").expect("accepted");
    assert_eq!(*session.accepted(), accepted(cloud.host));

    within(session.close()).await;
    assert_eq!(within(session.closed()).await, CloseReason::Local);
    let (closed_session, said_goodbye) = cloud.next_closed().await;
    assert_eq!((closed_session, said_goodbye), (id, true));
}

async fn dropping_last_clone_closes_session(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, id) = cloud.session(settings()).await;
    let clone = session.clone();
    drop(session);
    echo(&mut cloud, &clone, "still open").await;
    drop(clone);
    let (closed_session, said_goodbye) = cloud.next_closed().await;
    assert_eq!((closed_session, said_goodbye), (id, true));
}

async fn refusal_arrives_with_reason(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let address = cloud.address();
    let edge = tokio::spawn(async move { open(&address, hello(), settings()).await });
    cloud.next_open().await.refuse("no model \"echo\"; there are: sleep, quality-control");
    let error = within(edge).await.expect("no panic").expect_err("refused");
    assert_eq!(
        error,
        OpenError::Refused {
            address: cloud.address(),
            reason: "no model \"echo\"; there are: sleep, quality-control".into()
        }
    );

    let address = cloud.address();
    let edge = tokio::spawn(async move { open(&address, hello(), settings()).await });
    drop(cloud.next_open().await);
    assert!(matches!(within(edge).await.expect("no panic"), Err(OpenError::Refused { .. })));
}

async fn unreachable_cloud_is_reported_at_once(network: TestNetwork) {
    let cloud = Cloud::on_network(network).await;
    let address = cloud.address();
    cloud.listener.close().await;
    let error = open(&address, hello(), settings()).await.expect_err("nobody listens");
    let OpenError::Unreachable { reason, .. } = &error else { panic!("{error}") };
    let expected = match network.scheme() {
        "ros1" => "knows no cloud",
        "ros2" => "has no cloud",
        _ => "refused",
    };
    assert!(reason.contains(expected), "{reason}");

    let unknown_address = match network.scheme() {
        "ros2" => "ros2://0/nobody".to_owned(),
        scheme => format!("{scheme}://no-such-host.invalid:5551"),
    };
    let unknown_address = unknown_address.parse().expect("an address");
    let error = open(&unknown_address, hello(), settings()).await.expect_err("no such host");
    assert!(matches!(error, OpenError::Unreachable { .. }), "{error}");
}

async fn cloud_that_does_not_answer_times_out(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    // A ROS node asks its master several times, or searches for the cloud, before it can ask for a session.
    let timeout_ms = if network.scheme().starts_with("ros") { 3_000 } else { 200 };
    let short_timeout = SessionSettings { open_timeout_ms: timeout_ms, ..settings() };
    let address = cloud.address();
    let edge = tokio::spawn(async move { open(&address, hello(), short_timeout).await });
    let unanswered = cloud.next_open().await;
    let error = within(edge).await.expect("no panic").expect_err("no answer");
    let address = cloud.address();
    let reason = format!("no answer arrived within {timeout_ms} ms");
    assert_eq!(error, OpenError::Unanswered { address, reason });
    assert_eq!(cloud.next_closed().await.0, unanswered.session);
    assert!(!unanswered.accept(accepted(cloud.host)), "the edge is gone");
}

/// Opens a session at a ROUTER with this identity. The ROUTER closes after the request for the session has arrived.
async fn open_at_router_that_closes(identity: &'static str) -> OpenError {
    let router = FakeCloud::start_with_identity(identity).await;
    let address = router.address.clone();
    let edge = tokio::spawn(async move { open(&address, hello(), settings()).await });
    router.receive_message().await;
    drop(router);
    within(edge).await.expect("no panic").expect_err("no answer")
}

#[tokio::test]
async fn error_says_that_cloud_died_while_loading_model() {
    let error = open_at_router_that_closes("peernet-serve").await;
    assert!(matches!(error, OpenError::Ended { .. }), "{error:?}");
    let text = error.to_string();
    assert!(text.contains("killed while it loaded the model") && !text.contains("aggregator"), "{text}");
}

#[tokio::test]
async fn error_for_port_without_identity_suggests_aggregator() {
    let error = open_at_router_that_closes("").await;
    assert!(matches!(error, OpenError::TimedOut { .. }), "{error:?}");
    assert!(error.to_string().contains("port of an aggregator"), "{error}");
}

async fn port_in_use_is_reported_with_advice(network: TestNetwork) {
    let cloud = Cloud::on_network(network).await;
    let result = Listener::bind(&cloud.address(), settings(), cloud.host, clock()).await;
    let error = result.expect_err("the port is taken");
    assert_eq!(error, BindError::InUse(cloud.address()));
    assert!(error.to_string().contains("another program uses port"), "{error}");

    let foreign_address = format!("{}://192.0.2.1:0", network.scheme());
    let foreign_address = foreign_address.parse().expect("an address");
    let error = Listener::bind(&foreign_address, settings(), cloud.host, clock()).await;
    assert_eq!(error.expect_err("the address belongs to no machine"), BindError::NotLocal(foreign_address));
}

async fn sessions_beyond_limit_are_refused_until_one_closes(network: TestNetwork) {
    let one_session = SessionSettings { max_sessions: 1, ..settings() };
    let mut cloud = Cloud::start_at(&unused_address(network), one_session).await;
    let (first_session, _) = cloud.session(settings()).await;
    let address = cloud.address();
    let second_session = tokio::spawn(async move { open(&address, hello(), settings()).await });
    let result = tokio::select! {
        result = within(second_session) => result.expect("no panic"),
        incoming = cloud.next() => panic!("the listener returned {incoming:?}"),
    };
    let error = result.expect_err("one session is the limit").to_string();
    assert!(error.contains("max_sessions"), "{error}");
    within(first_session.close()).await;
    cloud.next_closed().await;
    let (third_session, _) = within(cloud.session(settings())).await;
    let completed = echo(&mut cloud, &third_session, "in").await;
    assert!(completed.arrived_at.is_some());
}

#[tokio::test]
async fn settings_refuse_unknown_keys_and_have_defaults() {
    let parse = |text: &str| serde_json::from_str::<SessionSettings>(text);
    assert_eq!(parse("{}").expect("all defaults"), SessionSettings::default());
    assert!(parse(r#"{"max_message_byte": 1}"#).is_err());
    let kind: NetworkKind = serde_json::from_str("\"zmq-tcp\"").expect("the kind's name");
    assert_eq!(kind.to_string(), "zmq-tcp");
    assert_eq!(
        Duration::from_millis(SessionSettings::default().heartbeat_timeout_ms),
        Duration::from_secs(5)
    );
}
