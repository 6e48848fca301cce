//! The loop of an observed run: makes iterations of the messages of two topics.

use std::pin::pin;
use std::time::Duration;

use futures::FutureExt;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_stream::Outcome;

use super::arrivals::Arrivals;
use super::message::TopicMessage;
use super::pairing::{Pairing, Resolution, Unanswered};
use super::peer::{Pair, PeerStamps, SettledPair, record_without_peer};
use super::record::{self as trees, Input, Received, Uncounted};
use super::source::{Source, SourceError};
use super::stamps::MessageStamps;
use super::topic::Topic;
use crate::config::ObserveConfig;
use crate::observed::Side;
use crate::pipeline::context::PipelineContext;
use crate::pipeline::run::Run;
use crate::pipeline::runner::Runner;

/// Largest number of messages of each topic that wait for one of the other: those of a topic of 1 kHz in four
/// seconds.
const MAX_WAITING: usize = 4096;
/// Longest time between two checks of the publishers and of the end of the run.
const CHECK_INTERVAL: Span = Span::from_seconds(1);

/// Reason why a session ended.
#[derive(Debug)]
pub(super) enum SessionEnded {
    /// The run reached its limit.
    Limit,
    /// A new day began.
    Midnight,
    /// The agent stops.
    Stopped,
    /// The node of the subscriptions has ended.
    SourceLost(SourceError),
}

/// State of the observation, over all connections and runs.
pub(super) struct Observation<'a> {
    config: &'a ObserveConfig,
    timeout: Span,
    pairing: Pairing<Input, Received>,
    input: Arrivals,
    output: Arrivals,
    uncounted: Uncounted,
    /// Messages received before this time are ignored: they belong to no run.
    since: MonoTime,
    /// `true` once output messages without a key have been reported.
    has_reported_output: bool,
    stamps: MessageStamps,
    /// The agent that observes the same messages on its host, if there is one.
    peer: Option<PeerStamps>,
}

impl<'a> Observation<'a> {
    /// Starts the observation now.
    pub(super) fn new(config: &'a ObserveConfig, runner: &Runner, peer: Option<PeerStamps>) -> Self {
        let PipelineContext { host, observed, .. } = &runner.context;
        let timeout = Span::from(runner.config.timeout());
        let kept = observed.find(&runner.config.name);
        let stamps = MessageStamps::new(SharedClock::clone(&host.clock), kept);
        Self {
            config,
            timeout,
            pairing: Pairing::new(timeout, MAX_WAITING),
            input: Arrivals::default(),
            output: Arrivals::default(),
            uncounted: Uncounted::default(),
            since: host.clock.mono(),
            has_reported_output: false,
            stamps,
            peer,
        }
    }

    pub(super) const fn peer(&self) -> Option<&PeerStamps> {
        self.peer.as_ref()
    }

    /// Makes iterations of `run` until the session ends. All iterations that had begun are recorded by then, unless
    /// the node has ended.
    pub(super) async fn run(&mut self, source: &mut Source, run: &mut Run, runner: &Runner) -> SessionEnded {
        let clock = &runner.context.host.clock;
        let mut stopping = pin!(runner.stop.cancelled());
        let mut given_up = pin!(tokio::time::sleep(Duration::ZERO));
        let mut ending: Option<SessionEnded> = None;
        let mut trouble: Option<String> = None;
        let mut dropped = source.input.dropped() + source.output.dropped();
        let mut look_at = clock.mono();
        loop {
            let now = clock.mono();
            while let Some(resolution) = self.pairing.expire(now) {
                self.settle(resolution, run, runner);
            }
            if now >= look_at {
                look_at = now + CHECK_INTERVAL;
                let current = source.trouble();
                if current != trouble {
                    let reported = current.as_ref().map(|trouble| source.advised(trouble));
                    super::life::report_trouble(runner, run.id(), reported.as_deref());
                    trouble = current;
                }
                report_dropped(source, &mut dropped);
            }
            if ending.is_none() {
                if run.is_limit_reached(now) {
                    ending = Some(SessionEnded::Limit);
                } else if run.is_from_previous_day(clock.wall()) {
                    ending = Some(SessionEnded::Midnight);
                }
            }
            // Iterations that have begun are completed first, so that the end of a run cuts off no pair.
            if self.pairing.is_settled()
                && self.peer.as_ref().is_none_or(PeerStamps::is_settled)
                && let Some(ending) = ending.take()
            {
                return ending;
            }
            let wakes_at = self.pairing.next_deadline().map_or(look_at, |deadline| deadline.min(look_at));
            let pause = tokio::time::sleep((wakes_at - now).to_duration());
            let is_stopping = matches!(ending, Some(SessionEnded::Stopped));
            tokio::select! {
                () = &mut stopping, if !is_stopping => {
                    given_up.as_mut().reset(tokio::time::Instant::now() + runner.patience);
                    ending = Some(SessionEnded::Stopped);
                }
                message = source.input.next() => match message {
                    Ok(message) if ending.is_none() => self.take_input(message, run, runner),
                    // The run is over; only messages that belong to its open iterations still count.
                    Ok(_) => {}
                    Err(error) => return SessionEnded::SourceLost(error.into()),
                },
                message = source.output.next() => match message {
                    Ok(message) => {
                        // Input messages that have been received already may have arrived before this output message.
                        if ending.is_none() {
                            self.take_arrived(&mut source.input, run, runner);
                        }
                        self.take_output(message, run, runner);
                    }
                    Err(error) => return SessionEnded::SourceLost(error.into()),
                },
                settled = next_settled(&mut self.peer) => record(settled, run, runner),
                () = pause => {}
                () = &mut given_up, if is_stopping => {
                    self.give_up("the agent stopped before the output message came", run, runner).await;
                    return SessionEnded::Stopped;
                }
            }
        }
    }

    /// Records the waiting input messages as lost, and the pairs that wait for the peer with the stamps that it has
    /// sent.
    pub(super) async fn give_up(&mut self, reason: &str, run: &mut Run, runner: &Runner) {
        for input in self.pairing.take_waiting() {
            record_lost(&input, reason.to_owned(), run, runner);
        }
        if let Some(peer) = &mut self.peer {
            peer.give_up().await.into_iter().for_each(|settled| record(settled, run, runner));
        }
    }

    /// Ends the session with the peer.
    pub(super) async fn close(self) {
        if let Some(peer) = self.peer {
            peer.close().await;
        }
    }

    /// Adds the input messages that have been received already.
    fn take_arrived(&mut self, input: &mut Topic, run: &mut Run, runner: &Runner) {
        // An error is returned again when the next message is waited for.
        while let Some(Ok(message)) = input.next().now_or_never() {
            if !run.is_limit_reached(message.received.mono) {
                self.take_input(message, run, runner);
            }
        }
    }

    fn take_input(&mut self, message: TopicMessage, run: &mut Run, runner: &Runner) {
        let at = message.received.mono;
        if at < self.since {
            return;
        }
        let arrival = self.input.record(at);
        self.uncounted.input_missing += message.missing;
        // The input message numbers the iteration, so that an input without an output is counted as well.
        let position = run.assign_position(at);
        let key = message.key(self.config.pair_by);
        let at_host = self.stamps.take(Side::Input, &message, key.ok().flatten());
        let received = Received { message, arrival, at: at_host };
        match key {
            Ok(key) => {
                let input = Input { position, received };
                if let Some(resolution) = self.pairing.take_input(key, at, input) {
                    self.settle(resolution, run, runner);
                }
            }
            Err(reason) => {
                let host = &runner.context.host;
                let ended = host.clock.stamp();
                let tree = trees::unanswered(&host.clock, host.id, position, &received, ended);
                let outcome = Outcome::Failed(format!("a message of {}: {reason}", self.config.input));
                run.record(position, outcome, tree, ended, &runner.context, &runner.display);
            }
        }
    }

    fn take_output(&mut self, message: TopicMessage, run: &mut Run, runner: &Runner) {
        let at = message.received.mono;
        if at < self.since {
            return;
        }
        let arrival = self.output.record(at);
        self.uncounted.output_missing += message.missing;
        match message.key(self.config.pair_by) {
            Ok(key) => {
                let at_host = self.stamps.take(Side::Output, &message, key);
                let output = Received { message, arrival, at: at_host };
                if let Some(resolution) = self.pairing.take_output(key, at, output) {
                    self.settle(resolution, run, runner);
                }
            }
            Err(reason) => {
                self.uncounted.output_unmatched += 1;
                if !std::mem::replace(&mut self.has_reported_output, true) {
                    let topic = &self.config.output;
                    tracing::warn!(topic, "a message cannot be paired: {reason}; such messages are counted");
                }
            }
        }
    }

    fn settle(&mut self, resolution: Resolution<Input, Received>, run: &mut Run, runner: &Runner) {
        match resolution {
            Resolution::Paired { input, output } => {
                // Missing messages have no iteration. The next complete one carries their numbers.
                let uncounted = std::mem::take(&mut self.uncounted);
                let host = &runner.context.host;
                if let Some(peer) = &mut self.peer {
                    let key = input.received.message.key(self.config.pair_by).ok().flatten();
                    let pair = Pair { input, output, uncounted };
                    let refused = match key {
                        Some(key) => peer.ask(key, pair).err(),
                        None => Some(Box::new(pair)),
                    };
                    if let Some(pair) = refused {
                        record(record_without_peer(host, &pair), run, runner);
                    }
                    return;
                }
                let (tree, ended) = trees::answered(&host.clock, host.id, &input, &output, uncounted);
                run.record(input.position, Outcome::Ok, tree, ended, &runner.context, &runner.display);
            }
            Resolution::Unanswered { input, cause } => {
                let ObserveConfig { output, pair_by, .. } = self.config;
                let (by, millis) = (pair_by.describe(), self.timeout.nanos() / 1_000_000);
                let reason = match cause {
                    Unanswered::Expired => {
                        format!("no message of {output} with its {by} within {millis} ms")
                    }
                    Unanswered::Displaced => {
                        format!("{MAX_WAITING} newer messages came before one of {output} with its {by}")
                    }
                };
                record_lost(&input, reason, run, runner);
            }
            Resolution::Unmatched(output) => {
                // The first output messages may belong to input messages from before the run.
                if output.message.received.mono - self.since >= self.timeout {
                    self.uncounted.output_unmatched += 1;
                }
            }
        }
    }
}

/// Waits for the next pair that the peer has answered.
async fn next_settled(peer: &mut Option<PeerStamps>) -> SettledPair {
    match peer {
        Some(peer) => peer.next().await,
        None => std::future::pending().await,
    }
}

fn record(SettledPair { position, tree, ended }: SettledPair, run: &mut Run, runner: &Runner) {
    run.record(position, Outcome::Ok, tree, ended, &runner.context, &runner.display);
}

fn record_lost(input: &Input, reason: String, run: &mut Run, runner: &Runner) {
    let host = &runner.context.host;
    let ended = host.clock.stamp();
    let tree = trees::unanswered(&host.clock, host.id, input.position, &input.received, ended);
    run.record(input.position, Outcome::Lost(reason), tree, ended, &runner.context, &runner.display);
}

/// Logs that this agent dropped messages, because that is not a fault of the observed nodes.
fn report_dropped(source: &Source, reported: &mut u64) {
    let dropped = source.input.dropped() + source.output.dropped();
    if dropped > *reported {
        let (input, output, more) = (source.input.name(), source.output.name(), dropped - *reported);
        tracing::warn!(
            input,
            output,
            more,
            "this agent was too busy and dropped messages of observed topics"
        );
        *reported = dropped;
    }
}
