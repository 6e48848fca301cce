//! The agent's end of the event stream over a real socket.

use std::time::Duration;

use bytes::Bytes;
use peernet_clock::SharedClock;
use peernet_logger::HostId;
use peernet_logger::stream::codec::{decode, encode};
use peernet_logger::stream::{
    Accounting, Event, HostDescription, LiveUpdate, MemorySpool, Sending, SendingConfig, ToAgent,
    ToAggregator, Usage,
};
use zeromq::{Message, Options, Socket, SocketType};

/// Longest time that anything may take before it counts as hung.
const PATIENCE: Duration = Duration::from_secs(60);

/// An agent: the real state machine, a spool in memory, a socket.
pub(crate) struct Agent {
    id: HostId,
    sending: Sending<MemorySpool>,
    socket: Socket,
    clock: SharedClock,
}

impl Agent {
    /// Connects.
    pub(crate) async fn new(host: HostDescription, address: &str, clock: &SharedClock) -> Self {
        let id = host.id;
        let spool = MemorySpool::new(Usage { events: 1_000_000, bytes: 1 << 30 });
        let mut sending = Sending::new(SendingConfig::default(), host, clock.mono().nanos() as u64, spool);
        sending.connected(clock.mono());
        let socket = Socket::new(SocketType::Dealer, Options::default());
        socket.connect(address).await.expect("connects");
        Self { id, sending, socket, clock: SharedClock::clone(clock) }
    }

    /// Whose.
    pub(crate) fn id(&self) -> HostId {
        self.id
    }

    /// What became of the events.
    pub(crate) fn accounting(&self) -> Accounting {
        self.sending.accounting()
    }

    /// Hands events in.
    pub(crate) fn offer(&mut self, events: impl IntoIterator<Item = Event>) {
        events.into_iter().for_each(|event| self.sending.offer(&event, self.clock.stamp()));
    }

    async fn send(&self, frame: Vec<u8>) {
        self.socket.send(Message::single(Bytes::from(frame))).await.expect("sends");
    }

    async fn until(&mut self, what: &str, done: impl Fn(&Sending<MemorySpool>) -> bool) {
        let speak = async {
            loop {
                self.sending.tick(self.clock.stamp());
                while let Some(frame) =
                    self.sending.transmit(self.clock.mono()).expect("the spool is in memory")
                {
                    self.send(frame).await;
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
                        self.sending.received(&message, self.clock.stamp()).expect("the spool is in memory");
                    }
                    () = tokio::time::sleep(due.unwrap_or(PATIENCE).min(Duration::from_millis(50))) => {}
                }
            }
        };
        assert!(tokio::time::timeout(PATIENCE, speak).await.is_ok(), "waited in vain until {what}");
    }

    /// Speaks until the aggregator has taken it in.
    pub(crate) async fn until_up(&mut self) {
        self.until("the agent is welcome", Sending::is_up).await;
    }

    /// Sends everything and waits until it is acknowledged.
    pub(crate) async fn until_stored(&mut self) {
        self.sending.flush(self.clock.wall());
        self.until("everything is stored", Sending::is_idle).await;
    }

    /// Sends a live update.
    pub(crate) async fn live(&self, update: LiveUpdate) {
        self.send(encode(&ToAggregator::Live(update))).await;
    }
}
