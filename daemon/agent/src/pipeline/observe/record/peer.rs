//! The tree of an iteration whose messages were observed by a second agent on another host.

use peernet_clock::{OneWayDelay, SharedClock, Span, Stamp};
use peernet_logger::{
    Anchor, HostId, HostIndex, Measure, Name, Node, NodeId, Recorder, Tree, TreeDelta, stage,
};

use super::{CLOSED_LOOP, add_count, add_topics, start_and_end, started_iteration};
use crate::link::{HostStamp, TransitStamps};
use crate::observed::ObservedPair;
use crate::pipeline::iteration;
use crate::pipeline::observe::peer::Pair;

/// Name of the number of input messages that the peer did not receive.
const PEER_INPUT_MISSING: Name = Name::from_static("peer-input-missing");
/// Name of the number of output messages that the peer did not receive.
const PEER_OUTPUT_MISSING: Name = Name::from_static("peer-output-missing");
/// Name of the value that is 1 if the peer was not queried for the iteration, or did not answer.
const PEER_UNANSWERED: Name = Name::from_static("peer-unanswered");

/// Index of the peer in the tree's list of hosts: 0 is this host, 1 the peer.
const PEER: HostIndex = HostIndex(1);

/// Returns the tree of a pair of messages with the peer's stamps, and the time at which the iteration ended. `judge`
/// judges the delays of the input message and, if the peer sent stamps of both messages, of the output message.
pub(in crate::pipeline::observe) fn tree_with_peer_stamps(
    (clock, host): (&SharedClock, HostId),
    peer: HostId,
    pair: &Pair,
    peer_stamps: &ObservedPair,
    judge: impl FnOnce(&TransitStamps, Option<&TransitStamps>) -> [Option<OneWayDelay>; 2],
) -> (Tree, Stamp) {
    let (input, output) = (&pair.input, &pair.output);
    let (started, ended) = start_and_end(input, output);
    let total = ended.mono - started.mono;
    let mut recorder = Recorder::starting_at(SharedClock::clone(clock), host, started);
    let mut transport = None;
    if let Some(arrival_stamp) = peer_stamps.input() {
        let up = TransitStamps { sender: input.received_message.host_stamp, receiver: arrival_stamp };
        let down = |departure_stamp| TransitStamps { sender: departure_stamp, receiver: output.host_stamp };
        let return_path = peer_stamps
            .output()
            .zip(peer_stamps.elapsed())
            .map(|(departure_stamp, elapsed)| (down(departure_stamp), elapsed));
        let [up_delay, down_delay] = judge(&up, return_path.as_ref().map(|(down, _)| down));
        let upload = recorder.start_transit(stage::UPLOAD, started);
        let nodes = return_path.map(|(down, elapsed)| peer_nodes(&down, elapsed, down_delay));
        // The sum of both directions needs no clock relation. It is this host's waiting time minus the time that
        // elapsed at the peer. Each host measures its time by its own monotonic clock.
        transport = return_path.map(|(_, elapsed)| total - elapsed);
        // A cloud sends a delta with its nodes. The peer sends stamps only, so the delta is made here.
        let base = u32::try_from(recorder.tree().nodes().len()).unwrap_or(u32::MAX);
        let delta = TreeDelta {
            base,
            anchor: Anchor { host: peer, wall: arrival_stamp.wall },
            others: Vec::new(),
            closed: (upload, arrival_stamp.wall),
            nodes: nodes.into_iter().flatten().collect(),
        };
        match recorder.tree_mut().apply_delta(delta) {
            Ok(()) => {
                if let Some(Measure::Transit(transit)) = recorder.tree_mut().measure_mut(upload) {
                    **transit = up.transit(up_delay);
                }
            }
            Err(error) => {
                transport = None;
                tracing::error!(%error, "the stamps of the peer are invalid; the iteration is recorded without them");
            }
        }
    }
    let stamps_by_name =
        [(PEER_INPUT_MISSING, peer_stamps.input()), (PEER_OUTPUT_MISSING, peer_stamps.output())];
    // These messages are counted only here, where the peer has answered. Without an answer it is unknown which messages
    // the peer received.
    for (name, _) in
        stamps_by_name.into_iter().filter(|(_, stamp): &(Name, Option<HostStamp>)| stamp.is_none())
    {
        add_count(recorder.tree_mut(), name, total, 1);
    }
    close(recorder, pair, ended, transport)
}

/// Returns the tree of a pair of messages without stamps of the peer, and the time at which the iteration ended.
pub(in crate::pipeline::observe) fn tree_without_peer_stamps(
    (clock, host): (&SharedClock, HostId),
    pair: &Pair,
) -> (Tree, Stamp) {
    let (started, ended) = start_and_end(&pair.input, &pair.output);
    let mut recorder = Recorder::starting_at(SharedClock::clone(clock), host, started);
    add_count(recorder.tree_mut(), PEER_UNANSWERED, ended.mono - started.mono, 1);
    close(recorder, pair, ended, None)
}

/// Returns the nodes `inference` and `download`, which the peer's stamps determine.
fn peer_nodes(down: &TransitStamps, elapsed: Span, delay: Option<OneWayDelay>) -> [Node; 2] {
    // The elapsed time is negative if the observed node answered before the peer's agent received the input message.
    let elapsed = elapsed.max(Span::ZERO);
    let node = |name, start, measure| Node { parent: Some(NodeId::ROOT), name, host: PEER, start, measure };
    [
        node(stage::INFERENCE, Span::ZERO, Measure::Timer(Some(elapsed))),
        node(stage::DOWNLOAD, elapsed, Measure::Transit(Box::new(down.transit(delay)))),
    ]
}

/// Closes the tree. `transport` is the sum of upload and download; without it the sum of the stages is unknown.
fn close(mut recorder: Recorder, pair: &Pair, ended: Stamp, transport: Option<Span>) -> (Tree, Stamp) {
    let started = pair.input.received_message.message.received_at;
    add_topics(
        recorder.tree_mut(),
        &pair.input,
        &pair.output,
        ended.mono - started.mono,
        pair.unpaired_counts,
    );
    let iteration = started_iteration(pair.input.position, started);
    let tree = match transport {
        Some(_) => iteration::close(recorder, &iteration, ended.mono, CLOSED_LOOP, transport),
        // Without the transport the stages would not add up to the total.
        None => iteration::close_without_stages(recorder, &iteration, ended.mono),
    };
    (tree, ended)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_analysis::rows::{Row, Rows};
    use peernet_clock::{Clock, ClockIdentity, Interval, ManualClock, Verdict, WallTime};
    use peernet_logger::RunId;
    use peernet_stream::{Iteration, Outcome};

    use super::*;
    use crate::pipeline::observe::arrivals::Arrival;
    use crate::pipeline::observe::message::TopicMessage;
    use crate::pipeline::observe::record::{Input, ReceivedMessage, UnpairedCounts};
    use crate::pipeline::progress::Position;

    /// Offset of the peer's clock from this host's clock.
    const PEER_CLOCK_OFFSET: Span = Span::from_seconds(-8);

    fn clock() -> Arc<ManualClock> {
        let wall = WallTime::from_unix_nanos(1_000_000_000_000_000_000);
        Arc::new(ManualClock::new(wall, ClockIdentity::new("boot", "system")))
    }

    fn received_message(at: Stamp) -> ReceivedMessage {
        let message =
            TopicMessage { received_at: at, length: 10, stamp: Some(7), sequence: None, missing_before: 0 };
        ReceivedMessage {
            message,
            arrival: Arrival::default(),
            host_stamp: HostStamp { wall: at.wall, raw: at.raw, epoch: Some(0) },
        }
    }

    /// Returns a pair whose input took 30 ms to the peer; 20 ms passed there, and the output took 5 ms back.
    fn pair(clock: &ManualClock) -> (Pair, ObservedPair) {
        let peer_stamp = |clock: &ManualClock| HostStamp {
            wall: clock.wall() + PEER_CLOCK_OFFSET,
            raw: clock.raw() + PEER_CLOCK_OFFSET,
            epoch: Some(0),
        };
        let position = Position { number: 1, episode: 0, step: 0, warm_up: false };
        let input = Input { position, received_message: received_message(clock.stamp()) };
        clock.advance(Span::from_millis(30));
        let arrival_stamp = peer_stamp(clock);
        clock.advance(Span::from_millis(20));
        let departure_stamp = peer_stamp(clock);
        clock.advance(Span::from_millis(5));
        let output = received_message(clock.stamp());
        let peer_stamps =
            ObservedPair::new(7, Some(arrival_stamp), Some(departure_stamp), Some(Span::from_millis(20)));
        (Pair { input, output, unpaired_counts: UnpairedCounts::default() }, peer_stamps)
    }

    /// Judges delays like a relation that knows the offset exactly.
    fn judge(up: &TransitStamps, down: Option<&TransitStamps>) -> [Option<OneWayDelay>; 2] {
        let up = up.receiver.wall - up.sender.wall - PEER_CLOCK_OFFSET;
        let down = down.map(|down| down.receiver.wall - down.sender.wall + PEER_CLOCK_OFFSET);
        [Some(OneWayDelay::same_clock(up)), down.map(OneWayDelay::same_clock)]
    }

    fn millis(tree: &Tree, name: &str) -> Option<f64> {
        Some((tree.find(&[name])?.1.measure.value()? * 1e3).round())
    }

    #[test]
    fn stages_of_both_hosts_add_up_to_total() {
        let clock = clock();
        let (pair, peer_stamps) = pair(&clock);
        let shared: SharedClock = Arc::<ManualClock>::clone(&clock);
        let (host, peer) = (HostId::random(), HostId::random());
        let (tree, ended) = tree_with_peer_stamps((&shared, host), peer, &pair, &peer_stamps, judge);
        for (name, expected) in [
            ("upload", 30.0),
            ("inference", 20.0),
            ("download", 5.0),
            ("total", 55.0),
            ("stages-total", 55.0),
            ("unattributed", 0.0),
        ] {
            assert_eq!(millis(&tree, name), Some(expected), "{name}");
        }
        assert_eq!(ended, pair.output.message.received_at);
        let host_of = |name| tree.find(&[name]).map(|(_, node)| node.host);
        assert_eq!((host_of("upload"), host_of("inference")), (Some(HostIndex::EDGE), Some(PEER)));
        assert_eq!(tree.anchors().get(1).map(|anchor| anchor.host), Some(peer));
        let Some((_, upload)) = tree.find(&["upload"]) else { panic!("{tree:?}") };
        let Measure::Transit(transit) = &upload.measure else { panic!("{upload:?}") };
        let raw = transit.received.expect("the stamp of the arrival") - transit.sent;
        assert_eq!(raw, Span::from_millis(30) + PEER_CLOCK_OFFSET, "the stamps are recorded unchanged");
    }

    #[test]
    fn rows_have_bounds_and_verdicts_of_observed_delays() {
        let clock = clock();
        let (pair, peer_stamps) = pair(&clock);
        let shared: SharedClock = Arc::<ManualClock>::clone(&clock);
        let limited = |value: Span| OneWayDelay {
            value: Some(value),
            bounds: Some(Interval { lo: value - Span::from_millis(40), hi: value + Span::from_millis(2) }),
            verdict: Verdict::Limited,
            ..OneWayDelay::unsynchronised(value + PEER_CLOCK_OFFSET)
        };
        let delays = [Some(limited(Span::from_millis(30))), Some(limited(Span::from_millis(5)))];
        let (host, peer) = (HostId::random(), HostId::random());
        let (tree, _) = tree_with_peer_stamps((&shared, host), peer, &pair, &peer_stamps, |_, _| delays);
        let iteration = Iteration {
            run: RunId::random(),
            number: 1,
            episode: 0,
            step: 0,
            warm_up: false,
            outcome: Outcome::Ok,
            tree,
        };
        let rows = Rows::from_iter([Row::from_iteration(&iteration)]);
        let row = rows.last().expect("one row");
        assert_eq!([row.upload(), row.download()], delays);
        assert_eq!((row.value("upload-lo"), row.value("upload-bytes")), (Some(-0.01), None));
    }

    #[test]
    fn message_that_peer_did_not_receive_is_counted() {
        let clock = clock();
        let (pair, peer_stamps) = pair(&clock);
        let shared: SharedClock = Arc::<ManualClock>::clone(&clock);
        let tree = |input, output, elapsed| {
            let peer_stamps = ObservedPair::new(7, input, output, elapsed);
            tree_with_peer_stamps((&shared, HostId::random()), HostId::random(), &pair, &peer_stamps, judge).0
        };
        let without_output = tree(peer_stamps.input(), None, None);
        let names = ["upload", "inference", "download", "stages-total", "peer-input-missing"];
        let values = names.map(|name| millis(&without_output, name));
        assert_eq!(values, [Some(30.0), None, None, None, None]);
        assert_eq!(
            millis(&without_output, "peer-output-missing"),
            Some(1000.0),
            "a count of 1, as `millis` returns it"
        );
        let without_input = tree(None, peer_stamps.output(), None);
        assert_eq!((millis(&without_input, "upload"), millis(&without_input, "total")), (None, Some(55.0)));
        assert!(without_input.find(&["peer-input-missing"]).is_some());
        let (unanswered, _) = tree_without_peer_stamps((&shared, HostId::random()), &pair);
        assert!(unanswered.find(&["peer-unanswered"]).is_some());
        assert_eq!((millis(&unanswered, "total"), millis(&unanswered, "inference")), (Some(55.0), None));
    }

    #[test]
    fn late_reception_of_input_gives_negative_upload() {
        let clock = clock();
        let (mut pair, peer_stamps) = pair(&clock);
        // This host received the input message 31 ms later than the peer did, 61 ms after it was sent.
        let late = pair.input.received_message.message.received_at + Span::from_millis(61);
        pair.input.received_message = received_message(late);
        let shared: SharedClock = Arc::<ManualClock>::clone(&clock);
        let judge = |up: &TransitStamps, down: Option<&TransitStamps>| {
            let exact = |difference| OneWayDelay {
                value: Some(difference),
                ..OneWayDelay::unsynchronised(difference)
            };
            let up = up.receiver.wall - up.sender.wall - PEER_CLOCK_OFFSET;
            let down = down.map(|down| down.receiver.wall - down.sender.wall + PEER_CLOCK_OFFSET);
            [Some(exact(up)), down.map(exact)]
        };
        let (tree, _) =
            tree_with_peer_stamps((&shared, HostId::random()), HostId::random(), &pair, &peer_stamps, judge);
        let names = ["upload", "inference", "download", "total"];
        let values = names.map(|name| millis(&tree, name));
        assert_eq!(values, [Some(-31.0), Some(20.0), Some(5.0), Some(0.0)]);
    }
}
