//! An agent's end of the event stream, over a real socket.

use std::collections::BTreeMap;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{SharedClock, Span};
use peernet_logger::HostId;
use peernet_stream::codec::{decode, encode};
use peernet_stream::{
    Accounting, Action, Event, HostDescription, HostSecret, Sending, SendingConfig, SpoolState, SpooledBatch,
    StreamId, ToAgent, ToAggregator, Usage,
};
use zeromq::{Message, Options, Socket, SocketType};

/// Timeout of an operation that usually finishes at once.
const TEST_TIMEOUT: Duration = Duration::from_secs(60);
/// Limits of the queue in memory, large enough that no event is dropped.
const MEMORY: Usage = Usage { events: 1_000_000, bytes: 1 << 30 };

/// An agent: the real state machine with a spool in memory and a socket.
pub(crate) struct Agent {
    id: HostId,
    sending: Sending,
    spool: BTreeMap<u64, SpooledBatch>,
    socket: Socket,
    clock: SharedClock,
}

impl Agent {
    /// Connects to an aggregator.
    pub(crate) async fn new(host: HostDescription, address: &str, clock: &SharedClock) -> Self {
        let id = host.id;
        let config =
            SendingConfig { batch_age: Span::from_millis(10), memory: MEMORY, ..SendingConfig::default() };
        let spool = SpoolState::new(StreamId::random());
        let mut sending =
            Sending::new(config, host, HostSecret::random(), clock.mono().nanos() as u64, spool);
        sending.on_connected(clock.mono());
        let socket = Socket::new(SocketType::Dealer, Options::default());
        socket.connect(address).await.expect("connects");
        Self { id, sending, spool: BTreeMap::new(), socket, clock: SharedClock::clone(clock) }
    }

    /// Returns the host's id.
    pub(crate) fn id(&self) -> HostId {
        self.id
    }

    /// Returns the event counts.
    pub(crate) fn accounting(&self) -> Accounting {
        self.sending.accounting()
    }

    /// Queues events, to be sent by the next `wait_until_stored`.
    pub(crate) fn offer(&mut self, events: impl IntoIterator<Item = Event>) {
        events.into_iter().for_each(|event| self.sending.offer(&event, self.clock.stamp()));
    }

    async fn send(&self, frame: Vec<u8>) {
        self.socket.send(Message::single(Bytes::from(frame))).await.expect("sends");
    }

    async fn act(&mut self, action: Action) {
        let now = self.clock.stamp();
        match action {
            Action::Append { batches, .. } => {
                self.spool.extend(batches.into_iter().map(|batch| (batch.number, batch)));
                self.sending.on_appended(now);
            }
            Action::Load { from, bytes } => {
                let mut taken = 0;
                let requested = self.spool.range(from..).map(|(_, batch)| batch).take_while(|batch| {
                    let fits = taken <= bytes;
                    taken += batch.body.len();
                    fits
                });
                let batches = requested.cloned().collect();
                self.sending.on_loaded(batches, now);
            }
            Action::Delete { through, .. } => {
                self.spool = self.spool.split_off(&(through + 1));
                self.sending.on_deleted();
            }
            Action::Renew { .. } => self.sending.on_renewed(now),
            Action::Send(frame) => self.send(frame).await,
        }
    }

    /// Exchanges messages until `done` returns true. `condition` describes that in words.
    async fn wait_until(&mut self, condition: &str, done: impl Fn(&Sending) -> bool) {
        let exchange = async {
            loop {
                self.sending.tick(self.clock.stamp());
                while let Some(action) = self.sending.next(self.clock.mono()) {
                    self.act(action).await;
                }
                if done(&self.sending) {
                    return;
                }
                let due =
                    self.sending.deadline().map(|deadline| (deadline - self.clock.mono()).to_duration());
                tokio::select! {
                    message = self.socket.recv() => {
                        let message = message.expect("receives");
                        let message: ToAgent = decode(message.part_slice(0).expect("a frame")).expect("a message");
                        self.sending.on_message(&message, self.clock.stamp());
                    }
                    () = tokio::time::sleep(due.unwrap_or(TEST_TIMEOUT).min(Duration::from_millis(50))) => {}
                }
            }
        };
        assert!(
            tokio::time::timeout(TEST_TIMEOUT, exchange).await.is_ok(),
            "timeout while waiting until {condition}"
        );
    }

    /// Exchanges messages until the aggregator has accepted the connection.
    pub(crate) async fn wait_until_connected(&mut self) {
        self.wait_until("the aggregator has accepted the agent", Sending::is_up).await;
    }

    /// Sends all events and waits until they are acknowledged.
    pub(crate) async fn wait_until_stored(&mut self) {
        self.wait_until("everything is stored", Sending::is_idle).await;
    }

    /// Sends a message outside the queue of events: a live update or a goodbye.
    pub(crate) async fn send_message(&self, message: &ToAggregator) {
        self.send(encode(message)).await;
    }
}
