//! An agent, an aggregator and the link between them in simulated time.

use std::collections::VecDeque;

use super::super::super::{Arrival, HelloResult, HighWaterMark, Receiving, ReceivingConfig, StreamRecord};
use super::*;

/// Length of a live update of one pipeline without compression.
const LIVE_UPDATE_BYTES: usize = 1_500;
/// Length of every message of the aggregator.
const REPLY_BYTES: usize = 60;
/// Interval at which the agent sends live updates.
const LIVE_INTERVAL_MS: i64 = 250;

/// One direction of a link.
pub(super) struct OneWayPath<T> {
    pub(super) bytes_per_s: i64,
    delay_ms: i64,
    /// Time in microseconds at which the last of the bytes that were handed over leaves.
    pub(super) busy_until_us: i64,
    /// Sum of the times in microseconds in which the direction was busy.
    pub(super) used_us: i64,
    in_flight: VecDeque<(i64, T)>,
}

impl<T> OneWayPath<T> {
    const fn new(bytes_per_s: i64, delay_ms: i64) -> Self {
        Self { bytes_per_s, delay_ms, busy_until_us: 0, used_us: 0, in_flight: VecDeque::new() }
    }

    fn send(&mut self, bytes: usize, message: T, now_ms: i64) {
        let duration_us = bytes as i64 * 1_000_000 / self.bytes_per_s;
        self.busy_until_us = self.busy_until_us.max(now_ms * 1_000) + duration_us;
        self.used_us += duration_us;
        self.in_flight.push_back((self.busy_until_us / 1_000 + self.delay_ms, message));
    }

    fn pop_arrived(&mut self, now_ms: i64) -> Option<T> {
        let (_, message) = self.in_flight.pop_front_if(|(at, _)| *at <= now_ms)?;
        Some(message)
    }
}

/// A message from the agent to the aggregator.
pub(super) enum SentMessage {
    /// A frame of the durable lane.
    Frame(Bytes),
    /// A live update, with the time at which it was made.
    Live(i64),
}

/// Environment of the two state machines.
#[derive(Clone, Copy)]
pub(super) struct LinkSettings {
    pub(super) bytes_per_s: i64,
    /// One-way delay of each direction.
    pub(super) one_way_ms: i64,
    /// Step of the simulation, and the interval at which the agent sends.
    pub(super) step_ms: i64,
    /// Duration of a commit. Batches that arrive during a commit form the next commit.
    pub(super) commit_ms: i64,
    /// Time per second in which the aggregator processes nothing, because its host is busy.
    pub(super) busy_ms: i64,
    /// `true` if the agent controls the flow; otherwise all bytes that the agent sends count as arrived.
    pub(super) is_flow_controlled: bool,
    pub(super) events_per_s: i64,
    /// Returns the text of the event with a number.
    pub(super) text: fn(i64) -> String,
}

/// An agent, an aggregator, and a link of limited speed.
pub(super) struct Link {
    pub(super) agent: Agent,
    pub(super) settings: LinkSettings,
    pub(super) up: OneWayPath<SentMessage>,
    receiving: Receiving,
    down: OneWayPath<ToAgent>,
    /// Batches that wait for the next commit.
    waiting: Vec<BatchHead>,
    /// Batches of the current commit, and the time at which the commit ends, milliseconds.
    committing: (Vec<BatchHead>, i64),
    /// Number of stored events.
    pub(super) stored: u64,
    /// Time at which the newest received live update was made.
    newest_live_at: i64,
    is_live_due: bool,
    /// Largest age of the newest received live update, since a test last set this field to 0.
    pub(super) max_live_delay_ms: i64,
    /// Number of hellos that the aggregator received.
    pub(super) hellos: usize,
    /// Number of batches that the aggregator received and did not accept.
    pub(super) repeated: usize,
}

impl Link {
    pub(super) fn new(config: SendingConfig, settings: LinkSettings) -> Self {
        Self {
            agent: Agent::new(config),
            settings,
            up: OneWayPath::new(settings.bytes_per_s, settings.one_way_ms),
            receiving: Receiving::new(ReceivingConfig {
                max_window: config.window,
                ..ReceivingConfig::new("base".parse().expect("a name"))
            }),
            down: OneWayPath::new(10_000_000, settings.one_way_ms),
            waiting: Vec::new(),
            committing: (Vec::new(), 0),
            stored: 0,
            newest_live_at: 0,
            is_live_due: false,
            max_live_delay_ms: 0,
            hellos: 0,
            repeated: 0,
        }
    }

    fn offer(&mut self) {
        let LinkSettings { step_ms, events_per_s, text, .. } = self.settings;
        let now = self.agent.millis;
        let (first, end) = ((now - step_ms) * events_per_s / 1_000, now * events_per_s / 1_000);
        for n in first..end {
            self.agent.sending.offer(&incident(&text(n)), self.agent.now());
        }
        self.agent.sending.tick(self.agent.now());
    }

    pub(super) fn step(&mut self) {
        self.agent.millis += self.settings.step_ms;
        let now = self.agent.millis;
        self.offer();
        while let Some(message) = self.down.pop_arrived(now) {
            self.agent.sending.on_message(&message, self.agent.now());
        }
        self.is_live_due |= now % LIVE_INTERVAL_MS == 0;
        if self.is_live_due && self.agent.sending.may_send_live() {
            self.agent.sending.record_live_sent(LIVE_UPDATE_BYTES);
            self.up.send(LIVE_UPDATE_BYTES, SentMessage::Live(now), now);
            self.is_live_due = false;
        }
        self.perform_actions();
        let is_processing = now % 1_000 >= self.settings.busy_ms;
        while is_processing && let Some(sent) = self.up.pop_arrived(now) {
            match sent {
                SentMessage::Live(made_at) => self.newest_live_at = made_at,
                SentMessage::Frame(frame) => self.receive(frame),
            }
        }
        self.commit();
        self.max_live_delay_ms = self.max_live_delay_ms.max(now - self.newest_live_at);
    }

    /// Performs all actions of the agent.
    fn perform_actions(&mut self) {
        loop {
            let mut echo_position = None;
            while let Some(action) = self.agent.sending.next(self.agent.now().mono) {
                let Action::Send(frame) = action else {
                    self.agent.perform(action);
                    continue;
                };
                match codec::decode(&frame) {
                    Ok(ToAggregator::Echo { bytes, .. }) if !self.settings.is_flow_controlled => {
                        echo_position = Some(bytes);
                    }
                    _ => self.up.send(frame.len(), SentMessage::Frame(frame.into()), self.agent.millis),
                }
            }
            let Some(bytes) = echo_position else { return };
            self.agent.sending.on_message(&ToAgent::Echo { bytes }, self.agent.now());
        }
    }

    fn commit(&mut self) {
        let now = self.agent.millis;
        if self.committing.1 > now {
            return;
        }
        for head in std::mem::take(&mut self.committing.0) {
            self.stored += u64::from(head.events);
            let (_, reply) = self
                .receiving
                .handle_stored(head.stream, HighWaterMark::from(head))
                .expect("the agent is connected");
            self.reply(reply);
        }
        if !self.waiting.is_empty() {
            self.committing = (std::mem::take(&mut self.waiting), now + self.settings.commit_ms);
        }
    }

    fn receive(&mut self, frame: Bytes) {
        let now = self.agent.now().mono;
        let frame = match codec::decode_part(&frame) {
            Some(part) => match self.receiving.handle_part(&part, now) {
                Some(whole) => whole,
                None => return,
            },
            None => frame,
        };
        if let Some(head) = codec::decode_batch_head(&frame) {
            codec::decode_batch_body(frame).expect("the sent batch is intact");
            let is_intact = true;
            match self.receiving.handle_batch(&head, is_intact, now) {
                Arrival::Accept => self.waiting.push(head),
                _ => self.repeated += 1,
            }
            return;
        }
        match codec::decode(&frame).expect("any other frame is a message") {
            ToAggregator::Hello(hello) => {
                self.hellos += 1;
                self.agent.hellos.push(hello.clone());
                let result = self.receiving.handle_hello(&hello, StreamRecord::default(), now);
                let HelloResult::Welcome { reply, .. } = result else { panic!("{result:?}") };
                self.reply(reply);
            }
            ToAggregator::Echo { host, bytes } => {
                let echo = self.receiving.handle_echo(host, bytes, now);
                self.reply(echo);
            }
            other => panic!("{other:?} was sent"),
        }
    }

    fn reply(&mut self, message: ToAgent) {
        self.down.send(REPLY_BYTES, message, self.agent.millis);
    }

    pub(super) fn run(&mut self, seconds: i64) {
        (0..seconds * 1_000 / self.settings.step_ms).for_each(|_| self.step());
    }

    pub(super) fn connect(&mut self) {
        self.agent.sending.on_connected(self.agent.now().mono);
    }
}
