//! An edge and a cloud on loopback, and a time limit for every operation.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_logger::{HostId, Recorder};
use peernet_networks::{
    Address, CompletedRequest, Incoming, IncomingRequest, Listener, OpenError, OpenRequest, PeerClock,
    Ros2SessionSettings, SESSION_VERSIONS, Session, SessionAccepted, SessionHello, SessionId,
    SessionSettings,
};
use peernet_sample::{Description, Sample};
use peernet_stream::{Hardware, VersionRange};

use crate::ros_master::RosMaster;

/// Time limit of every operation, far above what is needed. A test that hangs fails.
pub(crate) const TIME_LIMIT: Duration = Duration::from_secs(20);

/// Defines tests that call a function with a [`TestNetwork`]: one for each network whose listeners have ports.
macro_rules! over_every_network_with_ports {
    ($($name:ident),*) => {$(
        mod $name {
            #[tokio::test]
            async fn zmq_tcp() {
                super::$name(crate::support::TestNetwork::ZmqTcp).await;
            }

            #[tokio::test]
            async fn zmq_udp() {
                super::$name(crate::support::TestNetwork::ZmqUdp).await;
            }
        }
    )*};
}
pub(crate) use over_every_network_with_ports;

/// Defines tests that call a function with a [`TestNetwork`]: one for each network.
macro_rules! over_every_network {
    ($($name:ident),*) => {$(
        mod $name {
            #[tokio::test]
            async fn zmq_tcp() {
                super::$name(crate::support::TestNetwork::ZmqTcp).await;
            }

            #[tokio::test]
            async fn zmq_udp() {
                super::$name(crate::support::TestNetwork::ZmqUdp).await;
            }

            #[tokio::test]
            async fn ros1() {
                super::$name(crate::support::TestNetwork::Ros1).await;
            }

            #[cfg(feature = "ros2")]
            #[tokio::test]
            async fn ros2() {
                super::$name(crate::support::TestNetwork::Ros2).await;
            }
        }
    )*};
}
pub(crate) use over_every_network;

/// A network; for ROS, a network in one of its versions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TestNetwork {
    ZmqTcp,
    ZmqUdp,
    Ros1,
    #[cfg(feature = "ros2")]
    Ros2,
}

impl TestNetwork {
    /// Returns the scheme of the network's addresses.
    pub(crate) fn scheme(self) -> &'static str {
        match self {
            Self::ZmqTcp => "tcp",
            Self::ZmqUdp => "udp",
            Self::Ros1 => "ros1",
            #[cfg(feature = "ros2")]
            Self::Ros2 => "ros2",
        }
    }
}

/// Returns the address of a free port, of an unused name at a ROS 1 master, or of an unused name in a ROS 2 domain.
pub(crate) fn unused_address(network: TestNetwork) -> String {
    match network {
        TestNetwork::Ros1 => RosMaster::shared().address(),
        #[cfg(feature = "ros2")]
        TestNetwork::Ros2 => unused_ros2_address(),
        _ => format!("{}://127.0.0.1:0", network.scheme()),
    }
}

/// Returns an address in a ROS 2 domain that few other tests use, with a name that no other test uses in any process.
/// All tests use domains on the loopback interface. The domains are at most 100, because the ports of higher domains
/// may belong to other sockets.
#[cfg(feature = "ros2")]
fn unused_ros2_address() -> String {
    let (process, number) = (std::process::id(), next_number());
    format!("ros2://{}/cloud{process}n{number}", 1 + (process as usize * 37 + number) % 100)
}

/// Returns the result of an operation that must end within the time limit.
pub(crate) async fn within<T>(operation: impl Future<Output = T>) -> T {
    tokio::time::timeout(TIME_LIMIT, operation).await.expect("the test hangs")
}

pub(crate) fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")))
}

pub(crate) fn settings() -> SessionSettings {
    let ros2 = Ros2SessionSettings { interfaces: vec!["127.0.0.1".into()], ..Ros2SessionSettings::default() };
    SessionSettings { open_timeout_ms: 10_000, ros2, ..SessionSettings::default() }
}

/// Returns a number that no other call returns.
pub(crate) fn next_number() -> usize {
    static NUMBERS: AtomicUsize = AtomicUsize::new(1);
    NUMBERS.fetch_add(1, Ordering::Relaxed)
}

pub(crate) fn hello() -> SessionHello {
    SessionHello {
        versions: SESSION_VERSIONS,
        host: HostId::random(),
        name: "robot-1".parse().expect("a name"),
        clock: ClockIdentity::new("boot", "system"),
        // Each session of all processes has a separate pipeline, because ROS topics are named after the pipeline.
        pipeline: format!("line-{}-{}", std::process::id(), next_number()).parse().expect("a name"),
        model: Some("echo".parse().expect("a name")),
        device: None,
        clock_socket: None,
    }
}

pub(crate) fn accepted(host: HostId) -> SessionAccepted {
    SessionAccepted {
        host,
        name: "rack-1".parse().expect("a name"),
        clock: ClockIdentity::new("boot", "system"),
        version: "0.1.0".into(),
        model: "echo".parse().expect("a name"),
        device: "cpu".into(),
        facts: vec![("parameters".into(), "none".into())],
        host_clock: PeerClock { text: "left alone".into(), ..PeerClock::default() },
        probes: Some(8620),
        instance: 4,
        probe_key: None,
        conditions: Vec::new(),
        hardware: Hardware::default(),
    }
}

pub(crate) fn sample(text: &str) -> Sample {
    Sample::from_part(Description::bytes(), Bytes::copy_from_slice(text.as_bytes()))
}

pub(crate) fn text(sample: &Sample) -> &str {
    std::str::from_utf8(&sample.parts[0].bytes).expect("a text")
}

/// A cloud whose requests the test answers.
pub(crate) struct Cloud {
    pub(crate) host: HostId,
    pub(crate) listener: Listener,
    /// Remarks and refusals so far.
    pub(crate) remarks: Vec<String>,
}

impl Cloud {
    pub(crate) async fn start() -> Self {
        Self::on_network(TestNetwork::ZmqTcp).await
    }

    /// Starts a cloud at an unused address of a network.
    pub(crate) async fn on_network(network: TestNetwork) -> Self {
        Self::start_at(&unused_address(network), settings()).await
    }

    pub(crate) async fn start_at(address: &str, settings: SessionSettings) -> Self {
        Self::bind(address, settings, clock()).await
    }

    /// Starts a cloud that reads this clock.
    pub(crate) async fn start_with_clock(clock: SharedClock) -> Self {
        Self::bind("tcp://127.0.0.1:0", settings(), clock).await
    }

    async fn bind(address: &str, settings: SessionSettings, clock: SharedClock) -> Self {
        let (host, address) = (HostId::random(), address.parse().expect("an address"));
        let listener = Listener::bind(&address, settings, host, clock);
        let listener = within(listener).await.expect("the port is free");
        Self { host, listener, remarks: Vec::new() }
    }

    pub(crate) fn address(&self) -> Address {
        self.listener.address().clone()
    }

    pub(crate) async fn next(&mut self) -> Incoming {
        loop {
            match within(self.listener.next()).await.expect("the listener is open") {
                Incoming::Remark { text, .. } | Incoming::Refused { text, .. } => self.remarks.push(text),
                other => return other,
            }
        }
    }

    pub(crate) async fn next_open(&mut self) -> OpenRequest {
        match self.next().await {
            Incoming::Open(open) => open,
            other => panic!("expected a hello, not {other:?}"),
        }
    }

    pub(crate) async fn next_request(&mut self) -> IncomingRequest {
        match self.next().await {
            Incoming::Request(request) => request,
            other => panic!("expected a request, not {other:?}"),
        }
    }

    /// Returns the next session that ends, and whether its edge said goodbye.
    pub(crate) async fn next_closed(&mut self) -> (SessionId, bool) {
        match self.next().await {
            Incoming::Closed { session, said_goodbye, .. } => (session, said_goodbye),
            other => panic!("expected the end of a session, not {other:?}"),
        }
    }

    /// Opens a session with an edge that has these settings.
    pub(crate) async fn session(&mut self, settings: SessionSettings) -> (Session, SessionId) {
        let address = self.address();
        let edge = tokio::spawn(async move { open(&address, hello(), settings).await });
        let request = self.next_open().await;
        let id = request.session;
        assert!(request.accept(accepted(self.host)));
        (within(edge).await.expect("no panic").expect("accepted"), id)
    }

    /// Opens a session with an edge that reads this clock and supports these versions of the protocol.
    pub(crate) async fn session_with_clock(&mut self, clock: SharedClock, versions: VersionRange) -> Session {
        let edge = tokio::spawn(open_with_clock(self.address(), clock, versions));
        assert!(self.next_open().await.accept(accepted(self.host)));
        within(edge).await.expect("no panic").expect("accepted")
    }
}

pub(crate) async fn open(
    address: &Address,
    hello: SessionHello,
    settings: SessionSettings,
) -> Result<Session, OpenError> {
    within(Session::open(address, hello, settings, clock())).await
}

async fn open_with_clock(
    address: Address,
    clock: SharedClock,
    versions: VersionRange,
) -> Result<Session, OpenError> {
    let hello = SessionHello { versions, ..hello() };
    within(Session::open(&address, hello, settings(), clock)).await
}

pub(crate) fn recorder() -> Recorder {
    Recorder::new(clock(), HostId::random())
}

/// Starts a request in a separate task.
pub(crate) fn request(
    session: &Session,
    text: &str,
    timeout: Duration,
) -> tokio::task::JoinHandle<CompletedRequest> {
    let (session, sample) = (session.clone(), sample(text));
    tokio::spawn(async move { session.request(recorder(), &sample, timeout).await })
}

/// Sends a request and lets the cloud answer with the same sample, which shows that the session works.
pub(crate) async fn echo(cloud: &mut Cloud, session: &Session, content: &str) -> CompletedRequest {
    let pending = request(session, content, TIME_LIMIT);
    let incoming = cloud.next_request().await;
    incoming.reply.send(incoming.recorder, Ok(incoming.sample));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result.as_ref().map(text), Ok(content));
    completed
}
