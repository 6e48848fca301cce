//! The tree of one iteration of an observed system.
//!
//! Age and period of a message are values, not stages, because `header.stamp` may come from another clock.

mod peer;

use peernet_clock::{SharedClock, Span, Stamp, WallTime};
use peernet_logger::{HostId, Measure, Name, NodeId, Recorder, Tree, Unit, stage};

use super::arrivals::Arrival;
use super::message::TopicMessage;
use crate::link::HostStamp;
use crate::pipeline::in_flight::StartedIteration;
use crate::pipeline::iteration;
use crate::pipeline::load::Start;
use crate::pipeline::progress::Position;

/// Largest difference between `header.stamp` and this host's clock that is recorded as the age of a message. A larger
/// difference means that another clock made the stamp, for example the clock of a simulation.
const MAX_AGE: Span = Span::from_seconds(3600);

/// Observed messages have no intended starts. An observed iteration is therefore recorded without lateness, like an
/// iteration of a closed loop.
const CLOSED_LOOP: bool = true;

/// Name of the number of output messages without an input message since the previous answered iteration. Absent if the
/// number is zero.
const OUTPUT_UNMATCHED: Name = Name::from_static("output-unmatched");

/// A message with period and jitter of its topic.
#[derive(Debug)]
pub(super) struct ReceivedMessage {
    pub(super) message: TopicMessage,
    pub(super) arrival: Arrival,
    /// Stamp of the message's reception by this host's clocks, from which the delay of the message is computed.
    pub(super) host_stamp: HostStamp,
}

/// An input message with its position in the run.
#[derive(Debug)]
pub(super) struct Input {
    pub(super) position: Position,
    pub(super) received_message: ReceivedMessage,
}

/// Counts of messages without an iteration, since the previous answered iteration.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct UnpairedCounts {
    /// Number of input messages that this agent did not receive, according to their sequence numbers.
    pub(super) input_missing: u64,
    /// Number of output messages that this agent did not receive, according to their sequence numbers.
    pub(super) output_missing: u64,
    /// Number of received output messages without an input message.
    pub(super) output_unmatched: u64,
}

// Anybody on the network can publish any sequence number, so the counts saturate.
impl UnpairedCounts {
    /// Adds input messages that this agent did not receive.
    pub(super) const fn add_missing_input(&mut self, count: u64) {
        self.input_missing = self.input_missing.saturating_add(count);
    }

    /// Adds output messages that this agent did not receive.
    pub(super) const fn add_missing_output(&mut self, count: u64) {
        self.output_missing = self.output_missing.saturating_add(count);
    }
}

/// Names of the values of a topic. Age and period are the terms of the topic statistics of ROS 2.
struct TopicNames {
    /// Reception by the agent minus `header.stamp`; contains the offset of the clocks if the publisher is on another
    /// host.
    age: Name,
    /// Time since the previous message of the topic.
    period: Name,
    /// Absolute difference between two consecutive periods.
    jitter: Name,
    /// Size of the serialised message.
    bytes: Name,
    /// Number of missing messages since the previous answered iteration, according to their sequence numbers.
    missing: Name,
}

const INPUT: TopicNames = TopicNames {
    age: Name::from_static("input-age"),
    period: Name::from_static("input-period"),
    jitter: Name::from_static("input-jitter"),
    bytes: Name::from_static("input-bytes"),
    missing: Name::from_static("input-missing"),
};

const OUTPUT: TopicNames = TopicNames {
    age: Name::from_static("output-age"),
    period: Name::from_static("output-period"),
    jitter: Name::from_static("output-jitter"),
    bytes: Name::from_static("output-bytes"),
    missing: Name::from_static("output-missing"),
};

pub(super) use peer::{tree_with_peer_stamps, tree_without_peer_stamps};

/// Returns the tree of an input message with its output message, and the time at which the iteration ended.
pub(super) fn tree_of_pair(
    clock: &SharedClock,
    host: HostId,
    input: &Input,
    output: &ReceivedMessage,
    unpaired_counts: UnpairedCounts,
) -> (Tree, Stamp) {
    let (started, ended) = start_and_end(input, output);
    let mut log = Recorder::starting_at(SharedClock::clone(clock), host, started);
    log.record_timer(stage::INFERENCE, started.mono, ended.mono);
    add_topics(log.tree_mut(), input, output, ended.mono - started.mono, unpaired_counts);
    let (iteration, no_transport) = (started_iteration(input.position, started), None);
    (iteration::close(log, &iteration, ended.mono, CLOSED_LOOP, no_transport), ended)
}

/// Returns the times at which the iteration of a pair began and ended.
fn start_and_end(input: &Input, output: &ReceivedMessage) -> (Stamp, Stamp) {
    let (started, output_received) = (input.received_message.message.received_at, output.message.received_at);
    // The observed node may receive the input message, and even answer it, before the agent receives the input message.
    // Then the agent cannot measure the latency, and records 0.
    (started, if output_received.mono < started.mono { started } else { output_received })
}

/// Adds the values of both messages of a pair, and of their topics, to a tree; `at` is the end of the iteration.
fn add_topics(
    tree: &mut Tree,
    input: &Input,
    output: &ReceivedMessage,
    at: Span,
    unpaired_counts: UnpairedCounts,
) {
    add_topic(tree, &INPUT, &input.received_message, Span::ZERO, unpaired_counts.input_missing);
    add_topic(tree, &OUTPUT, output, at, unpaired_counts.output_missing);
    if unpaired_counts.output_unmatched > 0 {
        add_count(tree, OUTPUT_UNMATCHED, at, unpaired_counts.output_unmatched);
    }
}

/// Returns the tree of an input message that has no output message by `ended`.
pub(super) fn tree_without_output(
    clock: &SharedClock,
    host: HostId,
    position: Position,
    input: &ReceivedMessage,
    ended: Stamp,
) -> Tree {
    let started = input.message.received_at;
    let mut log = Recorder::starting_at(SharedClock::clone(clock), host, started);
    // The next answered iteration records the number of missing messages.
    add_topic(log.tree_mut(), &INPUT, input, Span::ZERO, 0);
    let (iteration, no_transport) = (started_iteration(position, started), None);
    iteration::close(log, &iteration, ended.mono, CLOSED_LOOP, no_transport)
}

/// Adds the values of one message and of its topic to a tree, at `at` after the start of the iteration.
fn add_topic(
    tree: &mut Tree,
    names: &TopicNames,
    received_message: &ReceivedMessage,
    at: Span,
    missing: u64,
) {
    let ReceivedMessage { message, arrival, .. } = received_message;
    let mut add_seconds = |name: &Name, span: Option<Span>| {
        if let Some(span) = span {
            tree.add(NodeId::ROOT, name.clone(), at, Measure::Value(span.seconds(), Unit::SECONDS));
        }
    };
    add_seconds(&names.age, message_age(message));
    add_seconds(&names.period, arrival.period);
    add_seconds(&names.jitter, arrival.jitter);
    let bytes = Measure::Value(message.length as f64, Unit::BYTES);
    tree.add(NodeId::ROOT, names.bytes.clone(), at, bytes);
    if missing > 0 {
        add_count(tree, names.missing.clone(), at, missing);
    }
}

fn add_count(tree: &mut Tree, name: Name, at: Span, count: u64) {
    tree.add(NodeId::ROOT, name, at, Measure::Value(count as f64, Unit::NONE));
}

/// Returns the time from `header.stamp` to the reception; `None` without a stamp, or beyond [`MAX_AGE`].
fn message_age(message: &TopicMessage) -> Option<Span> {
    let age = message.received_at.wall - WallTime::from_unix_nanos(message.stamp?);
    // A stamp of a simulation or of a stopped clock would make the age meaningless.
    (age.abs() <= MAX_AGE).then_some(age)
}

const fn started_iteration(position: Position, started: Stamp) -> StartedIteration {
    StartedIteration {
        position,
        start: Start { intended: started.mono, skipped: 0 },
        started_at: started.mono,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{Clock, ClockIdentity, ManualClock};

    use super::*;

    const POSITION: Position = Position { number: 1, episode: 0, step: 0, warm_up: false };

    fn received_message(at: Stamp, stamp: Option<i64>) -> ReceivedMessage {
        let message = TopicMessage { received_at: at, length: 10, stamp, sequence: None, missing_before: 0 };
        let arrival = Arrival { period: Some(Span::from_millis(40)), jitter: None };
        ReceivedMessage {
            message,
            arrival,
            host_stamp: HostStamp { wall: at.wall, raw: at.raw, epoch: Some(0) },
        }
    }

    fn clock() -> Arc<ManualClock> {
        Arc::new(ManualClock::new(
            WallTime::from_unix_nanos(1_000_000_000_000_000_000),
            ClockIdentity::new("boot", "system"),
        ))
    }

    fn millis(tree: &Tree, name: &str) -> Option<f64> {
        Some((tree.find(&[name])?.1.measure.value()? * 1e3).round())
    }

    #[test]
    fn answered_input_has_latency_ages_and_counts() {
        let clock = clock();
        let captured = clock.wall().unix_nanos();
        clock.advance(Span::from_millis(3));
        let input =
            Input { position: POSITION, received_message: received_message(clock.stamp(), Some(captured)) };
        clock.advance(Span::from_millis(20));
        let output = received_message(clock.stamp(), Some(captured));
        let unpaired_counts = UnpairedCounts { input_missing: 2, output_missing: 0, output_unmatched: 1 };
        let shared: SharedClock = Arc::<ManualClock>::clone(&clock);
        let (tree, ended) = tree_of_pair(&shared, HostId::random(), &input, &output, unpaired_counts);
        for (name, expected) in [
            ("inference", 20.0),
            ("total", 20.0),
            ("unattributed", 0.0),
            ("input-age", 3.0),
            ("output-age", 23.0),
        ] {
            assert_eq!(millis(&tree, name), Some(expected), "{name}");
        }
        let value = |name: &str| tree.find(&[name]).and_then(|(_, node)| node.measure.value());
        assert_eq!((value("input-missing"), value("output-missing")), (Some(2.0), None));
        assert_eq!((value("output-unmatched"), value("input-period")), (Some(1.0), Some(0.04)));
        assert_eq!(ended, output.message.received_at);
    }

    #[test]
    fn forged_sequence_numbers_do_not_wrap_missing_counts() {
        let mut unpaired_counts = UnpairedCounts::default();
        for missing in [u64::MAX, 2] {
            unpaired_counts.add_missing_input(missing);
            unpaired_counts.add_missing_output(missing);
        }
        assert_eq!((unpaired_counts.input_missing, unpaired_counts.output_missing), (u64::MAX, u64::MAX));
    }

    #[test]
    fn output_received_before_input_has_latency_zero() {
        let clock = clock();
        let output = received_message(clock.stamp(), None);
        clock.advance(Span::from_millis(1));
        let input = Input { position: POSITION, received_message: received_message(clock.stamp(), None) };
        let shared: SharedClock = Arc::<ManualClock>::clone(&clock);
        let (tree, ended) =
            tree_of_pair(&shared, HostId::random(), &input, &output, UnpairedCounts::default());
        assert_eq!(millis(&tree, "inference"), Some(0.0));
        assert_eq!(ended, input.received_message.message.received_at);
    }

    #[test]
    fn age_by_clock_of_simulation_is_not_recorded() {
        let clock = clock();
        let shared: SharedClock = Arc::<ManualClock>::clone(&clock);
        let input = received_message(clock.stamp(), Some(5_000_000_000));
        clock.advance(Span::from_millis(1000));
        let tree = tree_without_output(&shared, HostId::random(), POSITION, &input, clock.stamp());
        assert_eq!((millis(&tree, "input-age"), millis(&tree, "total")), (None, Some(1000.0)));
    }
}
