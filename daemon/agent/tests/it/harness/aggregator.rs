//! A minimal aggregator: it accepts, stores and acknowledges.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock};
use peernet_logger::HostId;
use peernet_stream::{
    Arrival, BatchHead, ClockSample, Event, Gap, Hello, HelloResult, HighWaterMark, Incident, IncidentKind,
    Iteration, LiveUpdate, MissingBatches, Receiving, ReceivingConfig, RunDescription, RunEnded, StreamId,
    StreamRecord, ToAgent, ToAggregator, codec,
};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use zeromq::{IdentitySocket, Message, Options, Socket, SocketType};

use super::{WAIT_TIMEOUT, clock};

/// Everything that an aggregator has received, also before its restarts.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReceivedEvents {
    pub(crate) hellos: usize,
    pub(crate) goodbyes: Vec<HostId>,
    /// All events, each once, in order.
    pub(crate) events: Vec<Event>,
    pub(crate) live_updates: Vec<LiveUpdate>,
    /// Mark of each stream.
    marks: HashMap<StreamId, HighWaterMark>,
    /// Stream of each accepted hello, in the order of arrival.
    pub(crate) streams: Vec<StreamId>,
    /// Batches that were reported as missing.
    pub(crate) missing_batches: Vec<MissingBatches>,
    /// Streams that ended because the next hello of the host named the stream of another spool.
    pub(crate) replaced_streams: Vec<StreamId>,
    /// Number of batches that arrived although they were already stored.
    pub(crate) repeated_batches: usize,
}

/// A running aggregator, which listens until it is dropped.
pub(crate) struct Aggregator {
    pub(crate) address: String,
    received_events: Arc<watch::Sender<ReceivedEvents>>,
    stop: CancellationToken,
    task: JoinHandle<()>,
}

/// Behaviour of an aggregator.
#[derive(Clone, Debug, Default)]
pub(crate) struct AggregatorBehaviour {
    /// Reason with which hellos are refused.
    pub(crate) refusal: Option<String>,
    /// Number of a batch. The aggregator stores this batch, and ends before it acknowledges the batch.
    pub(crate) end_before_ack: Option<u64>,
    /// `true` if the aggregator answers no message.
    pub(crate) is_silent: bool,
    /// Time for which the aggregator waits before it handles a batch.
    pub(crate) batch_delay: Option<Duration>,
}

impl Aggregator {
    pub(crate) async fn start() -> Self {
        Self::start_at("tcp://127.0.0.1:0", Arc::default(), AggregatorBehaviour::default()).await
    }

    pub(crate) async fn start_at(
        address: &str,
        received_events: Arc<watch::Sender<ReceivedEvents>>,
        behaviour: AggregatorBehaviour,
    ) -> Self {
        let socket = Socket::new(SocketType::Router, Options::default());
        let address = bind(&socket, address).await;
        let socket = socket.identity_routing().expect("a router");
        let stop = CancellationToken::new();
        let (stopped, kept_events) = (stop.clone(), Arc::clone(&received_events));
        let task = tokio::spawn(async move {
            stopped.run_until_cancelled(serve(&socket, &kept_events, behaviour)).await;
            socket.into_inner().close().await.expect("closes");
        });
        Self { address, received_events, stop, task }
    }

    /// Waits until the aggregator has ended by itself. Returns its address and the received events, for a restart.
    pub(crate) async fn wait_for_end(self) -> (String, Arc<watch::Sender<ReceivedEvents>>) {
        tokio::time::timeout(WAIT_TIMEOUT, self.task).await.expect("in time").expect("no panic");
        (self.address, self.received_events)
    }

    /// Ends without a message to the agents. Returns the address and the received events, for a restart.
    pub(crate) async fn stop(self) -> (String, Arc<watch::Sender<ReceivedEvents>>) {
        self.stop.cancel();
        self.wait_for_end().await
    }

    /// Starts an aggregator again at its address, with the events that it had received.
    pub(crate) async fn restart(
        (address, received_events): (String, Arc<watch::Sender<ReceivedEvents>>),
    ) -> Self {
        Self::start_at(&address, received_events, AggregatorBehaviour::default()).await
    }

    /// Waits until the received events satisfy a condition.
    pub(crate) async fn until(&self, condition: impl FnMut(&ReceivedEvents) -> bool) -> ReceivedEvents {
        let mut changes = self.received_events.subscribe();
        match tokio::time::timeout(WAIT_TIMEOUT, changes.wait_for(condition)).await {
            Ok(received_events) => received_events.expect("the sender is here").clone(),
            Err(_) => {
                panic!("the condition was not met in time: {:#?}", self.received_events.borrow().summary())
            }
        }
    }
}

impl ReceivedEvents {
    pub(crate) fn run_starts(&self) -> Vec<&RunDescription> {
        self.pick(|event| if let Event::RunStarted(run) = event { Some(run) } else { None })
    }

    pub(crate) fn run_ends(&self) -> Vec<&RunEnded> {
        self.pick(|event| if let Event::RunEnded(ended) = event { Some(ended) } else { None })
    }

    pub(crate) fn iterations(&self) -> Vec<&Iteration> {
        self.pick(|event| if let Event::Iteration(iteration) = event { Some(iteration) } else { None })
    }

    pub(crate) fn clock_samples(&self) -> Vec<&ClockSample> {
        self.pick(|event| if let Event::Clock(sample) = event { Some(sample.as_ref()) } else { None })
    }

    pub(crate) fn gaps(&self) -> Vec<&Gap> {
        self.pick(|event| if let Event::Gap(gap) = event { Some(gap) } else { None })
    }

    pub(crate) fn incidents(&self, kind: IncidentKind) -> Vec<&Incident> {
        self.pick(|event| match event {
            Event::Incident(incident) if incident.kind == kind => Some(incident),
            _ => None,
        })
    }

    fn pick<'a, T>(&'a self, choose: impl Fn(&'a Event) -> Option<&'a T>) -> Vec<&'a T> {
        self.events.iter().filter_map(choose).collect()
    }

    fn summary(&self) -> Vec<String> {
        let line = |event: &Event| match event {
            Event::Iteration(iteration) => format!("{} {:?}", iteration.number, iteration.outcome),
            Event::RunStarted(run) => format!("run {} started", run.run),
            other => format!("{other:?}"),
        };
        self.events.iter().rev().take(40).map(line).collect()
    }
}

/// Binds to an address. The library frees a port a moment after its socket was closed, so binding is repeated until the
/// port is free.
async fn bind(socket: &Socket, address: &str) -> String {
    let binding = async {
        loop {
            match socket.bind(address).await {
                Ok(endpoint) => return endpoint.to_string(),
                Err(zeromq::Error::Io(error)) if error.kind() == std::io::ErrorKind::AddrInUse => {
                    tokio::task::yield_now().await;
                }
                Err(error) => panic!("{error}"),
            }
        }
    };
    tokio::time::timeout(WAIT_TIMEOUT, binding).await.expect("the port becomes free")
}

async fn serve(
    socket: &IdentitySocket,
    received_events: &watch::Sender<ReceivedEvents>,
    behaviour: AggregatorBehaviour,
) {
    let clock = clock("system");
    let mut aggregator_state = AggregatorState { receiving: receiving(), clock, behaviour };
    loop {
        let Ok((peer, message)) = socket.recv_from().await else { return };
        let mut frame = message.part_bytes(0).expect("one frame");
        if let Some(part) = codec::decode_part(&frame) {
            let Some(message) = aggregator_state.receiving.handle_part(&part, aggregator_state.clock.mono())
            else {
                continue;
            };
            frame = message;
        }
        let head = codec::decode_batch_head(&frame);
        if let (Some(pause), Some(_)) = (aggregator_state.behaviour.batch_delay, head) {
            tokio::time::sleep(pause).await;
        }
        let mut replies = Vec::new();
        received_events
            .send_modify(|received_events| replies = aggregator_state.answer(received_events, head, &frame));
        if head.is_some() && head.map(|head| head.number) == aggregator_state.behaviour.end_before_ack {
            return;
        }
        for reply in replies {
            // An agent that disconnected in the meantime sends a hello after it has reconnected.
            let _ = socket.send_to(peer.to_bytes(), Message::single(codec::encode(&reply))).await;
        }
    }
}

fn receiving() -> Receiving {
    Receiving::new(ReceivingConfig::new("test".parse().expect("a name")))
}

struct AggregatorState {
    receiving: Receiving,
    clock: SharedClock,
    behaviour: AggregatorBehaviour,
}

impl AggregatorState {
    fn answer(
        &mut self,
        received_events: &mut ReceivedEvents,
        head: Option<BatchHead>,
        frame: &Bytes,
    ) -> Vec<ToAgent> {
        if self.behaviour.is_silent {
            return Vec::new();
        }
        let now = self.clock.mono();
        match head {
            Some(head) => self.answer_batch(received_events, head, frame, now),
            None => match codec::decode(frame).expect("the agent sends valid messages") {
                // This aggregator accepts every hello without a proof.
                ToAggregator::Hello(hello) => self.answer_hello(received_events, &hello, now),
                ToAggregator::Proof(proof) => {
                    panic!("the aggregator requested no proof, but received {proof:?}")
                }
                ToAggregator::Live(update) => {
                    let reply = self.receiving.handle_live(update.host, now);
                    received_events.live_updates.push(update);
                    reply.into_iter().collect()
                }
                ToAggregator::Echo { host, bytes } => vec![self.receiving.handle_echo(host, bytes, now)],
                ToAggregator::Goodbye(host) => {
                    self.receiving.handle_goodbye(host);
                    received_events.goodbyes.push(host);
                    Vec::new()
                }
            },
        }
    }

    fn answer_hello(
        &mut self,
        received_events: &mut ReceivedEvents,
        hello: &Hello,
        now: MonoTime,
    ) -> Vec<ToAgent> {
        received_events.hellos += 1;
        if let Some(reason) = &self.behaviour.refusal {
            return vec![ToAgent::Refused { reason: reason.clone() }];
        }
        let mark_of = |stream| received_events.marks.get(&stream).copied();
        let record = StreamRecord {
            mark: mark_of(hello.stream),
            was_used: received_events.streams.contains(&hello.stream),
            last_stream: received_events.streams.last().copied(),
            previous_mark: hello.previous_stream.and_then(mark_of),
            seniority: None,
        };
        match self.receiving.handle_hello(hello, record, now) {
            HelloResult::Welcome { reply, missing, replaced, .. } => {
                received_events.streams.push(hello.stream);
                received_events.replaced_streams.extend(replaced);
                let stored = missing.and_then(|missing| {
                    received_events.missing_batches.push(missing);
                    self.store(received_events, missing.stream, missing.into())
                });
                std::iter::once(reply).chain(stored).collect()
            }
            HelloResult::Refused { reply, .. } => vec![reply],
            HelloResult::Wait => Vec::new(),
        }
    }

    fn answer_batch(
        &mut self,
        received_events: &mut ReceivedEvents,
        head: BatchHead,
        frame: &Bytes,
        now: MonoTime,
    ) -> Vec<ToAgent> {
        let body = codec::decode_batch_body(Bytes::clone(frame)).expect("a whole batch");
        let is_intact = true;
        match self.receiving.handle_batch(&head, is_intact, now) {
            Arrival::Accept => {
                received_events.events.extend(codec::decode_events(&body, head.events).expect("events"));
                self.store(received_events, head.stream, head.into()).into_iter().collect()
            }
            Arrival::Duplicate(reply) => {
                received_events.repeated_batches += 1;
                vec![reply]
            }
            Arrival::Rejected(reply) => reply.into_iter().collect(),
            Arrival::Unknown(reply) => vec![reply],
            Arrival::Pending | Arrival::AcceptDamaged => panic!("every batch is intact and stored at once"),
        }
    }

    fn store(
        &mut self,
        received_events: &mut ReceivedEvents,
        stream: StreamId,
        mark: HighWaterMark,
    ) -> Option<ToAgent> {
        received_events.marks.insert(stream, mark);
        self.receiving.handle_stored(stream, mark).map(|(_, reply)| reply)
    }
}
