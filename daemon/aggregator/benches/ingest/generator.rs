//! The agents: one process with one connection per agent.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_stream::codec::{decode, encode};
use peernet_stream::{HostSecret, Proof, ToAgent, ToAggregator};
use tokio::time::{Instant, sleep_until};
use zeromq::{Message, Options, Socket, SocketType};

use crate::load::{BATCH_BYTES, Load, LoadPlan};
use crate::{generate, report, server};

/// Longest window that an agent uses, in units of `BATCH_BYTES`, even if the aggregator allows more.
const WINDOW: u32 = 32;

/// Prepares and connects all agents, sends all batches, and prints how many seconds the sending took. With a `speed`,
/// batches are sent at that multiple of the rate at which the plan's iterations are produced; without, as fast as the
/// window allows.
pub(crate) async fn run(address: &str, plan: &LoadPlan, speed: Option<f64>) {
    server::raise_file_limit();
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("bench", "agents")));
    let start = generate::at(0.0);
    let mut agents = Vec::new();
    for agent in 0..plan.agents {
        let load = plan.load(agent, start);
        let socket = Socket::new(SocketType::Dealer, Options::default());
        socket.connect(address).await.expect("connects");
        send_message(&socket, &ToAggregator::Hello(load.hello.clone())).await;
        let ToAgent::Challenge { aggregator, nonce, .. } = receive(&socket).await else {
            panic!("no challenge")
        };
        let secret = HostSecret::random();
        let code = secret.prove(&nonce, &load.hello, &aggregator);
        let proof = Proof { host: load.hello.host.id, nonce, code, secret: Some(secret) };
        send_message(&socket, &ToAggregator::Proof(proof)).await;
        let ToAgent::Welcome { window, .. } = receive(&socket).await else { panic!("not welcome") };
        agents.push((socket, load, window));
    }
    let batch_interval =
        speed.map_or(Duration::ZERO, |speed| Duration::from_secs_f64(plan.batch_s() / speed));
    let started_at = clock.mono();
    let tasks: Vec<_> = agents
        .into_iter()
        .map(|(socket, load, window)| tokio::spawn(send(socket, load, window, batch_interval)))
        .collect();
    for task in tasks {
        task.await.expect("sends everything");
    }
    report((clock.mono() - started_at).seconds());
}

/// Keeps as many batches in flight as the window allows, until all are acknowledged. If the aggregator requests an
/// earlier batch, continues from that batch.
async fn send(socket: Socket, load: Load, mut window: u32, batch_interval: Duration) {
    let started_at = Instant::now();
    let (mut next, mut stored) = (0, 0);
    while stored < load.frames.len() {
        let window_bytes = u64::from(window.min(WINDOW)) * BATCH_BYTES;
        let send_end = stored + load.max_in_flight(stored, window_bytes);
        while next < send_end && started_at + batch_interval * next as u32 <= Instant::now() {
            socket.send(Message::single(load.frames[next].clone())).await.expect("sends");
            next += 1;
        }
        let due_at = started_at + batch_interval * next as u32;
        let received = tokio::select! {
            received = receive(&socket) => received,
            () = sleep_until(due_at), if next < send_end => continue,
        };
        match received {
            ToAgent::Ack { stream, through, window: new_window } if stream == load.stream => {
                (stored, window) = (through as usize, new_window);
            }
            // The first batch has the number 1 and the index 0.
            ToAgent::Resend { from, .. } => next = from as usize - 1,
            other => panic!("unexpected {other:?}"),
        }
    }
}

async fn send_message(socket: &Socket, message: &ToAggregator) {
    socket.send(Message::single(Bytes::from(encode(message)))).await.expect("sends");
}

async fn receive(socket: &Socket) -> ToAgent {
    let message = socket.recv().await.expect("receives");
    decode(message.part_slice(0).expect("a frame")).expect("a message")
}
