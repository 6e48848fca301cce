//! Durable stream of one agent: a backlog of iterations is sent to an aggregator as fast as it is accepted, with or
//! without the control of bytes in flight.
//!
//! State machine, socket and aggregator are those of PEERNet. The spool is in memory. This program delays each message
//! that it sends or receives by half a round trip. Without control, it answers requests for echoes itself as soon as
//! the state machine has nothing more to send, so the state machine always believes that everything has arrived.
//!
//! `event-stream ADDRESS ITERATIONS ROUND-TRIP-MS on|off`, which prints one JSON object.

#[path = "../../../daemon/aggregator/tests/it/generate.rs"]
#[expect(unreachable_pub, dead_code, reason = "shared with the aggregator's tests")]
mod generate;

use std::collections::VecDeque;
use std::time::Duration;

use anyhow::{Context, bail};
use bytes::Bytes;
use peernet_clock::{Clock, ClockIdentity, Span, SystemClock};
use peernet_logger::{HostId, RunId};
use peernet_stream::{
    Action, Compression, Event, HostSecret, Sending, SendingConfig, SpoolState, SpooledBatch, StreamId,
    ToAgent, ToAggregator, Usage, codec,
};
use serde_json::json;
use tokio::time::{Instant, sleep_until};
use zeromq::options::WorkloadProfile;
use zeromq::{Message, Options, Socket, SocketType, TrySendError};

/// Number of batches in flight, as in agents.
const WINDOW: u32 = 32;

/// Capacity of the socket's queue, messages.
const QUEUE_MESSAGES: u32 = 8;

/// Longest time until the next tick of the state machine if no delayed message is due.
const MAX_WAIT: Duration = Duration::from_millis(20);

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [address, iterations, round_trip, control] = &arguments[..] else {
        bail!("usage: event-stream ADDRESS ITERATIONS ROUND-TRIP-MS on|off");
    };
    let is_controlled = match control.as_str() {
        "on" => true,
        "off" => false,
        text => bail!("{text:?} is neither on nor off"),
    };
    let one_way = Duration::from_secs_f64(round_trip.parse::<f64>()? / 2e3);
    let mut agent = Agent::new(one_way, is_controlled)?;
    agent.fill(iterations.parse()?);
    let figures = agent.deliver(address).await?;
    #[expect(clippy::print_stdout, reason = "the result that was asked for")]
    {
        println!("{figures}");
    }
    Ok(())
}

/// The sending end, its spool, and the messages that are delayed.
struct Agent {
    clock: SystemClock,
    state_machine: Sending,
    spool: VecDeque<SpooledBatch>,
    one_way: Duration,
    is_controlled: bool,
    /// Delayed messages to the aggregator, with the time at which each is sent.
    up: VecDeque<(Instant, Vec<u8>)>,
    /// Delayed messages from the aggregator, with the time at which each is handled.
    down: VecDeque<(Instant, Bytes)>,
    /// Number of bytes in the request for an echo that is to be answered here.
    requested_echo: Option<u64>,
    frames: u64,
    bytes: u64,
}

impl Agent {
    fn new(one_way: Duration, is_controlled: bool) -> anyhow::Result<Self> {
        let clock = SystemClock::new(ClockIdentity::from_system(ClockIdentity::SYSTEM)?);
        let config = SendingConfig {
            window: WINDOW,
            first_pause: Span::from_seconds(1),
            memory: Usage { events: u64::MAX / 2, bytes: u64::MAX / 2 },
            compression: Compression::Never,
            ..SendingConfig::default()
        };
        let spool_state = SpoolState::new(StreamId::random());
        let host = generate::host(HostId::random(), "edge");
        let process = 1;
        let state_machine = Sending::new(config, host, HostSecret::random(), process, spool_state);
        let (spool, up, down) = Default::default();
        Ok(Self {
            clock,
            state_machine,
            spool,
            one_way,
            is_controlled,
            up,
            down,
            requested_echo: None,
            frames: 0,
            bytes: 0,
        })
    }

    /// Generates this number of iterations and spools them.
    fn fill(&mut self, iterations: u64) {
        let (run, edge, cloud) = (RunId::random(), self.state_machine.host(), HostId::random());
        let mut numbers = generate::Numbers::new(1);
        self.state_machine.offer(&generate::run_started(run, "line", generate::at(0.0)), self.clock.stamp());
        for number in 1..=iterations {
            let time = generate::at(number as f64 * 1e-4);
            let iteration = generate::iteration_at(run, number, (edge, cloud), time, &mut numbers);
            self.state_machine.offer(&Event::Iteration(iteration), self.clock.stamp());
            self.execute_actions();
        }
        self.state_machine.flush(self.clock.wall());
        self.execute_actions();
    }

    /// Returns the next action of the state machine. If it has none, answers the requested echo and asks once more.
    fn next_action(&mut self) -> Option<Action> {
        loop {
            let action = self.state_machine.next(self.clock.mono());
            if action.is_some() {
                return action;
            }
            let bytes = self.requested_echo.take()?;
            self.state_machine.on_message(&ToAgent::Echo { bytes }, self.clock.stamp());
        }
    }

    /// Executes the actions of the state machine.
    fn execute_actions(&mut self) {
        while let Some(action) = self.next_action() {
            let now = self.clock.stamp();
            match action {
                Action::Send(frame) => self.send(frame),
                Action::Append { batches, .. } => {
                    self.spool.extend(batches);
                    self.state_machine.on_appended(now);
                }
                Action::Load { from, bytes } => {
                    let batches = self.load(from, bytes);
                    self.state_machine.on_loaded(batches, now);
                }
                Action::Delete { through, .. } => {
                    while self.spool.pop_front_if(|batch| batch.number <= through).is_some() {}
                    self.state_machine.on_deleted();
                }
                // Happens only if an aggregator has other batches of this stream.
                Action::Renew { .. } => self.state_machine.on_renewed(now),
            }
        }
    }

    fn send(&mut self, frame: Vec<u8>) {
        if !self.is_controlled
            && let Ok(ToAggregator::Echo { bytes, .. }) = codec::decode(&frame)
        {
            self.requested_echo = Some(bytes);
            return;
        }
        self.frames += 1;
        self.bytes += frame.len() as u64;
        self.up.push_back((Instant::now() + self.one_way, frame));
    }

    fn load(&self, from: u64, max_bytes: usize) -> Vec<SpooledBatch> {
        let mut bytes = 0;
        let batches = self.spool.iter().skip_while(|batch| batch.number < from).take_while(|batch| {
            let is_first = bytes == 0;
            bytes += batch.body.len();
            is_first || bytes <= max_bytes
        });
        batches.cloned().collect()
    }

    /// Sends all batches; measures the time from the connection to the last acknowledgement.
    async fn deliver(&mut self, address: &str) -> anyhow::Result<serde_json::Value> {
        let options = Options::default().workload_profile(WorkloadProfile::Latency).send_hwm(QUEUE_MESSAGES);
        let socket = Socket::new(SocketType::Dealer, options);
        socket.connect(address).await.with_context(|| format!("cannot connect to {address}"))?;
        let begin = self.clock.mono();
        self.state_machine.on_connected(begin);
        loop {
            self.execute_actions();
            if self.state_machine.is_idle() {
                break;
            }
            let is_blocked = self.send_due(&socket)?;
            let departure = self.up.front().filter(|_| !is_blocked).map(|(time, _)| *time);
            let arrival = self.down.front().map(|(time, _)| *time);
            let due = departure.into_iter().chain(arrival).min().unwrap_or_else(|| Instant::now() + MAX_WAIT);
            tokio::select! {
                message = socket.recv() => {
                    let frame = message.context("the connection failed")?.part_bytes(0).unwrap_or_default();
                    self.down.push_back((Instant::now() + self.one_way, frame));
                }
                () = socket.wait_send_ready(), if is_blocked => {}
                () = sleep_until(due) => self.state_machine.tick(self.clock.stamp()),
            }
            while let Some((_, frame)) = self.down.pop_front_if(|(time, _)| *time <= Instant::now()) {
                let message: ToAgent =
                    codec::decode(&frame).context("cannot decode the aggregator's message")?;
                self.state_machine.on_message(&message, self.clock.stamp());
            }
        }
        let seconds = (self.clock.mono() - begin).seconds();
        Ok(json!({ "seconds": seconds, "frames": self.frames, "bytes": self.bytes }))
    }

    /// Sends the messages that are due. Returns whether the socket could not take all messages.
    fn send_due(&mut self, socket: &Socket) -> anyhow::Result<bool> {
        while let Some((time, frame)) = self.up.pop_front_if(|(time, _)| *time <= Instant::now()) {
            match socket.try_send(Message::single(frame)) {
                Ok(()) => {}
                Err(TrySendError::Full(message)) => {
                    let frame = message.into_bytes().map(Into::into).unwrap_or_default();
                    self.up.push_front((time, frame));
                    return Ok(true);
                }
                Err(error) => bail!("the connection failed: {error:?}"),
            }
        }
        Ok(false)
    }
}
