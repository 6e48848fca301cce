//! The other end of the event stream, as simple as it can be: it accepts, remembers and acknowledges.

use std::sync::Arc;
use std::time::Duration;

use peernet_logger::HostId;
use peernet_logger::stream::{
    ClockSample, Event, Gap, Incident, IncidentKind, Iteration, LiveUpdate, RunDescription, RunEnded,
    ToAgent, ToAggregator, codec,
};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use zeromq::{IdentitySocket, Message, Options, Socket, SocketType};

use super::PATIENCE;

/// What it has seen, over all its lives.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    pub(crate) hellos: usize,
    pub(crate) goodbyes: Vec<HostId>,
    /// Each once, in order.
    pub(crate) events: Vec<Event>,
    pub(crate) lives: Vec<LiveUpdate>,
    /// Number of the last batch stored.
    stored: u64,
    /// Batches that came although they were stored.
    pub(crate) repeated: usize,
}

/// Listens until it is dropped.
pub(crate) struct Aggregator {
    pub(crate) address: String,
    seen: Arc<watch::Sender<Seen>>,
    stop: CancellationToken,
    task: JoinHandle<()>,
}

/// How it behaves.
#[derive(Clone, Debug, Default)]
pub(crate) struct Manners {
    /// Refuse hellos with this reason.
    pub(crate) refuse: Option<String>,
    /// Store batches, but go down before acknowledging this one.
    pub(crate) die_before_ack: Option<u64>,
    /// Take everything and answer nothing.
    pub(crate) mute: bool,
    /// Take so long for each batch.
    pub(crate) slow: Option<Duration>,
}

impl Aggregator {
    pub(crate) async fn start() -> Self {
        Self::start_at("tcp://127.0.0.1:0", Arc::default(), Manners::default()).await
    }

    pub(crate) async fn start_at(address: &str, seen: Arc<watch::Sender<Seen>>, manners: Manners) -> Self {
        let socket = Socket::new(SocketType::Router, Options::default());
        let address = bind(&socket, address).await;
        let socket = socket.identity_routing().expect("a router");
        let stop = CancellationToken::new();
        let (told, memory) = (stop.clone(), Arc::clone(&seen));
        let task = tokio::spawn(async move {
            told.run_until_cancelled(serve(&socket, &memory, manners)).await;
            socket.into_inner().close().await.expect("closes");
        });
        Self { address, seen, stop, task }
    }

    /// Waits until it has gone down by itself; the memory survives.
    pub(crate) async fn fell(self) -> (String, Arc<watch::Sender<Seen>>) {
        tokio::time::timeout(PATIENCE, self.task).await.expect("in time").expect("no panic");
        (self.address, self.seen)
    }

    /// Goes down without a word; the memory survives.
    pub(crate) async fn down(self) -> (String, Arc<watch::Sender<Seen>>) {
        self.stop.cancel();
        self.fell().await
    }

    /// Comes back at the same address with what it remembers.
    pub(crate) async fn up((address, seen): (String, Arc<watch::Sender<Seen>>)) -> Self {
        Self::start_at(&address, seen, Manners::default()).await
    }

    /// Waits until it has seen enough.
    pub(crate) async fn until(&self, enough: impl FnMut(&Seen) -> bool) -> Seen {
        let mut changes = self.seen.subscribe();
        match tokio::time::timeout(PATIENCE, changes.wait_for(enough)).await {
            Ok(seen) => seen.expect("the sender is here").clone(),
            Err(_) => panic!("never came: {:#?}", self.seen.borrow().summary()),
        }
    }
}

impl Seen {
    pub(crate) fn runs(&self) -> Vec<&RunDescription> {
        self.pick(|event| if let Event::RunStarted(run) = event { Some(run) } else { None })
    }

    pub(crate) fn ended(&self) -> Vec<&RunEnded> {
        self.pick(|event| if let Event::RunEnded(ended) = event { Some(ended) } else { None })
    }

    pub(crate) fn iterations(&self) -> Vec<&Iteration> {
        self.pick(|event| if let Event::Iteration(iteration) = event { Some(iteration) } else { None })
    }

    pub(crate) fn clocks(&self) -> Vec<&ClockSample> {
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

/// The library gives a port back a moment after the socket on it was closed: a successor may have to wait.
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
    tokio::time::timeout(PATIENCE, binding).await.expect("the port becomes free")
}

async fn serve(socket: &IdentitySocket, seen: &watch::Sender<Seen>, manners: Manners) {
    loop {
        let Ok((peer, message)) = socket.recv_from().await else { return };
        let frame = message.part_bytes(0).expect("one frame");
        let message: ToAggregator = codec::decode(&frame).expect("the agent sends sense");
        if let (Some(last), ToAggregator::Batch(batch)) = (manners.die_before_ack, &message)
            && batch.number == last
        {
            seen.send_modify(|seen| drop(answer(seen, message, &manners)));
            return;
        }
        if let (Some(pause), ToAggregator::Batch(_)) = (manners.slow, &message) {
            tokio::time::sleep(pause).await;
        }
        let mut reply = None;
        seen.send_modify(|seen| reply = answer(seen, message, &manners));
        if let Some(reply) = reply {
            // An agent that has gone meanwhile says hello when it is back.
            let _ = socket.send_to(peer.to_bytes(), Message::single(codec::encode(&reply))).await;
        }
    }
}

fn answer(seen: &mut Seen, message: ToAggregator, manners: &Manners) -> Option<ToAgent> {
    if manners.mute {
        return None;
    }
    match message {
        ToAggregator::Hello(hello) => {
            seen.hellos += 1;
            let stored = seen.stored;
            // What is before its oldest it cannot send any more.
            seen.stored = stored.max(hello.oldest - 1);
            Some(match &manners.refuse {
                Some(reason) => ToAgent::Refused { reason: reason.clone() },
                None => ToAgent::Welcome {
                    aggregator: "test".parse().expect("a name"),
                    stream: hello.stream,
                    stored,
                },
            })
        }
        ToAggregator::Live(update) => {
            seen.lives.push(update);
            None
        }
        ToAggregator::Batch(batch) => {
            if batch.number == seen.stored + 1 {
                seen.stored = batch.number;
                seen.events.extend(batch.events);
            } else if batch.number <= seen.stored {
                seen.repeated += 1;
            } else {
                return Some(ToAgent::Resend { stream: batch.stream, from: seen.stored + 1 });
            }
            Some(ToAgent::Ack { stream: batch.stream, through: seen.stored })
        }
        ToAggregator::Goodbye(host) => {
            seen.goodbyes.push(host);
            None
        }
    }
}
