//! A peer that sends arbitrary messages of the event stream's protocol over a real socket.

use std::fmt::Debug;
use std::sync::OnceLock;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::ClockIdentity;
use peernet_logger::HostId;
use peernet_stream::{
    BatchHead, ChainHash, Event, Hardware, Hello, HostDescription, HostSecret, Incident, IncidentKind, Proof,
    STREAM_VERSIONS, StreamId, ToAgent, ToAggregator, codec,
};
use tokio::runtime::{Builder, Runtime};
use zeromq::{Message, Options, Socket, SocketType};

use crate::{Stopwatch, TEST_TIMEOUT, TestRng, wall};

/// Time after which an agent repeats its hello.
const HELLO_INTERVAL: Duration = Duration::from_secs(1);

/// Connection to an aggregator.
pub struct MisbehavingPeer {
    socket: Socket,
}

/// Returns the runtime whose threads keep connections alive while the test does something else.
fn runtime() -> &'static Runtime {
    static RUNTIME: OnceLock<Runtime> = OnceLock::new();
    RUNTIME.get_or_init(|| {
        Builder::new_multi_thread().worker_threads(2).enable_all().build().expect("a runtime")
    })
}

impl Debug for MisbehavingPeer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("MisbehavingPeer")
    }
}

impl MisbehavingPeer {
    /// Connects to a port of this machine.
    ///
    /// # Panics
    /// If the connection fails.
    pub fn connect(port: u16) -> Self {
        let socket = runtime().block_on(async {
            let socket = Socket::new(SocketType::Dealer, Options::default());
            socket.connect(format!("tcp://127.0.0.1:{port}")).await.expect("connects");
            socket
        });
        Self { socket }
    }

    /// Sends a frame.
    ///
    /// # Panics
    /// If the socket is closed.
    pub fn send(&self, frame: &[u8]) {
        let message = Message::single(Bytes::copy_from_slice(frame));
        runtime().block_on(self.socket.send(message)).expect("sends");
    }

    /// Sends a message.
    pub fn send_message(&self, message: &ToAggregator) {
        self.send(&codec::encode(message));
    }

    /// Receives the next message.
    ///
    /// # Panics
    /// If none arrives within [`TEST_TIMEOUT`].
    pub fn receive(&self) -> ToAgent {
        self.receive_within(TEST_TIMEOUT).expect("an answer in time")
    }

    fn receive_within(&self, timeout: Duration) -> Option<ToAgent> {
        let result = runtime().block_on(async { tokio::time::timeout(timeout, self.socket.recv()).await });
        let message = result.ok()?.expect("receives");
        Some(codec::decode(message.part_slice(0).expect("a frame")).expect("a message of the aggregator"))
    }

    /// Answers a challenge for the stream of `hello` with the proof of its host. Returns whether `message` is a
    /// challenge; a challenge for another stream is one, too, but is not answered.
    pub fn answer_challenge(&self, hello: &Hello, secret: &HostSecret, message: &ToAgent) -> bool {
        let ToAgent::Challenge { aggregator, stream, nonce, enrol, .. } = message else { return false };
        if *stream == hello.stream {
            let (host, nonce) = (hello.host.id, *nonce);
            let code = secret.prove(&nonce, hello, aggregator);
            let secret = enrol.then(|| secret.clone());
            self.send_message(&ToAggregator::Proof(Proof { host, nonce, code, secret }));
        }
        true
    }

    /// Sends a hello and its proof until an answer fulfils `condition`. The hello is repeated, as
    /// agents repeat it, because an aggregator with full queues does not answer.
    ///
    /// # Panics
    /// If no answer fulfils it within [`TEST_TIMEOUT`].
    pub fn send_hello_until(&self, host: &InventedHost, condition: impl Fn(&ToAgent) -> bool) {
        let hello = &host.hello;
        let stopwatch = Stopwatch::start();
        while stopwatch.elapsed() < TEST_TIMEOUT {
            self.send_message(&ToAggregator::Hello(hello.clone()));
            while let Some(message) = self.receive_within(HELLO_INTERVAL) {
                if condition(&message) {
                    return;
                }
                self.answer_challenge(hello, &host.secret, &message);
            }
        }
        panic!("no answer to the hello of {} fulfilled the condition", hello.host.name);
    }

    /// Receives messages until `condition` returns a value, and returns that value.
    pub fn receive_until<T>(&self, mut condition: impl FnMut(&ToAgent) -> Option<T>) -> T {
        loop {
            if let Some(value) = condition(&self.receive()) {
                return value;
            }
        }
    }

    /// Waits until all batches up to a number are acknowledged.
    pub fn wait_for_ack(&self, number: u64) {
        self.receive_until(|message| {
            matches!(message, ToAgent::Ack { through, .. } if *through >= number).then_some(())
        });
    }

    /// Waits for a refusal and returns its reason.
    pub fn wait_for_refusal(&self) -> String {
        self.receive_until(|message| match message {
            ToAgent::Refused { reason } => Some(reason.clone()),
            _ => None,
        })
    }
}

/// Invented host with a stream of batches.
#[derive(Clone, Debug)]
pub struct InventedHost {
    /// The hello with which it opens the session.
    pub hello: Hello,
    /// The secret with which it proves its id.
    pub secret: HostSecret,
    /// Number and chain hash of the newest batch.
    newest: (u64, ChainHash),
    /// Number of events in all batches up to the newest.
    events: u64,
}

impl InventedHost {
    /// Creates a host with a new stream.
    pub fn new(name: &str, rng: &mut TestRng) -> Self {
        let host = HostDescription {
            id: HostId::random(),
            name: name.parse().expect("a name"),
            clock: ClockIdentity::new("boot", "test"),
            version: "0.1.0".into(),
            hardware: Hardware { cpu: "test".into(), cores: 2, ..Hardware::default() },
            serves: None,
            models: vec![],
        };
        let hello = Hello {
            protocol: STREAM_VERSIONS.oldest(),
            host,
            stream: StreamId::random(),
            previous_stream: None,
            first: 1,
            oldest: 1,
            chain_before_oldest: ChainHash::START,
            events_before_oldest: 0,
            events_before_first: Some(0),
            batch_bytes: 128 << 10,
            process: rng.bits(),
            extension: None,
        };
        Self { hello, secret: HostSecret::random(), newest: (0, ChainHash::START), events: 0 }
    }

    /// Sends the hello and waits until the host is welcomed.
    pub fn open_session(&self, misbehaving_peer: &MisbehavingPeer) {
        misbehaving_peer.send_hello_until(self, |message| matches!(message, ToAgent::Welcome { .. }));
    }

    /// Returns the next batch of the stream, with `events` generated events.
    pub fn batch(&mut self, events: u32) -> Vec<u8> {
        let text = |n: u32| format!("event {n} of batch {}", self.newest.0 + 1);
        let body: Vec<u8> = (0..events)
            .flat_map(|n| {
                let incident = Incident {
                    at: wall(),
                    kind: IncidentKind::Connected,
                    pipeline: None,
                    run: None,
                    peer: None,
                    text: text(n),
                };
                rmp_serde::to_vec(&Event::Incident(incident)).expect("plain data serialises")
            })
            .collect();
        let compress = false;
        self.batch_of(events, &body, compress)
    }

    /// Sends the hello until it is refused; returns the reason.
    pub fn expect_refusal(&self, misbehaving_peer: &MisbehavingPeer) -> String {
        let received_reason = std::cell::RefCell::new(String::new());
        misbehaving_peer.send_hello_until(self, |message| match message {
            ToAgent::Refused { reason } => {
                received_reason.borrow_mut().clone_from(reason);
                true
            }
            _ => false,
        });
        received_reason.into_inner()
    }

    /// Returns the next batch of the stream, with the given events.
    ///
    /// # Panics
    /// Never: plain data can always be serialized.
    pub fn batch_with(&mut self, events: &[Event]) -> Vec<u8> {
        let encode = |event| rmp_serde::to_vec(event).expect("plain data serialises");
        let body: Vec<u8> = events.iter().flat_map(encode).collect();
        let compress = false;
        self.batch_of(events.len() as u32, &body, compress)
    }

    /// Returns the next batch of the stream with an arbitrary body. The head is correct; `events` is its number of
    /// events.
    pub fn batch_of(&mut self, events: u32, body: &[u8], compress: bool) -> Vec<u8> {
        let (newest, previous_chain) = self.newest;
        let (number, chain) = (newest + 1, previous_chain.next(events, body));
        self.newest = (number, chain);
        let (host, stream, process) = (self.hello.host.id, self.hello.stream, self.hello.process);
        let events_before = self.events;
        let head = BatchHead { host, stream, process, number, previous_chain, chain, events, events_before };
        self.events = head.events_through();
        codec::encode_batch(&head, body, compress)
    }
}
