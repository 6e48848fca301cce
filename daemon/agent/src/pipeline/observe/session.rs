//! The loop of an observed run: turns the messages of two topics into iterations.

use std::pin::pin;
use std::time::Duration;

use futures::FutureExt;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_stream::Outcome;

use super::arrivals::Arrivals;
use super::message::TopicMessage;
use super::pairing::{Pairing, Resolution, UnansweredCause};
use super::peer::{Pair, PeerStamps, SettledPair, record_without_peer};
use super::record::{self as trees, Input, ReceivedMessage, UnpairedCounts};
use super::source::{Source, SourceError};
use super::stamps::MessageStamps;
use super::topic::Topic;
use crate::config::{ObserveConfig, PairBy};
use crate::observed::Side;
use crate::pipeline::context::PipelineContext;
use crate::pipeline::run::Run;
use crate::pipeline::runner::Runner;

/// Maximum number of unpaired messages of each topic: the messages of four seconds at 1 kHz.
const MAX_UNPAIRED: usize = 4096;
/// Longest time between two checks of the publishers and of the end of the run.
const CHECK_INTERVAL: Span = Span::from_seconds(1);

/// Reason why a session ended.
#[derive(Debug)]
pub(super) enum SessionEnd {
    /// The run reached its limit.
    Limit,
    /// A new day (UTC) began.
    Midnight,
    /// The agent stops.
    Stopped,
    /// The ROS node of the subscriptions has ended.
    SourceLost(SourceError),
}

/// State of the observation, which outlives connections and runs.
pub(super) struct Observation<'a> {
    config: &'a ObserveConfig,
    timeout: Span,
    pairing: Pairing<Input, ReceivedMessage>,
    /// Input messages that arrived after midnight, before the run of the previous day had ended. They belong to the
    /// next run.
    inputs_of_next_run: Vec<TopicMessage>,
    input_arrivals: Arrivals,
    output_arrivals: Arrivals,
    unpaired_counts: UnpairedCounts,
    /// Start of the observation. Messages received earlier belong to no run and are ignored.
    started_at: MonoTime,
    /// `true` once output messages without a key have been reported.
    has_warned_of_unpairable_output: bool,
    stamps: MessageStamps,
    /// The agent that observes the same messages on its host, if there is one.
    peer: Option<PeerStamps>,
}

impl<'a> Observation<'a> {
    /// Starts the observation now.
    pub(super) fn new(config: &'a ObserveConfig, runner: &Runner, peer: Option<PeerStamps>) -> Self {
        let PipelineContext { host, observed, .. } = &runner.context;
        let timeout = Span::from(runner.config.timeout());
        let published_stamps = observed.find(&runner.config.name);
        let stamps = MessageStamps::new(SharedClock::clone(&host.clock), published_stamps);
        Self {
            config,
            timeout,
            pairing: Pairing::new(timeout, MAX_UNPAIRED),
            inputs_of_next_run: Vec::new(),
            input_arrivals: Arrivals::default(),
            output_arrivals: Arrivals::default(),
            unpaired_counts: UnpairedCounts::default(),
            started_at: host.clock.mono(),
            has_warned_of_unpairable_output: false,
            stamps,
            peer,
        }
    }

    pub(super) const fn peer(&self) -> Option<&PeerStamps> {
        self.peer.as_ref()
    }

    /// Records iterations of `run` until the session ends. All iterations that had started are recorded by then, unless
    /// the ROS node of the subscriptions ends while the run is not yet ending.
    pub(super) async fn run(&mut self, source: &mut Source, run: &mut Run, runner: &Runner) -> SessionEnd {
        let clock = &runner.context.host.clock;
        let mut stopping = pin!(runner.stop.cancelled());
        // The deadline is set when the agent stops; it is not polled before.
        let mut drain_deadline = pin!(tokio::time::sleep(Duration::ZERO));
        let mut ending: Option<SessionEnd> = None;
        let mut problem: Option<String> = None;
        // `true` once a topic can no longer be observed while the run is ending. The run then ends without the topic:
        // a new source may never come, for example because the ROS master is gone.
        let (mut is_input_lost, mut is_output_lost) = (false, false);
        let mut reported_drops = source.input.dropped() + source.output.dropped();
        let mut next_check_at = clock.mono();
        for message in std::mem::take(&mut self.inputs_of_next_run) {
            self.handle_input(message, run, runner);
        }
        loop {
            let now = clock.mono();
            while let Some(resolution) = self.pairing.expire(now) {
                self.settle(resolution, run, runner);
            }
            if now >= next_check_at {
                next_check_at = now + CHECK_INTERVAL;
                let current_problem = source.problem();
                if current_problem != problem {
                    let problem_with_advice =
                        current_problem.as_ref().map(|problem| source.with_advice(problem));
                    super::lifecycle::report_problem(runner, run.id(), problem_with_advice.as_deref());
                    problem = current_problem;
                }
                report_dropped(source, &mut reported_drops);
            }
            if ending.is_none() {
                if run.is_limit_reached(now) {
                    ending = Some(SessionEnd::Limit);
                } else if run.is_from_previous_day(clock.wall()) {
                    ending = Some(SessionEnd::Midnight);
                }
            }
            // The session ends only when all iterations that have started are complete, so that both messages of a pair
            // belong to the same run.
            if self.pairing.has_no_unpaired_inputs()
                && self.peer.as_ref().is_none_or(PeerStamps::has_no_waiting_pairs)
                && let Some(ending) = ending.take()
            {
                return ending;
            }
            let wakeup_at =
                self.pairing.next_deadline().map_or(next_check_at, |deadline| deadline.min(next_check_at));
            let pause = tokio::time::sleep((wakeup_at - now).to_duration());
            let is_stopping = matches!(ending, Some(SessionEnd::Stopped));
            tokio::select! {
                () = &mut stopping, if !is_stopping => {
                    drain_deadline.as_mut().reset(tokio::time::Instant::now() + runner.drain_timeout);
                    ending = Some(SessionEnd::Stopped);
                }
                message = source.input.next(), if !is_input_lost => match message {
                    Ok(message) if ending.is_none() => self.handle_input(message, run, runner),
                    Ok(message)
                        if matches!(ending, Some(SessionEnd::Midnight))
                            && self.inputs_of_next_run.len() < MAX_UNPAIRED =>
                    {
                        self.inputs_of_next_run.push(message);
                    }
                    // The run is ending: no further iteration starts.
                    Ok(_) => {}
                    Err(_) if ending.is_some() => is_input_lost = true,
                    Err(error) => return SessionEnd::SourceLost(error.into()),
                },
                message = source.output.next(), if !is_output_lost => match message {
                    Ok(message) => {
                        // Input messages that were received before this output message must be handled before it.
                        if ending.is_none() {
                            self.handle_received_inputs(&mut source.input, run, runner);
                        }
                        self.handle_output(message, run, runner);
                    }
                    Err(error) if ending.is_some() => {
                        is_output_lost = true;
                        self.lose_unpaired_inputs(&error.to_string(), run, runner);
                    }
                    Err(error) => return SessionEnd::SourceLost(error.into()),
                },
                settled_pair = next_settled(&mut self.peer) => record_pair(settled_pair, run, runner),
                () = pause => {}
                () = &mut drain_deadline, if is_stopping => {
                    self.abandon("the agent stopped before the output message came", run, runner).await;
                    return SessionEnd::Stopped;
                }
            }
        }
    }

    /// Records the unpaired input messages as lost. The pairs that wait for the peer are recorded with the stamps that
    /// the peer has sent so far.
    pub(super) async fn abandon(&mut self, reason: &str, run: &mut Run, runner: &Runner) {
        self.lose_unpaired_inputs(reason, run, runner);
        if let Some(peer) = &mut self.peer {
            peer.abandon().await.into_iter().for_each(|settled_pair| record_pair(settled_pair, run, runner));
        }
    }

    /// Records the unpaired input messages as lost.
    fn lose_unpaired_inputs(&mut self, reason: &str, run: &mut Run, runner: &Runner) {
        for input in self.pairing.take_unpaired_inputs() {
            record_lost(&input, reason.to_owned(), run, runner);
        }
    }

    /// Closes the session with the peer.
    pub(super) async fn close(self) {
        if let Some(peer) = self.peer {
            peer.close().await;
        }
    }

    /// Handles the input messages that have already been received.
    fn handle_received_inputs(&mut self, input: &mut Topic, run: &mut Run, runner: &Runner) {
        // An error is not lost: the next wait for a message returns it again.
        while let Some(Ok(message)) = input.next().now_or_never() {
            if !run.is_limit_reached(message.received_at.mono) {
                self.handle_input(message, run, runner);
            }
        }
    }

    /// Handles an input message: starts an iteration.
    fn handle_input(&mut self, message: TopicMessage, run: &mut Run, runner: &Runner) {
        let at = message.received_at.mono;
        if at < self.started_at {
            return;
        }
        let arrival = self.input_arrivals.record(at);
        self.unpaired_counts.add_missing_input(message.missing_before);
        // The position is assigned here and not when the output message arrives, because an input message without an
        // output message is an iteration, too.
        let position = run.assign_position(at);
        let key = message.key(self.config.pair_by);
        let host_stamp = self.stamps.stamp(Side::Input, &message, key.ok().flatten());
        let received_message = ReceivedMessage { message, arrival, host_stamp };
        match key {
            Ok(key) => {
                let input = Input { position, received_message };
                if let Some(resolution) = self.pairing.add_input(key, at, input) {
                    self.settle(resolution, run, runner);
                }
            }
            Err(reason) => {
                let host = &runner.context.host;
                let ended = host.clock.stamp();
                let tree =
                    trees::tree_without_output(&host.clock, host.id, position, &received_message, ended);
                let outcome =
                    Outcome::Failed(format!("a message of {} cannot be paired: {reason}", self.config.input));
                run.record(position, outcome, tree, ended, &runner.context, &runner.live_state);
            }
        }
    }

    /// Handles an output message: completes the iteration of its input message.
    fn handle_output(&mut self, message: TopicMessage, run: &mut Run, runner: &Runner) {
        let at = message.received_at.mono;
        if at < self.started_at {
            return;
        }
        let arrival = self.output_arrivals.record(at);
        self.unpaired_counts.add_missing_output(message.missing_before);
        match message.key(self.config.pair_by) {
            Ok(key) => {
                let host_stamp = self.stamps.stamp(Side::Output, &message, key);
                let output = ReceivedMessage { message, arrival, host_stamp };
                if let Some(resolution) = self.pairing.add_output(key, at, output) {
                    self.settle(resolution, run, runner);
                }
            }
            Err(reason) => {
                self.unpaired_counts.output_unmatched += 1;
                if !std::mem::replace(&mut self.has_warned_of_unpairable_output, true) {
                    let topic = &self.config.output;
                    tracing::warn!(
                        topic,
                        "a message cannot be paired: {reason}; such messages count as output-unmatched, and further ones are not logged"
                    );
                }
            }
        }
    }

    /// Records the iteration that a resolution completes. If there is a peer, a pair is usually not recorded here: this
    /// function queries the peer for its stamps, and `run` records the pair when the peer has answered or a timeout has
    /// passed.
    fn settle(&mut self, resolution: Resolution<Input, ReceivedMessage>, run: &mut Run, runner: &Runner) {
        match resolution {
            Resolution::Paired { input, output } => {
                // Missing messages have no iteration. The next iteration with both messages records their counts.
                let unpaired_counts = std::mem::take(&mut self.unpaired_counts);
                let host = &runner.context.host;
                if let Some(peer) = &mut self.peer {
                    let key = input.received_message.message.key(self.config.pair_by).ok().flatten();
                    let pair = Pair { input, output, unpaired_counts };
                    let unqueried_pair = match key {
                        Some(key) => peer.query(key, pair).err(),
                        None => Some(Box::new(pair)),
                    };
                    if let Some(pair) = unqueried_pair {
                        record_pair(record_without_peer(host, &pair), run, runner);
                    }
                    return;
                }
                let (tree, ended) =
                    trees::tree_of_pair(&host.clock, host.id, &input, &output, unpaired_counts);
                run.record(input.position, Outcome::Ok, tree, ended, &runner.context, &runner.live_state);
            }
            Resolution::Unanswered { input, cause } => {
                let ObserveConfig { output, pair_by, .. } = self.config;
                let same_key = match pair_by {
                    PairBy::Stamp | PairBy::Sequence => format!(" with the same {}", pair_by.describe()),
                    // Messages that are paired by their order have no key.
                    PairBy::Order => String::new(),
                };
                let millis = self.timeout.nanos() / 1_000_000;
                let reason = match cause {
                    UnansweredCause::Expired => {
                        format!("no message of {output}{same_key} within {millis} ms")
                    }
                    UnansweredCause::Displaced => {
                        format!(
                            "{MAX_UNPAIRED} newer input messages arrived before a message of {output}{same_key}"
                        )
                    }
                };
                record_lost(&input, reason, run, runner);
            }
            Resolution::Unmatched(output) => {
                // The first output messages may belong to input messages that preceded the observation, so they are not
                // counted as unmatched.
                if output.message.received_at.mono - self.started_at >= self.timeout {
                    self.unpaired_counts.output_unmatched += 1;
                }
            }
        }
    }
}

/// Waits for the next pair that the peer has answered, or whose timeout has passed.
async fn next_settled(peer: &mut Option<PeerStamps>) -> SettledPair {
    match peer {
        Some(peer) => peer.next().await,
        None => std::future::pending().await,
    }
}

/// Records the iteration of a pair.
fn record_pair(SettledPair { position, tree, ended }: SettledPair, run: &mut Run, runner: &Runner) {
    run.record(position, Outcome::Ok, tree, ended, &runner.context, &runner.live_state);
}

/// Records the iteration of an input message that has no output message as lost.
fn record_lost(input: &Input, reason: String, run: &mut Run, runner: &Runner) {
    let host = &runner.context.host;
    let ended = host.clock.stamp();
    let tree =
        trees::tree_without_output(&host.clock, host.id, input.position, &input.received_message, ended);
    run.record(input.position, Outcome::Lost(reason), tree, ended, &runner.context, &runner.live_state);
}

/// Logs that this agent dropped messages, so that they are not taken for messages that the observed nodes lost.
fn report_dropped(source: &Source, reported_drops: &mut u64) {
    let dropped = source.input.dropped() + source.output.dropped();
    if dropped > *reported_drops {
        let (input, output) = (source.input.name(), source.output.name());
        tracing::warn!(
            input,
            output,
            dropped_since_last_report = dropped - *reported_drops,
            "this agent was too slow and dropped messages of observed topics; stop other programs on this host, or observe fewer pipelines"
        );
        *reported_drops = dropped;
    }
}
