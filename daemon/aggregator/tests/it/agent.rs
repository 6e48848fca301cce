//! The agent's end of the event stream, on a TCP socket.

use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{SharedClock, Span};
use peernet_logger::HostId;
use peernet_stream::codec::{decode, encode};
use peernet_stream::{
    Accounting, Action, Event, Hello, HostClock, HostMetrics, HostSecret, LinkLive, LiveUpdate, Notice,
    PipelineLive, Proof, Sending, SendingConfig, ToAgent, ToAggregator,
};
use zeromq::{Message, Options, Socket, SocketType};

use crate::generate;
use crate::spool::Spool;

/// Longest time that a step may take before its test fails.
const STEP_TIMEOUT: Duration = Duration::from_secs(30);

/// A test agent: the agents' state machine with a spool in memory and a socket.
pub(crate) struct Agent {
    pub(crate) id: HostId,
    pub(crate) sending: Sending,
    pub(crate) notices: Vec<Notice>,
    spool: Spool,
    socket: AgentSocket,
    clock: SharedClock,
}

/// Returns the secret of a host of these tests, which follows from its id.
pub(crate) fn secret_of(host: HostId) -> HostSecret {
    let id_bytes = host.as_bytes();
    HostSecret::from_bytes(std::array::from_fn(|n| id_bytes[n % id_bytes.len()]))
}

/// A connection to the aggregator.
pub(crate) struct AgentSocket(Socket);

impl AgentSocket {
    pub(crate) async fn connect(address: &str) -> Self {
        let socket = Socket::new(SocketType::Dealer, Options::default());
        socket.connect(address).await.expect("connects");
        Self(socket)
    }

    pub(crate) async fn send(&self, message: &ToAggregator) {
        self.send_frame(encode(message)).await;
    }

    pub(crate) async fn send_frame(&self, frame: impl Into<Bytes>) {
        self.0.send(Message::single(frame.into())).await.expect("sends");
    }

    /// Sends a hello and the proof; returns the aggregator's answer.
    pub(crate) async fn greet(&self, hello: &Hello) -> ToAgent {
        self.greet_with(hello, &secret_of(hello.host.id)).await
    }

    /// Same as [`Self::greet`] with any secret.
    pub(crate) async fn greet_with(&self, hello: &Hello, secret: &HostSecret) -> ToAgent {
        self.send(&ToAggregator::Hello(hello.clone())).await;
        let answer = self.receive().await;
        let ToAgent::Challenge { aggregator, nonce, enrol, .. } = answer else { return answer };
        let code = secret.prove(&nonce, hello, &aggregator);
        let secret = enrol.then(|| secret.clone());
        self.send(&ToAggregator::Proof(Proof { host: hello.host.id, nonce, code, secret })).await;
        self.receive().await
    }

    pub(crate) async fn receive(&self) -> ToAgent {
        let message =
            tokio::time::timeout(STEP_TIMEOUT, self.0.recv()).await.expect("in time").expect("receives");
        decode(message.part_slice(0).expect("a frame")).expect("a message")
    }
}

impl Agent {
    pub(crate) async fn new(name: &str, address: &str, clock: &SharedClock) -> Self {
        Self::with_id(HostId::random(), name, address, clock).await
    }

    pub(crate) async fn with_id(id: HostId, name: &str, address: &str, clock: &SharedClock) -> Self {
        let spool = Spool::new();
        // This socket does not report lost connections, so the agent detects them by its acknowledgement timeout.
        let ack_timeout = Span::from_millis(500);
        let config = SendingConfig { batch_nodes: 1_000, ack_timeout, ..SendingConfig::default() };
        let process = generate::Numbers::new(clock.mono().nanos() as u64).bits();
        let mut sending =
            Sending::new(config, generate::host(id, name), secret_of(id), process, spool.state());
        sending.on_connected(clock.mono());
        let socket = AgentSocket::connect(address).await;
        Self { id, sending, notices: Vec::new(), spool, socket, clock: SharedClock::clone(clock) }
    }

    /// Executes the actions of the state machine.
    async fn act(&mut self) {
        while let Some(action) = self.sending.next(self.clock.mono()) {
            if let Action::Send(frame) = action {
                self.socket.send_frame(frame).await;
            } else {
                self.notices.extend(self.spool.act(action, &mut self.sending, self.clock.stamp()));
            }
        }
    }

    pub(crate) fn offer(&mut self, events: impl IntoIterator<Item = Event>) {
        events.into_iter().for_each(|event| self.sending.offer(&event, self.clock.stamp()));
    }

    /// Exchanges messages with the aggregator until `is_done` is `true`; fails after `STEP_TIMEOUT`. `what` describes
    /// the condition in the panic message.
    pub(crate) async fn until(&mut self, what: &str, mut is_done: impl FnMut(&Self) -> bool) {
        let exchange = async {
            loop {
                self.sending.tick(self.clock.stamp());
                self.act().await;
                if is_done(self) {
                    return;
                }
                // `is_done` may also depend on the state of the aggregator, so it is called at least every 50 ms.
                let pause =
                    self.sending.deadline().map(|deadline| (deadline - self.clock.mono()).to_duration());
                tokio::select! {
                    message = self.socket.receive() => {
                        let notice = self.sending.on_message(&message, self.clock.stamp());
                        self.notices.extend(notice);
                    }
                    () = tokio::time::sleep(pause.unwrap_or(STEP_TIMEOUT).min(Duration::from_millis(50))) => {}
                }
            }
        };
        assert!(tokio::time::timeout(STEP_TIMEOUT, exchange).await.is_ok(), "waited in vain until {what}");
    }

    pub(crate) async fn until_up(&mut self) {
        self.until("the agent is welcome", |agent| agent.sending.is_up()).await;
    }

    /// Sends all events and waits until they are acknowledged.
    pub(crate) async fn until_stored(&mut self) {
        self.sending.flush(self.clock.wall());
        self.until("everything is stored", |agent| agent.sending.is_idle()).await;
    }

    /// Sends a live update.
    pub(crate) async fn live(&self, pipelines: Vec<PipelineLive>) {
        self.live_with(pipelines, vec![], HostClock::default()).await;
    }

    /// Sends a live update with links and the state of the clock.
    pub(crate) async fn live_with(
        &self,
        pipelines: Vec<PipelineLive>,
        links: Vec<LinkLive>,
        clock: HostClock,
    ) {
        let update = LiveUpdate {
            host: self.id,
            sent: self.clock.wall(),
            pipelines,
            links,
            clock,
            metrics: HostMetrics::default(),
            accounting: self.sending.accounting(),
        };
        self.socket.send(&ToAggregator::Live(update)).await;
    }

    /// Sends a goodbye.
    pub(crate) async fn goodbye(&self) {
        self.socket.send(&ToAggregator::Goodbye(self.id)).await;
    }

    pub(crate) fn accounting(&self) -> Accounting {
        self.sending.accounting()
    }
}
