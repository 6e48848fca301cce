//! Links of all speeds in simulated time: what is live stays so, the link is put to use, nothing is lost or repeated.

use std::collections::VecDeque;

use super::super::super::{Arrival, Greeting, Known, Mark, Receiving, ReceivingConfig};
use super::*;

/// A step of the simulation, and how often the agent looks after its lanes.
const STEP_MS: i64 = 5;
/// The length of a live update of one pipeline, compressed by nobody.
const LIVE_BYTES: usize = 1_500;
const LIVE_EVERY_MS: i64 = 250;
/// How long a commit takes.
const COMMIT_MS: i64 = 60;

/// One direction of a link.
struct Way<T> {
    bytes_per_s: i64,
    delay_ms: i64,
    /// When the last byte that was handed over will have left, microseconds.
    busy_us: i64,
    /// How long it was busy.
    used_us: i64,
    under_way: VecDeque<(i64, T)>,
}

impl<T> Way<T> {
    const fn new(bytes_per_s: i64, delay_ms: i64) -> Self {
        Self { bytes_per_s, delay_ms, busy_us: 0, used_us: 0, under_way: VecDeque::new() }
    }

    fn send(&mut self, bytes: usize, what: T, now_ms: i64) {
        let takes = bytes as i64 * 1_000_000 / self.bytes_per_s;
        self.busy_us = self.busy_us.max(now_ms * 1_000) + takes;
        self.used_us += takes;
        self.under_way.push_back((self.busy_us / 1_000 + self.delay_ms, what));
    }

    fn arrived(&mut self, now_ms: i64) -> Option<T> {
        let (_, what) = self.under_way.pop_front_if(|(at, _)| *at <= now_ms)?;
        Some(what)
    }
}

enum Sent {
    Frame(Bytes),
    /// A live update that was made then.
    Live(i64),
}

/// An agent, an aggregator, and a link with a speed.
struct Link {
    agent: Agent,
    receiving: Receiving,
    up: Way<Sent>,
    down: Way<ToAgent>,
    commits: VecDeque<(i64, BatchHead)>,
    events_per_s: i64,
    stored: u64,
    /// When the newest live update that came was made.
    shown: i64,
    due: bool,
    /// How far the live picture was behind, at most, since this was last cleared.
    behind: i64,
    hellos: usize,
    repeated: usize,
}

impl Link {
    fn new(config: SendingConfig, bytes_per_s: i64, delay_ms: i64, events_per_s: i64) -> Self {
        Self {
            agent: Agent::new(config),
            receiving: Receiving::new(ReceivingConfig::new("base".parse().expect("a name"))),
            up: Way::new(bytes_per_s, delay_ms),
            down: Way::new(10_000_000, delay_ms),
            commits: VecDeque::new(),
            events_per_s,
            stored: 0,
            shown: 0,
            due: false,
            behind: 0,
            hellos: 0,
            repeated: 0,
        }
    }

    fn offer(&mut self, millis: i64) {
        let now = self.agent.millis;
        let (before, after) = ((now - millis) * self.events_per_s / 1_000, now * self.events_per_s / 1_000);
        for n in before..after {
            // What says something new does not compress.
            let text: String =
                (0..8).map(|part| Chain::START.then(part, &n.to_be_bytes()).to_string()).collect();
            self.agent.sending.offer(&incident(&text), self.agent.now());
        }
        self.agent.sending.tick(self.agent.now());
    }

    fn step(&mut self) {
        self.agent.millis += STEP_MS;
        let now = self.agent.millis;
        self.offer(STEP_MS);
        while let Some(message) = self.down.arrived(now) {
            self.agent.sending.received(&message, self.agent.now());
        }
        self.due |= now % LIVE_EVERY_MS == 0;
        if self.due && self.agent.sending.may_show() {
            self.agent.sending.shown(LIVE_BYTES);
            self.up.send(LIVE_BYTES, Sent::Live(now), now);
            self.due = false;
        }
        while let Some(action) = self.agent.sending.next(self.agent.now().mono) {
            match action {
                Action::Send(frame) => self.up.send(frame.len(), Sent::Frame(frame.into()), now),
                job => self.agent.perform(job),
            }
        }
        while let Some(sent) = self.up.arrived(now) {
            match sent {
                Sent::Live(made) => self.shown = made,
                Sent::Frame(frame) => self.take(frame),
            }
        }
        while let Some((_, head)) = self.commits.pop_front_if(|(at, _)| *at <= now) {
            self.stored += u64::from(head.events);
            let (_, reply) = self.receiving.stored(head.stream, Mark::from(head)).expect("it listens");
            self.reply(reply);
        }
        self.behind = self.behind.max(now - self.shown);
    }

    fn take(&mut self, frame: Bytes) {
        let now = self.agent.now().mono;
        let frame = match codec::part(&frame) {
            Some(part) => match self.receiving.part(&part, now) {
                Some(whole) => whole,
                None => return,
            },
            None => frame,
        };
        if let Some(head) = codec::batch_head(&frame) {
            codec::batch_body(frame).expect("intact");
            match self.receiving.batch(&head, true, now) {
                Arrival::Accept => self.commits.push_back((self.agent.millis + COMMIT_MS, head)),
                _ => self.repeated += 1,
            }
            return;
        }
        match codec::decode(&frame).expect("a message") {
            ToAggregator::Hello(hello) => {
                self.hellos += 1;
                self.agent.hellos.push(hello.clone());
                let greeting = self.receiving.hello(&hello, Known::default(), now);
                let Greeting::Welcome { reply, .. } = greeting else { panic!("{greeting:?}") };
                self.reply(reply);
            }
            ToAggregator::Echo { host, bytes } => {
                let echo = self.receiving.echo(host, bytes, now);
                self.reply(echo);
            }
            other => panic!("{other:?} was sent"),
        }
    }

    fn reply(&mut self, message: ToAgent) {
        self.down.send(60, message, self.agent.millis);
    }

    fn run(&mut self, seconds: i64) {
        (0..seconds * 1_000 / STEP_MS).for_each(|_| self.step());
    }

    /// Goes on for so long; how far the live picture was behind at most, and how much of the link was in use.
    fn watch(&mut self, seconds: i64) -> (i64, f64) {
        (self.behind, self.up.used_us) = (0, 0);
        let queued = self.up.busy_us - self.agent.millis * 1_000;
        self.run(seconds);
        let left = (self.up.busy_us - self.agent.millis * 1_000).max(0);
        (self.behind, (self.up.used_us + queued.max(0) - left) as f64 / (seconds * 1_000_000) as f64)
    }

    fn connect(&mut self) {
        self.agent.sending.connected(self.agent.now().mono);
    }

    /// The link becomes fast: all arrives, each once.
    fn finish(&mut self) {
        (self.up.bytes_per_s, self.events_per_s) = (10_000_000, 0);
        for _ in 0..20 {
            self.run(10);
            if self.agent.accounting().waiting == 0 {
                break;
            }
        }
        let is = self.agent.accounting();
        assert_eq!((is.waiting, is.dropped, is.stored), (0, 0, self.stored), "{is:?}");
        assert_eq!((self.repeated, self.hellos), (0, 1), "(batches, greetings) that came again");
    }
}

fn usual() -> SendingConfig {
    SendingConfig { window: 4, first_pause: Span::from_seconds(1), ..SendingConfig::default() }
}

#[test]
fn a_live_picture_stays_fresh_on_a_link_that_is_too_slow_for_the_events() {
    // Bytes a second, one-way delay, and how far behind the picture may be, in milliseconds.
    for (rate, delay, most) in [
        (6_250, 0, 1_500),
        (6_250, 300, 3_000),
        (12_500, 100, 1_500),
        (62_500, 20, 900),
        (62_500, 300, 2_500),
    ] {
        for offline in [0, 60] {
            // More than the link carries; and a backlog in batches that are as long as they get.
            let mut link = Link::new(usual(), rate, delay, rate / 60);
            link.events_per_s = if offline > 0 { 2_000 } else { link.events_per_s };
            link.run(offline);
            link.events_per_s = rate / 60;
            link.connect();
            link.run(8);
            let (behind, used) = link.watch(100);
            println!("{rate} B/s, {delay} ms, {offline} s offline: {behind} ms behind, {used:.2} in use");
            assert!(behind <= most, "{rate} B/s, {delay} ms, {offline} s offline: {behind} ms behind");
            assert!(used >= 0.8, "{rate} B/s, {delay} ms, {offline} s offline: {used} in use");
            assert!(link.agent.accounting().compressed, "compression came on");
            link.finish();
        }
    }
}
