//! Fills a database with several short runs and one long run of one agent. They reach the aggregator over an event
//! stream, as the runs of a real agent do.

use std::path::Path;

use bytes::Bytes;
use peernet_clock::{SharedClock, Span};
use peernet_logger::{HostId, RunId};
use peernet_stream::{
    BatchHead, ChainHash, EndReason, Event, ExperimentPosition, Hello, HostSecret, Incident, IncidentKind,
    Outcome, Proof, RunEnded, STREAM_VERSIONS, StreamId, ToAgent, ToAggregator, codec,
};
use tokio_util::sync::CancellationToken;
use zeromq::{Message, Options, Socket, SocketType};

use crate::{clocks, generate, start};

/// Number of nodes of an iteration.
const NODES_PER_ITERATION: u64 = 21;
/// Number of iterations per batch; such a batch has about 100 kB.
const ITERATIONS_PER_BATCH: u64 = 240;
/// Iterations per second.
const HZ: u64 = 100;
/// One in this many iterations ends with a timeout.
const TIMEOUT_EVERY: u64 = 1_000;
/// Number of short runs before the long run. The short runs form one experiment, and fill the lists on pages.
const SHORT_RUNS: u32 = 100;
/// Number of configurations of the experiment; each has two repeats.
const CONFIGURATIONS: u32 = SHORT_RUNS / 2;

/// Ingests about `nodes` nodes into a new database.
pub(crate) async fn fill(database: &Path, nodes: u64, clock: &SharedClock) {
    let stop = CancellationToken::new();
    let running = start(database, clock, stop.clone()).await;
    let address = running.handle.live().borrow().listening.clone();
    let mut agent = Agent::connect(&address).await;
    for number in 0..SHORT_RUNS {
        let position = ExperimentPosition {
            name: "grid".to_owned(),
            id: "1".to_owned(),
            configuration: vec![("size".to_owned(), format!("{} kB", number % CONFIGURATIONS))],
            repeat: number / CONFIGURATIONS,
            ..ExperimentPosition::default()
        };
        agent.run(ITERATIONS_PER_BATCH * NODES_PER_ITERATION, Some(position)).await;
    }
    agent.run(nodes, None).await;
    agent.wait_until_stored().await;
    stop.cancel();
    running.join().await.expect("ends well");
}

/// An agent: the sending end of an event stream.
struct Agent {
    socket: Socket,
    /// The edge host and the cloud host.
    hosts: (HostId, HostId),
    stream: StreamId,
    chain: ChainHash,
    /// Number of the newest batch that was sent.
    newest_sent: u64,
    /// Number of events in all batches so far.
    events: u64,
    /// Number of the newest batch that was acknowledged.
    newest_acknowledged: u64,
    /// Maximum number of batches that may be sent and not yet acknowledged.
    window: u32,
    /// Source of the iterations' values.
    numbers: generate::Numbers,
    /// Time on the edge's clock, seconds since the start of the first run.
    time_s: i64,
}

impl Agent {
    async fn connect(address: &str) -> Self {
        let socket = Socket::new(SocketType::Dealer, Options::default());
        socket.connect(address).await.expect("connects");
        let (edge, cloud, stream) = (HostId::random(), HostId::random(), StreamId::random());
        let hello = Hello {
            protocol: STREAM_VERSIONS.oldest(),
            host: generate::host(edge, "edge"),
            stream,
            previous_stream: None,
            first: 1,
            oldest: 1,
            chain_before_oldest: ChainHash::START,
            events_before_oldest: 0,
            events_before_first: Some(0),
            batch_bytes: 128 * 1024,
            process: 1,
            extension: None,
        };
        let greeting = codec::encode(&ToAggregator::Hello(hello.clone()));
        socket.send(Message::single(Bytes::from(greeting))).await.expect("sends");
        let mut agent = Self {
            socket,
            hosts: (edge, cloud),
            stream,
            chain: ChainHash::START,
            newest_sent: 0,
            events: 0,
            newest_acknowledged: 0,
            window: 0,
            numbers: generate::Numbers::new(1),
            time_s: 0,
        };
        let ToAgent::Challenge { aggregator, nonce, .. } = agent.receive().await else {
            panic!("no challenge")
        };
        let secret = HostSecret::random();
        let code = secret.prove(&nonce, &hello, &aggregator);
        let proof = ToAggregator::Proof(Proof { host: edge, nonce, code, secret: Some(secret) });
        agent.socket.send(Message::single(Bytes::from(codec::encode(&proof)))).await.expect("sends");
        let ToAgent::Welcome { window, .. } = agent.receive().await else { panic!("not welcome") };
        agent.window = window;
        agent
    }

    /// Sends a run of about `nodes` nodes at `HZ` iterations per second of the edge's clock, with a clock sample each
    /// second.
    async fn run(&mut self, nodes: u64, position: Option<ExperimentPosition>) {
        let run = RunId::random();
        let start_s = self.time_s;
        let mut events = vec![generate::run_started(run, "line", generate::at(start_s as f64))];
        if let Some(Event::RunStarted(description)) = events.first_mut() {
            description.experiment = position.map(Box::new);
        }
        for number in 1..=nodes.div_ceil(NODES_PER_ITERATION) {
            let at = generate::at(start_s as f64) + Span::from_seconds_f64(number as f64 / HZ as f64);
            let mut iteration = generate::iteration_at(run, number, self.hosts, at, &mut self.numbers);
            if number.is_multiple_of(TIMEOUT_EVERY) {
                iteration.outcome = Outcome::Timeout(String::new());
                events.push(Event::Incident(self.incident(run)));
            }
            events.push(Event::Iteration(iteration));
            if number.is_multiple_of(HZ) {
                self.time_s += 1;
                let half_width_us = 30;
                let sample = clocks::sample(self.hosts.1, self.time_s, half_width_us);
                events.push(Event::Clock(Box::new(sample)));
            }
            if number.is_multiple_of(ITERATIONS_PER_BATCH) {
                self.send(&std::mem::take(&mut events)).await;
            }
        }
        self.time_s += 1;
        let ended = generate::at(self.time_s as f64);
        events.push(Event::RunEnded(RunEnded { run, ended, reason: EndReason::Finished }));
        self.send(&events).await;
    }

    /// Returns the incident that accompanies a timeout.
    fn incident(&self, run: RunId) -> Incident {
        Incident {
            at: generate::at(self.time_s as f64),
            kind: IncidentKind::Disconnected,
            pipeline: Some("line".parse().expect("a name")),
            run: Some(run),
            peer: Some(self.hosts.1),
            text: "no answer in time".to_owned(),
        }
    }

    /// Sends one batch as soon as the window has capacity.
    async fn send(&mut self, events: &[Event]) {
        if events.is_empty() {
            return;
        }
        while self.newest_sent >= self.newest_acknowledged + u64::from(self.window) {
            self.handle_acknowledgement().await;
        }
        self.newest_sent += 1;
        let body = generate::body(events);
        let count = u32::try_from(events.len()).expect("a batch");
        let previous_chain = self.chain;
        self.chain = previous_chain.next(count, &body);
        let (host, stream, number, chain) = (self.hosts.0, self.stream, self.newest_sent, self.chain);
        let events_before = self.events;
        let head = BatchHead {
            host,
            stream,
            process: 1,
            number,
            previous_chain,
            chain,
            events: count,
            events_before,
        };
        self.events = head.events_through();
        let compress = false;
        let frame = Bytes::from(codec::encode_batch(&head, &body, compress));
        self.socket.send(Message::single(frame)).await.expect("sends");
    }

    /// Waits until all batches are acknowledged.
    async fn wait_until_stored(&mut self) {
        while self.newest_acknowledged < self.newest_sent {
            self.handle_acknowledgement().await;
        }
    }

    /// Processes the next acknowledgement.
    async fn handle_acknowledgement(&mut self) {
        match self.receive().await {
            ToAgent::Ack { stream, through, window } if stream == self.stream => {
                (self.newest_acknowledged, self.window) = (through, window);
            }
            other => panic!("unexpected {other:?}"),
        }
    }

    async fn receive(&self) -> ToAgent {
        let message = self.socket.recv().await.expect("receives");
        codec::decode(message.part_slice(0).expect("a frame")).expect("a message")
    }
}
