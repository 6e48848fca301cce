//! Tests of the identity of a cloud: delays are judged by the clock of the process that serves the data.

use peernet_clock::{ClockIdentity, SharedClock};
use peernet_logger::HostId;
use peernet_networks::{Incoming, Listener, OpenRequest, PeerClock, SessionAccepted, SessionSettings};
use peernet_probes::{Reflector, ReflectorConfig, TimestampSource};
use peernet_stream::{EstimateBasis, Hardware, Probing};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::harness::{TestAgent, clock, config};

/// A cloud that accepts sessions and answers no request.
struct Cloud {
    listener: Listener,
    host: HostId,
    clock: SharedClock,
    /// Identifies the process.
    instance: u64,
    /// Port of the reflector that answers the probes of the edge.
    probe_port: Option<u16>,
}

impl Cloud {
    async fn start(host: HostId, instance: u64, probe_port: Option<u16>) -> Self {
        let clock = clock("cloud");
        let address = "tcp://127.0.0.1:0".parse().expect("an address");
        let settings = SessionSettings::default();
        let listener = Listener::bind(&address, settings, host, clock.clone()).await;
        Self { listener: listener.expect("a free port"), host, clock, instance, probe_port }
    }

    fn pipeline(&self, name: &str) -> String {
        format!(
            "[[pipeline]]\nname = '{name}'\nsensor = {{ kind = 'synthetic', size_bytes = 100 }}\n\
             placement = {{ kind = 'remote', peer = '{}', model = 'echo' }}\n\
             warm_up = {{ iterations = 0 }}\n",
            self.listener.address()
        )
    }

    async fn next_open(&mut self) -> OpenRequest {
        loop {
            if let Incoming::Open(open) = self.listener.next().await.expect("the listener is open") {
                return open;
            }
        }
    }

    fn accept(&self, open: OpenRequest) {
        let identity: &ClockIdentity = self.clock.identity();
        let model = open.hello.model.clone().expect("the pipeline names a model");
        assert!(open.accept(SessionAccepted {
            host: self.host,
            name: "cloud".parse().expect("a name"),
            clock: identity.clone(),
            version: "0".to_owned(),
            model,
            device: "cpu".to_owned(),
            facts: Vec::new(),
            host_clock: PeerClock::default(),
            probes: self.probe_port,
            instance: self.instance,
            probe_key: None,
            conditions: Vec::new(),
            hardware: Hardware::default(),
        }));
    }

    /// Keeps the sessions open until the returned task is aborted.
    fn keep_open(mut self) -> JoinHandle<()> {
        tokio::spawn(async move { while self.listener.next().await.is_some() {} })
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn answers_of_another_process_are_refused_and_reported() {
    let listen = "127.0.0.1:0".parse().expect("an address");
    let reflector_config = ReflectorConfig {
        listen,
        key: None,
        session_key: None,
        instance: 2,
        max_per_source_hz: 1000,
        stamps: TimestampSource::Kernel,
        stateful: true,
    };
    let reflector = Reflector::bind(reflector_config, clock("elsewhere")).expect("a free port");
    let (port, answers) = (reflector.address().port(), reflector.counters());
    let stop = CancellationToken::new();
    let reflecting = tokio::spawn(reflector.run(stop.clone()));

    let mut cloud = Cloud::start(HostId::random(), 1, Some(port)).await;
    let edge = TestAgent::start_with_clock_name("edge", None, config(&cloud.pipeline("line")), "edge").await;
    let open = cloud.next_open().await;
    cloud.accept(open);
    let cloud = cloud.keep_open();
    let is_refused = |probing: &Probing| {
        let Probing::Unanswered { reason: Some(reason), .. } = probing else { return false };
        reason.contains("another process")
    };
    let live = edge.until(|live| live.links.iter().any(|link| is_refused(&link.probing))).await;
    assert!(answers.read().answered > 0, "the other process answered probes");
    // This session has no key, as with clouds of earlier releases.
    let is_unauthenticated = |basis: EstimateBasis| basis.probes_authenticated == Some(false);
    edge.until(|live| live.links.iter().any(|link| link.latest_sample.basis.is_some_and(is_unauthenticated)))
        .await;
    let sample = &live.links[0].latest_sample;
    assert_eq!(
        (sample.probes.answered, sample.exchanges.accepted, &sample.offset),
        (0, 0, &None),
        "the link used no answer of the other process"
    );

    edge.stop().await.expect("stops well");
    cloud.abort();
    stop.cancel();
    reflecting.await.expect("no panic").expect("the socket was not lost");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn restarted_cloud_does_not_join_link_of_hanging_session() {
    let host = HostId::random();
    let mut old_cloud = Cloud::start(host, 1, None).await;
    let mut new_cloud = Cloud::start(host, 2, None).await;
    let tables = config(&format!("{}{}", old_cloud.pipeline("first"), new_cloud.pipeline("second")));
    let edge = TestAgent::start_with_clock_name("edge", None, tables, "edge").await;
    let open = old_cloud.next_open().await;
    old_cloud.accept(open);
    let old_cloud = old_cloud.keep_open();
    let has_pipeline = |name: &'static str| {
        move |live: &peernet_stream::LiveUpdate| {
            live.links.iter().any(|link| link.pipelines.iter().any(|pipeline| pipeline.as_str() == name))
        }
    };
    edge.until(has_pipeline("first")).await;
    let open = new_cloud.next_open().await;
    new_cloud.accept(open);
    let new_cloud = new_cloud.keep_open();
    let live = edge.until(has_pipeline("second")).await;
    // The link of the new process has replaced the link of the old process.
    let [link] = &live.links[..] else { panic!("{:?}", live.links) };
    assert_eq!(link.pipelines.len(), 1, "{link:?}");

    edge.stop().await.expect("stops well");
    old_cloud.abort();
    new_cloud.abort();
}
