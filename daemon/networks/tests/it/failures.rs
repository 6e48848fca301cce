//! Tests of peers and connections that go away.

use std::sync::Arc;

use peernet_networks::{Address, CloseReason, RequestError, SessionSettings};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;

use crate::support::{
    Cloud, TIME_LIMIT, TestNetwork, accepted, echo, hello, open, over_every_network, recorder, request,
    sample, settings, within,
};

over_every_network!(
    killed_cloud_fails_requests_in_flight_at_once,
    restarted_cloud_accepts_new_session_on_same_port,
    vanished_edge_closes_its_sessions
);

async fn killed_cloud_fails_requests_in_flight_at_once(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;
    let pending: Vec<_> = (0..5).map(|n| request(&session, &n.to_string(), TIME_LIMIT)).collect();
    let mut held_requests = Vec::new();
    for _ in 0..5 {
        held_requests.push(cloud.next_request().await);
    }
    drop(cloud);
    for pending in pending {
        let completed = within(pending).await.expect("no panic");
        assert!(matches!(completed.result, Err(RequestError::Lost(_))), "{:?}", completed.result);
    }
    assert!(matches!(within(session.closed()).await, CloseReason::Broken(_)));
    assert_eq!(session.statistics().lost_messages, 5);

    let completed = within(session.request(recorder(), &sample("too late"), TIME_LIMIT)).await;
    assert!(matches!(completed.result, Err(RequestError::Lost(_))), "{:?}", completed.result);
    // Answers to a listener that is gone are dropped without an error.
    for request in held_requests {
        request.reply.send(request.recorder, Ok(request.sample));
    }
}

async fn restarted_cloud_accepts_new_session_on_same_port(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (old_session, _) = cloud.session(settings()).await;
    let address = cloud.address();
    echo(&mut cloud, &old_session, "before").await;
    drop(cloud);
    assert!(matches!(within(old_session.closed()).await, CloseReason::Broken(_)));

    let mut cloud = restart(&address).await;
    let (new_session, _) = cloud.session(settings()).await;
    echo(&mut cloud, &new_session, "after").await;
}

/// Starts a cloud on the port of an earlier cloud. The port is free as soon as the task of the old listener has ended.
async fn restart(address: &Address) -> Cloud {
    let is_taken = || match address.scheme() {
        // Binding itself asks the master or the domain whether an earlier cloud exists.
        "ros1" | "ros2" => false,
        "udp" => std::net::UdpSocket::bind(address.authority()).is_err(),
        _ => std::net::TcpListener::bind(address.authority()).is_err(),
    };
    within(async {
        while is_taken() {
            tokio::task::yield_now().await;
        }
    })
    .await;
    Cloud::start_at(&address.to_string(), settings()).await
}

async fn vanished_edge_closes_its_sessions(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let address = cloud.address();
    // The edge's runtime is dropped with all its sockets, without a goodbye.
    let edge = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let session = runtime.block_on(open(&address, hello(), settings())).expect("accepted");
        runtime.shutdown_background();
        std::mem::forget(session);
    });
    let request = cloud.next_open().await;
    let id = request.session;
    request.accept(accepted(cloud.host));
    let (closed_session, said_goodbye) = cloud.next_closed().await;
    assert_eq!((closed_session, said_goodbye), (id, false));
    edge.join().expect("no panic");
}

#[tokio::test]
async fn silent_connection_ends_after_heartbeat_timeout() {
    let mut cloud = Cloud::start().await;
    let relay = SilencingRelay::start(cloud.address()).await;
    let short_heartbeats =
        SessionSettings { heartbeat_interval_ms: 50, heartbeat_timeout_ms: 200, ..settings() };
    let address = relay.address.clone();
    let edge = tokio::spawn(async move { open(&address, hello(), short_heartbeats).await });
    cloud.next_open().await.accept(accepted(cloud.host));
    let session = within(edge).await.expect("no panic").expect("accepted");
    echo(&mut cloud, &session, "the wire works").await;

    let pending = request(&session, "the wire is cut", TIME_LIMIT);
    let _unanswered = cloud.next_request().await;
    relay.cut.notify_waiters();
    let completed = within(pending).await.expect("no panic");
    assert!(matches!(completed.result, Err(RequestError::Lost(_))), "{:?}", completed.result);
    assert!(matches!(within(session.closed()).await, CloseReason::Broken(_)));
}

/// A relay between an edge and a cloud. The relay can become silent without closing its connections, as if a cable were
/// pulled.
struct SilencingRelay {
    address: Address,
    cut: Arc<Notify>,
}

impl SilencingRelay {
    async fn start(cloud: Address) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let local_address = listener.local_addr().expect("bound");
        let cut = Arc::new(Notify::new());
        let cut_receiver = cut.clone();
        tokio::spawn(async move {
            let (mut edge, _) = listener.accept().await.expect("the edge connects");
            let mut cloud =
                TcpStream::connect((cloud.host(), cloud.port())).await.expect("the cloud listens");
            tokio::select! {
                _ = tokio::io::copy_bidirectional(&mut edge, &mut cloud) => {}
                () = cut_receiver.notified() => std::future::pending().await,
            }
        });
        Self { address: Address::from_ip(local_address.ip(), local_address.port()), cut }
    }
}
