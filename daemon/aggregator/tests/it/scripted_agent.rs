//! A test agent whose frames are built one by one by the test.

use std::time::Duration;

use peernet_logger::{HostId, RunId};
use peernet_stream::{BatchHead, ChainHash, Event, Hello, STREAM_VERSIONS, StreamId, ToAgent, codec};

use crate::agent::AgentSocket;
use crate::generate;
use crate::testbed::Testbed;

/// A host with a stream, and the state of that stream.
pub(crate) struct ScriptedAgent {
    pub(crate) socket: AgentSocket,
    pub(crate) host: HostId,
    pub(crate) stream: StreamId,
    pub(crate) run: RunId,
    /// Number of the agent's process.
    pub(crate) process: u64,
    /// Number of the newest batch.
    pub(crate) number: u64,
    /// Chain hash of the newest batch.
    pub(crate) previous_chain: ChainHash,
    /// Number of events in all batches so far.
    pub(crate) events: u64,
}

impl ScriptedAgent {
    /// Connects without sending a hello.
    pub(crate) async fn new(testbed: &Testbed) -> Self {
        Self {
            socket: AgentSocket::connect(&testbed.address).await,
            host: HostId::random(),
            stream: StreamId::random(),
            run: RunId::random(),
            process: 1,
            number: 0,
            previous_chain: ChainHash::START,
            events: 0,
        }
    }

    /// Connects and completes the greeting.
    pub(crate) async fn welcome(testbed: &Testbed, name: &str) -> Self {
        let scripted_agent = Self::new(testbed).await;
        let answer = scripted_agent.socket.greet(&scripted_agent.hello(name)).await;
        assert!(matches!(answer, ToAgent::Welcome { stored: 0, chain: None, .. }));
        scripted_agent
    }

    pub(crate) fn hello(&self, name: &str) -> Hello {
        Hello {
            protocol: STREAM_VERSIONS.oldest(),
            host: generate::host(self.host, name),
            stream: self.stream,
            previous_stream: None,
            first: 1,
            oldest: self.number + 1,
            chain_before_oldest: self.previous_chain,
            events_before_oldest: self.events,
            events_before_first: Some(0),
            batch_bytes: 128 * 1024,
            process: self.process,
            extension: None,
        }
    }

    /// Returns the frame of the next batch, with one iteration.
    pub(crate) fn next(&mut self) -> Vec<u8> {
        let mut random = generate::Numbers::new(self.number);
        let hosts = (self.host, HostId::from_bytes([7; 16]));
        let iteration = generate::iteration(self.run, self.number + 1, hosts, &mut random);
        self.next_with_events(&[Event::Iteration(iteration)])
    }

    /// Returns the frame of the next batch, with these events.
    pub(crate) fn next_with_events(&mut self, events: &[Event]) -> Vec<u8> {
        self.next_with_body(events.len() as u32, &generate::body(events))
    }

    /// Returns the frame of the next batch, with any body. The hash in the frame matches the body.
    pub(crate) fn next_with_body(&mut self, events: u32, body: &[u8]) -> Vec<u8> {
        self.number += 1;
        let (host, stream, number, previous_chain) =
            (self.host, self.stream, self.number, self.previous_chain);
        self.previous_chain = previous_chain.next(events, body);
        let (process, chain) = (self.process, self.previous_chain);
        let events_before = self.events;
        let head = BatchHead { host, stream, process, number, previous_chain, chain, events, events_before };
        self.events = head.events_through();
        // Compressed and other batches alternate.
        let compress = number.is_multiple_of(2);
        codec::encode_batch(&head, body, compress)
    }

    /// Sends the next batch.
    pub(crate) async fn send_next(&mut self) {
        let frame = self.next();
        self.socket.send_frame(frame).await;
    }

    /// Receives a message and asserts that the message is as expected.
    pub(crate) async fn expect(&self, expected: Reply) {
        let stream = self.stream;
        match (expected, self.socket.receive().await) {
            (Reply::Ack(number), ToAgent::Ack { stream: reply_stream, through, window }) => {
                assert_eq!((reply_stream, through, window > 0), (stream, number, true));
            }
            (Reply::Resend(number), ToAgent::Resend { stream: reply_stream, from }) => {
                assert_eq!((reply_stream, from), (stream, number));
            }
            (Reply::Unknown, ToAgent::Unknown) => {}
            (expected, received) => panic!("expected {expected:?}, got {received:?}"),
        }
    }

    /// Waits until batch `number` is acknowledged, and ignores other messages.
    pub(crate) async fn wait_for_acknowledgement(&self, number: u64) {
        while !matches!(self.socket.receive().await, ToAgent::Ack { through, .. } if through == number) {}
    }

    /// Returns whether no message arrives for 50 ms. On a slow machine the result may be `true` although a message
    /// would have arrived later.
    pub(crate) async fn is_silent(&self) -> bool {
        tokio::time::timeout(Duration::from_millis(50), self.socket.receive()).await.is_err()
    }
}

/// An expected message of the aggregator.
#[derive(Debug)]
pub(crate) enum Reply {
    Ack(u64),
    Resend(u64),
    Unknown,
}
